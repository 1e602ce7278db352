"""How fast the model runs on an NVIDIA GPU: right first, then ratios within one run.

`copy` moves as many bytes as the model reads and writes (48 a pixel); `eager` is torch's form,
`compiled` the same through torch.compile, `triton` what the library takes by itself. Milliseconds
are the device's own, between two events, while the host is ahead; the host's time for a call
stands beside them. Every call works on the next of several sets of maps, which together are larger
than the GPU's cache. Medians; losses beside wins; nothing is asserted but the errors.

Takes less than four minutes on one card. Without one it ends with exit code 2; `--smoke` runs all
of it on the CPU instead, at a tiny size, where its figures mean nothing. Results go to
benchmarks/results/gpu.json and gpu.png, or to where `--out` says.
"""

from __future__ import annotations

import argparse
import copy
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import raden_torch as rt
from kernel import plate_maps, random_maps
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.brdf.shading.stress_geometries import worst_errors

FULL = {"1080p": (1, 1080, 1920), "4K": (1, 2160, 3840), "64 x 512²": (64, 512, 512)}
TINY = {"1080p": (1, 18, 32), "4K": (1, 36, 64), "64 x 512²": (4, 8, 8)}
NOISY = {"L near V, too near", "L near V, not unit"}
LIMIT = 5e-6
"""Of the error over the peak, as of the CPU kernel in tests/brdf/test_stress.py."""
LAYOUTS = {"small": (16, 35, 35), "default": (32, 69, 67), "large": (64, 137, 133)}
_CYCLES_AHEAD = 500_000
Calls = Sequence[Callable[[], object]]


def device_ms(calls: Calls, runs: int) -> dict[str, float] | None:
    """Medians of one call: on the device, and of the host; None where the memory is too small."""
    if not torch.cuda.is_available():
        return host_ms(calls, runs)
    try:
        for call in (*calls, *calls):
            call()
        torch.cuda.synchronize()
        events, host = [], []
        for k in range(runs):
            torch.cuda._sleep(_CYCLES_AHEAD)
            start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            start.record()
            began = time.perf_counter()
            calls[k % len(calls)]()
            host.append(1e3 * (time.perf_counter() - began))
            end.record()
            events.append((start, end))
            end.synchronize()
    except torch.OutOfMemoryError:
        torch.cuda.empty_cache()
        return None
    ms = sorted(start.elapsed_time(end) for start, end in events)
    return {"ms": statistics.median(ms), "least": ms[0], "host ms": statistics.median(host)}


def host_ms(calls: Calls, runs: int) -> dict[str, float]:
    """The same where there is no device: of the host alone."""
    calls[0]()
    host = []
    for k in range(runs):
        began = time.perf_counter()
        calls[k % len(calls)]()
        host.append(1e3 * (time.perf_counter() - began))
    middle = statistics.median(host)
    return {"ms": middle, "least": min(host), "host ms": middle}


