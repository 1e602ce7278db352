"""What an exported shader costs in ONNX Runtime and in the browser: ratios within one run.

The floor copies as many bytes as a pixel's vectors and colour have: 36 read, 12 written. Every form
is timed in turn, so that a drift of the machine hits all alike. `coherent` is a bumpy sphere;
`random` gives every pixel a geometry of its own, the worst case for the table. The browser's times
(`make runtimes`) and the operators' shares stand beside them. Results go to
benchmarks/results/onnx_session.json and .png; nothing is asserted.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from in_turn import in_turn

import raden_torch as rt
from raden_torch.export.constants import fix_parameters
from raden_torch.export.runtimes import Arrays, Runtime, load_others, onnx_session
from raden_torch.export.shader_session import ShaderSession

RUNS, WARM_UP, SIZE, SHARE = 9, 2, 1024, 0.1
INSTALLED = Path(__file__).resolve().parents[1] / "runtimes"
MODULES = INSTALLED / "node_modules"
PYTHONS = [INSTALLED / "onnxruntime-1.18/bin/python"]


def coherent(size: int) -> Arrays:
    """Vectors of a bumpy sphere under a lamp nearby, a map each."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    z = np.sqrt(np.maximum(0.05, 1 - x * x - y * y))
    place = np.stack([x, y, z])
    normal = place + 0.08 * np.stack([np.sin(40 * x), np.sin(40 * y), 0 * z])
    light = np.array([2.0, 2.0, 4.0]).reshape(3, 1, 1) - place
    view = np.array([0.0, 0.0, 6.0]).reshape(3, 1, 1) - place
    return {"normal": unit(normal), "light": unit(light), "view": unit(view)}


def random(size: int) -> Arrays:
    draw = np.random.default_rng(0)
    maps = {name: draw.standard_normal((3, size, size)) for name in ("normal", "light", "view")}
    for vectors in maps.values():
        vectors[2] += 2
    return {name: unit(vectors) for name, vectors in maps.items()}


def unit(vectors: np.ndarray) -> np.ndarray:
    return (vectors / np.linalg.norm(vectors, axis=0)).astype(np.float32)[None]


def rows(times: dict[str, list[float]], base: str) -> list[dict[str, Any]]:
    """Medians, and ratios to one of the jobs, pair by pair."""
    found = []
    for name, taken in times.items():
        ratios = sorted(t / b for t, b in zip(taken, times[base], strict=True))
        found.append(
            {
                "what": name,
                "ratio": statistics.median(ratios),
                "ratio_range": [ratios[0], ratios[-1]],
                "seconds": statistics.median(taken),
                "seconds_least": min(taken),
            }
        )
        print(f"{found[-1]['ratio']:8.2f} x {base:6s} {name}", flush=True)
    return found


def speed(files: dict[str, bytes], maps: Arrays, floor: Callable[[], object]) -> list[dict]:
    jobs: dict[str, Callable[[], object]] = {"floor": floor}
    for name, data in files.items():
        plain = onnx_session(data)
        jobs[f"{name}, one call"] = lambda plain=plain: plain.run(None, maps)
    tiled = ShaderSession(files["interchange"])
    jobs["tiles"] = lambda: tiled.run(**maps)
    return rows(in_turn(jobs, RUNS, warm_up=WARM_UP), "floor")


def masks(data: bytes, maps: Arrays) -> list[dict[str, Any]]:
    """What a mask saves."""
    y, x = np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    disc = (x**2 + y**2 < 4 * SHARE / np.pi)[None, None].astype(np.float32)
    scattered = np.random.default_rng(1).random((1, 1, SIZE, SIZE)) < SHARE
    session = ShaderSession(data)
    jobs = {
        "all": lambda: session.run(**maps),
        "10 % in a disc": lambda: session.run(**maps, mask=disc),
        "10 % scattered": lambda: session.run(**maps, mask=scattered),
    }
    return rows(in_turn(jobs, RUNS, warm_up=WARM_UP), "all")


