"""How much a mask saves in `ShaderSession`: time with 10 % of the pixels over the time with all.

Ratios within one run, measured in turn, so that a drift of the machine hits both alike; the whole
picture in one plain call of ONNX Runtime stands beside them.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import raden_torch as rt
from raden_torch.export.runtimes import onnx_session
from raden_torch.export.session import ShaderSession

RUNS, WARM_UP, SIZE, SHARE = 9, 2, 1024, 0.1


def seconds(job: Callable[[], object]) -> float:
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def main() -> None:
    model = rt.fit(rt.simulate_specimen("yakogai")).model
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shell.onnx"
        rt.export_onnx(model, path)
        data = path.read_bytes()
    draw = np.random.default_rng(0)
    maps = {}
    for name in ("normal", "light", "view"):
        maps[name] = draw.standard_normal((1, 3, SIZE, SIZE), np.float32)
        maps[name][:, 2] += 2
    rows, columns = np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]
    disc = (rows**2 + columns**2 < 4 * SHARE / np.pi)[None, None].astype(np.float32)
    scattered = (draw.random((1, 1, SIZE, SIZE)) < SHARE).astype(np.float32)
    session, plain = ShaderSession(data), onnx_session(data)
    jobs: dict[str, Callable[[], object]] = {
        "all pixels": lambda: session.run(**maps),
        "10 % in a disc": lambda: session.run(**maps, mask=disc),
        "10 % scattered": lambda: session.run(**maps, mask=scattered),
        "all pixels, one plain call": lambda: plain.run(None, maps),
    }
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for run in range(WARM_UP + RUNS):
        for name, job in jobs.items():
            taken = seconds(job)
            if run >= WARM_UP:
                times[name].append(taken)
    base = times["all pixels"]
    table = [
        {
            "what": name,
            "ratio_median": statistics.median(x / b for x, b in zip(taken, base, strict=True)),
            "ratio_worst": max(x / b for x, b in zip(taken, base, strict=True)),
            "seconds_median": statistics.median(taken),
        }
        for name, taken in times.items()
    ]
    out = Path(__file__).with_name("results") / "onnx_session.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps({"runs": RUNS, "size": SIZE, "rows": table}, indent=2) + "\n")
    for row in table:
        print(f"{row['ratio_median']:.3f} x all pixels  {row['what']}")


if __name__ == "__main__":
    main()