def copies_of(bytes_each: int, device: torch.device) -> int:
    """So many sets of maps that one is not in the cache when its turn comes again."""
    if device.type != "cuda":
        return 2
    cache = torch.cuda.get_device_properties(device).L2_cache_size
    return max(2, min(16, 1 + 2 * cache // bytes_each))


def sets_of(scene: Callable[..., Any], size: tuple[int, int, int], device: torch.device) -> Any:
    """Sets of N, L, V `[B, 3, H, W]`."""
    b, h, w = size
    maps = [m.to(device).expand(b, -1, -1, -1) for m in scene(h, w)]
    count = copies_of(36 * b * h * w, device)
    return [[m.clone(memory_format=torch.contiguous_format) for m in maps] for _ in range(count)]


def in_form(level: str | None, call: Callable[..., object], *arguments: object) -> Any:
    """A call by the eager form, or by what the library takes."""

    def run() -> object:
        if level is None:
            return call(*arguments)
        with simd.using(level):
            return call(*arguments)

    return run


def copy_calls(sets: Any) -> Calls:
    pixels = sets[0][0].numel() // 3
    device = sets[0][0].device
    target = torch.empty(6 * pixels, device=device)
    return [partial(target.copy_, torch.rand(6 * pixels, device=device)) for _ in sets]


def evaluated(model: rt.RadenBrdf, compiled: Any, sets: Any, runs: int) -> dict[str, Any]:
    """Forward, by form."""
    with torch.no_grad():
        return {
            "copy": device_ms(copy_calls(sets), runs),
            "eager": device_ms([in_form(simd.OFF, model, *maps) for maps in sets], runs),
            "compiled": device_ms([in_form(simd.OFF, compiled, *maps) for maps in sets], runs),
            "triton": device_ms([in_form(None, model, *maps) for maps in sets], runs),
        }


def trained(model: rt.RadenBrdf, compiled: Any, sets: Any, runs: int) -> dict[str, Any]:
    """Forward and backward by normals and the runtime table, without the bake."""
    change = torch.randn_like(sets[0][0])
    table = model.runtime_table().detach().clone().requires_grad_()

    def step(form: Any, maps: Any) -> None:
        normal = maps[0].detach().requires_grad_()
        form(normal, *maps[1:], table).backward(change)
        table.grad = None

    return {
        "copy": device_ms(copy_calls(sets), runs),
        **{
            name: device_ms([in_form(level, step, form, maps) for maps in sets], runs)
            for name, level, form in (
                ("eager", simd.OFF, model.of_unit_vectors),
                ("compiled", simd.OFF, compiled),
                ("triton", None, model.of_unit_vectors),
            )
        },
    }


def shaded(model: rt.RadenBrdf, sets: Any, runs: int) -> dict[str, Any]:
    """`shade` at 1080p: 1, 8 and 64 lamps on the plate; 8 of them where 10 % is left by a mask."""
    generator = torch.Generator().manual_seed(1)
    at = (torch.rand(64, 3, generator=generator) - 0.5) * torch.tensor([3.0, 2.0, 0.0])
    at[:, 2] = 1.5
    pieces = (torch.rand(1, 1, 9, 15, generator=generator) < 0.1).float()
    mask = torch.nn.functional.interpolate(pieces, sets[0][0].shape[2:]).to(sets[0][0].device)
    found: dict[str, Any] = {"copy": device_ms(copy_calls(sets), runs)}
    for name, count, share in (
        ("1 lamp", 1, None),
        ("8 lamps", 8, None),
        ("64 lamps", 64, None),
        (f"8 lamps, a mask of {100 * float(mask.mean()):.0f} %", 8, mask),
    ):
        lamps = [
            rt.PointLight(p, 1.0) if k % 2 else rt.DirectionalLight(p) for k, p in enumerate(at)
        ]
        scenes = [rt.GBuffer(n, v, position=p, mask=share) for n, p, v in sets]
        for form, level in (("eager", simd.OFF), ("triton", None)):
            if form == "eager" and count > 8:
                continue
            with torch.no_grad():
                calls = [in_form(level, rt.shade, model, s, lamps[:count]) for s in scenes]
                found[f"{form}, {name}"] = device_ms(calls, runs)
    return found


def errors(model: rt.RadenBrdf, exact: rt.RadenBrdf, device: torch.device) -> dict[str, float]:
    """Against float64 on the CPU: the worst region, the gradients, and a replayed CUDA graph."""

    @torch.no_grad()
    def shader(*maps: Tensor) -> Tensor:
        return model(*(m.to(device) for m in maps)).cpu()

    with torch.no_grad():
        regions = worst_errors(shader, exact)
    found = {
        "worst region": max(e.worst for name, e in regions.items() if name not in NOISY),
        "not finite": float(sum(not e.finite for e in regions.values())),
    }
    grads = []
    for of, where, dtype in ((model, device, torch.float32), (exact, "cpu", torch.float64)):
        maps = [m.to(where, dtype).requires_grad_() for m in random_maps(128, 128)]
        of(*maps).square().sum().backward()
        inputs = {
            "normal": maps[0],
            "light": maps[1],
            "view": maps[2],
            **dict(of.named_parameters()),
        }
        grads.append({name: x.grad.double().cpu() for name, x in inputs.items()})
        of.zero_grad()
    for name, e in grads[1].items():
        share = (grads[0][name] - e).abs().flatten().quantile(0.99) / e.abs().max().clamp(min=1e-30)
        found[f"gradient of {name}, 99 %"] = float(share)
    if device.type == "cuda":
        found["a replayed graph"] = replayed(model, device)
    return found


@torch.no_grad()
def replayed(model: rt.RadenBrdf, device: torch.device) -> float:
    """The largest difference of a CUDA graph's image from the same call's."""
    normal, light, view = (m.to(device) for m in plate_maps(270, 480))
    lamp = rt.PointLight(*(torch.tensor(x, device=device) for x in ((0.1, 0.2, 2.0), (1.0,) * 3)))
    scene = rt.GBuffer(normal, view, position=light)
    stream = torch.cuda.Stream(device)
    with torch.cuda.stream(stream):
        expected = rt.shade(model, scene, lamp)
    stream.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, stream=stream):
        image = rt.shade(model, scene, lamp)
    image.zero_()
    graph.replay()
    torch.cuda.synchronize()
    return float((image - expected).abs().max())


def say(name: str, rows: dict[str, Any]) -> None:
    print(f"\n{name}")
    floor = rows["copy"]
    for form, row in rows.items():
        if row is None:
            print(f"  {form:28s} not enough memory")
            continue
        ratio = f"{row['ms'] / floor['ms']:8.2f} x copy" if floor else ""
        print(f"  {form:28s} {row['ms']:9.3f} ms  {ratio}   host {row['host ms']:.3f} ms")


def plot(report: dict[str, Any], path: Path) -> None:
    """Times over the copy's."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    ax = figure.subplots()
    for form, marker in (("eager", "s"), ("compiled", "^"), ("triton", "o")):
        names = [n for n, rows in report["times"].items() if rows.get(form) and rows["copy"]]
        over = [report["times"][n][form]["ms"] / report["times"][n]["copy"]["ms"] for n in names]
        ax.plot(over, names, marker, label=form)
    ax.set(xscale="log", xlabel="time / copy of 48 bytes a pixel", title=report["card"])
    ax.grid(alpha=0.3, which="both")
    ax.legend()
    figure.savefig(path, dpi=110)


def measure(device: torch.device, runs: int) -> dict[str, Any]:
    """Everything, on one card, or on the CPU as a smoke test."""
    on_gpu = device.type == "cuda"
    sizes = FULL if on_gpu else TINY
    measured = rt.simulate_specimen("yakogai", step_deg=5 if on_gpu else 35)
    exact = rt.fit(measured).model
    model = copy.deepcopy(exact).to(device)
    report: dict[str, Any] = {
        "card": torch.cuda.get_device_name(device) if on_gpu else "no card: a smoke test",
        "torch": torch.__version__,
        "cuda": torch.version.cuda,
        "form": simd.system_report(),
        "errors": errors(model, exact.double(), device),
        "times": {},
    }
    print(report["card"], report["errors"], sep="\n")
    times = report["times"]
    backend = "inductor" if on_gpu else "eager"
    compiled = torch.compile(model, backend=backend)
    compiled_unit = torch.compile(model.of_unit_vectors, backend=backend)
    for scene, make in (("plate", plate_maps), ("random", random_maps)):
        for size, shape in sizes.items():
            sets = sets_of(make, shape, device)
            times[f"{size}, {scene}"] = rows = evaluated(model, compiled, sets, runs)
            say(f"{size}, {scene}", rows)
            if size != "64 x 512²":
                name = f"{size}, {scene}, and backward"
                times[name] = rows = trained(model, compiled_unit, sets, max(4, runs // 3))
                say(name, rows)
            del sets
    sets = sets_of(plate_maps, sizes["1080p"], device)
    times["shade, 1080p"] = rows = shaded(model, sets, runs)
    say("shade, 1080p", rows)
    sets = sets_of(random_maps, sizes["1080p"], device)
    for name, nodes in LAYOUTS.items():
        model.layout = RuntimeLayout(nodes, model.layout.warp)
        with torch.no_grad():
            calls = [in_form(None, model, *maps) for maps in sets]
            rows = {"copy": device_ms(copy_calls(sets), runs), "triton": device_ms(calls, runs)}
        times[f"1080p, random, a {name} table"] = rows
        say(f"1080p, random, a {name} table {list(nodes)}", rows)
    return report


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--smoke", action="store_true", help="on the CPU, at a tiny size")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("results"))
    options = parser.parse_args()
    device = torch.device("cpu" if options.smoke else options.device)
    if not options.smoke:
        if not torch.cuda.is_available():
            print("gpu: expected an NVIDIA GPU that torch can use, got none", file=sys.stderr)
            return 2
        torch.cuda.set_device(device)
        if not simd.triton_runs(str(device)):
            said = simd.system_report()
            print(f"gpu: the Triton kernels do not run here: {said}", file=sys.stderr)
            return 2
    report = measure(device, options.runs)
    out = options.out / "gpu.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=2) + "\n")
    plot(report, out.with_suffix(".png"))
    return 0 if report["errors"]["worst region"] < LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