def others(files: dict[str, bytes], size: int) -> list[dict[str, Any]]:
    """Every other runtime, as multiples of ONNX Runtime's time; each form by itself."""
    maps, found = coherent(size), []
    for form, data in files.items():
        ours = onnx_session(data)
        for runtime in load_others(data, node_modules=MODULES, pythons=PYTHONS):
            if not isinstance(runtime, Runtime):
                found.append({"what": f"{runtime.name}, {form}", "skipped": runtime.reason})
                continue
            taken = []
            for run in range(WARM_UP + RUNS):
                start = time.perf_counter()
                ours.run(None, maps)
                base = time.perf_counter() - start
                if runtime.timed is not None:
                    seconds = statistics.median(runtime.timed(maps, 3)[1]) / 1000
                else:
                    start = time.perf_counter()
                    runtime.run(maps)
                    seconds = time.perf_counter() - start
                if run >= WARM_UP:
                    taken.append((seconds, base))
            ratios = sorted(t / b for t, b in taken)
            found.append(
                {
                    "what": f"{runtime.name} {runtime.version}, {form}",
                    "ratio": statistics.median(ratios),
                    "ratio_range": [ratios[0], ratios[-1]],
                    "seconds_least": min(t for t, _ in taken),
                }
            )
            print(f"{found[-1]['ratio']:8.2f} x onnxruntime {found[-1]['what']}", flush=True)
    return found


def operators(data: bytes, pixels: int) -> list[dict[str, Any]]:
    """Nanoseconds a pixel of each operator, in one thread on one tile."""
    import onnxruntime as ort

    maps = {name: value.reshape(1, 3, 1, -1)[..., :pixels] for name, value in coherent(256).items()}
    maps = {name: np.ascontiguousarray(value) for name, value in maps.items()}
    with tempfile.TemporaryDirectory() as folder:
        options = ort.SessionOptions()
        options.log_severity_level, options.intra_op_num_threads = 3, 1
        options.enable_profiling, options.profile_file_prefix = True, f"{folder}/profile"
        session = ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        runs = 100
        for _ in range(runs):
            session.run(None, maps)
        events = json.loads(Path(session.end_profiling()).read_text())
    kernels = [e for e in events if e["name"].endswith("_kernel_time")]
    spent: Counter[str] = Counter()
    for event in kernels:
        spent[event["args"]["op_name"]] += event["dur"]
    nodes = Counter(e["args"]["op_name"] for e in kernels)
    table = [
        {"operator": op, "nodes": nodes[op] // runs, "ns_per_pixel": 1000 * us / runs / pixels}
        for op, us in spent.most_common()
    ]
    for row in table[:12]:
        print(f"{row['ns_per_pixel']:8.1f} ns/pixel  {row['nodes']:3d} {row['operator']}")
    return table


def plot(results: dict[str, Any], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    for offset, (name, table) in enumerate(results["speed"].items()):
        bars = [row for row in table if row["what"] != "floor"]
        places = [i + 0.4 * offset - 0.2 for i in range(len(bars))]
        left.barh(places, [row["ratio"] for row in bars], 0.38, label=name)
        left.set_yticks(range(len(bars)), [row["what"] for row in bars])
    left.set_xlabel("time / copy of 48 bytes a pixel")
    left.legend()
    shares = results["operators"][:14][::-1]
    right.barh([row["operator"] for row in shares], [row["ns_per_pixel"] for row in shares])
    right.set_xlabel("ns a pixel in one thread, tile of 16 384")
    fig.savefig(path, dpi=120)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--size", type=int, default=SIZE, help="side of the frame in pixels")
    options.add_argument("--model", type=Path, help="else the simulated yakogai is fitted")
    given = options.parse_args()
    if given.model:
        model = rt.load_model(given.model)
    else:
        model = rt.fit(rt.simulate_specimen("yakogai")).model
    import onnx

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shell.onnx"
        rt.export_onnx(model, path)
        free = path.read_bytes()
        rt.export_onnx(model, path, form="fit", fixed=True)
        paper = path.read_bytes()
    fixed = fix_parameters(onnx.load_from_string(free)).SerializeToString()
    files = {"interchange": free, "fixed": fixed, "fit form, fixed": paper}
    source = torch.zeros(6 * given.size**2)
    target = torch.empty_like(source)
    floor = lambda: target.copy_(source)  # noqa: E731 - 24 bytes a pixel read, 24 written
    results: dict[str, Any] = {
        "runs": RUNS,
        "size": given.size,
        "threads": os.cpu_count(),
        "load": os.getloadavg(),
        "file_bytes": {name: len(data) for name, data in files.items()},
        "packed_table_bytes": 4 * 12 * model.layout.nodes,
        "speed": {
            "coherent": speed(files, coherent(given.size), floor),
            "random": speed(files, random(given.size), floor),
        },
        "masks": masks(free, coherent(SIZE)),
        "others at 512 x 512": others(files, 512),
        "operators": operators(fixed, 16_384),
    }
    out = Path(__file__).with_name("results")
    out.mkdir(exist_ok=True)
    (out / "onnx_session.json").write_text(json.dumps(results, indent=2) + "\n")
    plot(results, out / "onnx_session.png")


if __name__ == "__main__":
    main()
