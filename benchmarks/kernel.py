"""How fast the model is evaluated: ratios within one run, losses beside wins.

`naive` is what one writes first (`raden_torch.bench.naive`). `floor` copies a tensor, so that as
many bytes move as the model reads and writes (48 a pixel: three maps in, one image out). Each form
is timed in turn, so that a drift of the machine hits all alike. What is skipped is counted in CPU
seconds of one thread, which neighbours on the machine disturb less. Results go to
benchmarks/results/kernel.json and kernel.png; nothing is asserted.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.bench import naive
from raden_torch.bench.forms import with_nodes
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.layout_choice import NODES

FRAME = (1080, 1920)
TABLES = (40_000, NODES, 600_000)
"""The most nodes that a runtime table may have."""
SIZES = [(64, 64), (256, 256), (512, 512), (1080, 1920), (2160, 3840), (4320, 7680)]
Maps = tuple[Tensor, Tensor, Tensor]
Forms = dict[str, Callable[[], object]]


def paper_model() -> rt.RadenBrdf:
    """The built-in shell as the naive form reads it: trilinear, within the measured box."""
    measured = rt.simulate_specimen("yakogai")
    return rt.fit(measured, interpolation="trilinear", outside="diffuse").model


def random_maps(height: int, width: int) -> Maps:
    """Every pixel a geometry of its own, most of them inside the measured box: the worst case."""

    def one(seed: int, spread: float) -> Tensor:
        v = torch.randn(1, 3, height, width, generator=torch.Generator().manual_seed(seed))
        v = v * spread
        v[:, 2] = v[:, 2].abs() + 1
        return torch.nn.functional.normalize(v, dim=1)

    return one(1, 0.2), one(2, 0.4), one(3, 0.4)


def plate_maps(height: int, width: int) -> Maps:
    """A wavy plate under a near lamp and a near camera: neighbours are alike, as in pictures."""
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, height), torch.linspace(-1.8, 1.8, width), indexing="ij"
    )
    one = torch.ones_like(x)
    maps = (
        torch.stack([0.3 * torch.sin(9 * x), 0.3 * torch.sin(8 * y + x), one]),
        torch.stack([1 - x, 1 - y, 2 * one]),
        torch.stack([-x, -y, 3 * one]),
    )
    n, l, v = (torch.nn.functional.normalize(m, dim=0)[None] for m in maps)  # noqa: E741
    return n, l, v


SCENES = {"random": random_maps, "plate": plate_maps}
WORK = ("evaluated", "trained")


def times(
    forms: dict[str, Callable[[], object]],
    runs: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, dict[str, float]]:
    """Milliseconds of each form, taken in turn."""
    taken: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(runs + 1):
        for name, form in forms.items():
            form()  # the one before must not leave its threads spinning or its caches warm
            start = clock()
            form()
            taken[name].append(1e3 * (clock() - start))
    return {
        name: {"median": statistics.median(ms[1:]), "least": min(ms[1:])}
        for name, ms in taken.items()
    }


def copy_of(pixels: int) -> Callable[[], object]:
    source, target = torch.rand(6 * pixels), torch.empty(6 * pixels)
    return lambda: target.copy_(source)


def at_level(level: str, form: Callable[..., object], *arguments: object) -> Callable[[], object]:
    def run() -> object:
        with simd.using(level):
            return form(*arguments)

    return run


def forms_of(paper: rt.RadenBrdf, model: rt.RadenBrdf, maps: Maps) -> Forms:
    """The model's forms, beside the naive form of the paper's."""
    forms: Forms = {
        "floor": copy_of(maps[0].numel() // 3),
        "naive": lambda: naive(paper, *maps),
        "eager": at_level(simd.OFF, model, *maps),
    }
    return forms | {f"kernel {level}": at_level(level, model, *maps) for level in simd.LEVELS}


def training(paper: rt.RadenBrdf, model: rt.RadenBrdf, maps: Maps) -> Forms:
    """Forward and backward by normals, table and diffuse part."""
    change = torch.randn(maps[0].shape, generator=torch.Generator().manual_seed(5))

    def step(form: Callable[..., Tensor], of: rt.RadenBrdf, level: str) -> Callable[[], object]:
        def run() -> None:
            normal = maps[0].clone().requires_grad_()
            with simd.using(level), torch.enable_grad():
                form(normal, *maps[1:]).backward(change)
            of.zero_grad()

        return run

    forms: Forms = {
        "floor": copy_of(maps[0].numel() // 3),
        "naive": step(partial(naive, paper), paper, simd.OFF),
        "eager": step(model, model, simd.OFF),
    }
    return forms | {f"kernel {level}": step(model, model, level) for level in simd.LEVELS}


def sizes_of(model: rt.RadenBrdf, maps: Maps) -> Forms:
    """The fastest kernel with runtime tables of several sizes."""
    found: Forms = {"floor": copy_of(maps[0].numel() // 3)}
    for nodes in TABLES:
        of = with_nodes(model, nodes)
        found[f"{of.layout.nodes} nodes"] = at_level(simd.level(), of, *maps)
    return found


def ratios(ms: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Each time over the floor, and over the naive form where it is among them."""
    found = {}
    for name, taken in ms.items():
        found[name] = {
            **taken,
            "x floor": taken["median"] / ms["floor"]["median"],
            "x floor, least times": taken["least"] / ms["floor"]["least"],
        }
        if "naive" in ms:
            found[name]["x faster than naive"] = ms["naive"]["median"] / taken["median"]
    return found


def skipping(model: rt.RadenBrdf, runs: int) -> dict[str, dict[str, float]]:
    """What a frame costs that leaves something out, in CPU time of one thread."""
    normal, light, view = plate_maps(*FRAME)
    lamps = [rt.DirectionalLight((0.3, 0.2, 1.0)), rt.PointLight((0.5, 0.5, 2.0))]
    generator = torch.Generator().manual_seed(1)
    inlay = (torch.rand(1, 1, 9, 15, generator=generator) < 0.1).float()
    inlay = inlay.repeat_interleave(120, 2).repeat_interleave(128, 3)
    scattered = (torch.rand(1, 1, *FRAME, generator=generator) < 0.1).float()
    down, across = (torch.arange(n, dtype=torch.float32) for n in FRAME)

    def discs(height: int, width: int) -> Tensor:
        """One in the middle of each rectangle, of a tenth of its area."""
        square = (down[:, None] % height - height / 2) ** 2 + (across % width - width / 2) ** 2
        return (square < 0.1 * height * width / math.pi).float()[None, None]

    masks = {
        "whole": None,
        "a mask of ones": torch.ones(1, 1, *FRAME),
        "a mask of zeros": torch.zeros(1, 1, *FRAME),
        f"{100 * float(inlay.mean()):.1f} % in pieces": inlay,
        "10 % as one disc": discs(*FRAME),
        "10 % as 864 discs": discs(40, 60),
        "10 % scattered": scattered,
    }
    forms: Forms = {"reading a mask": scattered.sum}

    def add(name: str, gbuffer: rt.GBuffer, lights: list[rt.DirectionalLight], **options) -> None:
        forms[name] = at_level(simd.level(), partial(rt.shade, **options), model, gbuffer, lights)

    for name, mask in masks.items():
        add(name, rt.GBuffer(normal, view, position=light, mask=mask), lamps)
    add("back-facing", rt.GBuffer(-normal, view, position=light), lamps)
    add("no light", rt.GBuffer(normal, view), [])

    x, y = (
        c.expand(FRAME)
        for c in (torch.linspace(-18, 18, FRAME[1]), torch.linspace(-10, 10, FRAME[0])[:, None])
    )
    far = torch.stack([x, y, torch.zeros(FRAME)])[None]
    at = (torch.rand(32, 3, generator=generator) - 0.5) * torch.tensor([36.0, 20.0, 0.0])
    at[:, 2] = 0.5
    wide = rt.GBuffer(normal, view=(0.0, 0.0, 1.0), position=far)
    spots = [rt.SpotLight(p, p - torch.tensor([0.0, 0.0, 1.0]), outer_deg=40) for p in at]
    points = [rt.PointLight(p) for p in at]
    suns = [rt.DirectionalLight(p / 20 + torch.tensor([0.0, 0.0, 1.0])) for p in at]
    add("32 points", wide, points)
    add("32 points, 1 % of the peak may be lost", wide, points, tolerance=peak(model, wide, points))
    add("32 spots, 1/400 of the plate each", wide, spots)
    large = rt.GBuffer(plate_maps(2160, 3840)[0], view=(0.0, 0.0, 1.0))
    for count in (1, 8, 32):
        one_percent = peak(model, large, suns[:count])
        add(f"4K, {count} distant", large, suns[:count])
        add(f"4K, {count} distant, 1 % of the peak", large, suns[:count], tolerance=one_percent)
    torch.set_num_threads(1)
    return times(forms, runs, time.process_time)


def peak(model: rt.RadenBrdf, gbuffer: rt.GBuffer, lights: list[rt.DirectionalLight]) -> float:
    """One percent of the largest radiance."""
    return float(rt.shade(model, gbuffer, lights).amax()) / 100


def say_ratios(name: str, rows: dict[str, dict[str, float]]) -> None:
    print(f"\n{name}")
    for form, row in rows.items():
        text = f"  {form:16s} {row['median']:8.2f} ms   {row['x floor']:6.2f} x floor"
        if "x faster than naive" in row:
            text += f"   {row['x faster than naive']:6.1f} x faster than naive"
        print(text, flush=True)


def plot(report: dict[str, object], path: Path) -> None:
    """Every form's time over the floor, evaluated and trained."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.5), layout="constrained")
    for ax, work in zip(figure.subplots(1, 2, sharey=True), WORK, strict=True):
        for scene in SCENES:
            rows = report[f"1080p {work}, {scene} geometries"]
            forms = {form: row["x floor"] for form, row in rows.items() if form != "floor"}
            ax.plot(list(forms), list(forms.values()), "o-", label=f"{scene} geometries")
        ax.set(yscale="log", title=f"1080p {work}", ylabel="time / copy of 48 bytes a pixel")
        ax.tick_params(axis="x", rotation=30)
        ax.grid(alpha=0.3, which="both")
        ax.legend(fontsize=7)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    paper, model = paper_model(), rt.fit(rt.simulate_specimen("yakogai")).model
    report: dict[str, object] = {
        "machine": platform.processor() or platform.machine(),
        "threads": options.threads,
        "load": os.getloadavg(),
        "torch": torch.__version__,
        "levels": simd.LEVELS,
    }
    with torch.no_grad():
        for scene, make in SCENES.items():
            maps = make(*FRAME)
            for work, forms, runs in (
                (WORK[0], forms_of(paper, model, maps), options.runs),
                (WORK[1], training(paper, model, maps), max(1, options.runs // 4)),
            ):
                name = f"1080p {work}, {scene} geometries"
                report[name] = rows = ratios(times(forms, runs))
                say_ratios(name, rows)
        name = "1080p evaluated by size of the table, random geometries"
        report[name] = rows = ratios(times(sizes_of(model, random_maps(*FRAME)), options.runs))
        say_ratios(name, rows)
        scaling = {}
        for size in SIZES:
            taken = times({"kernel": at_level(simd.level(), model, *plate_maps(*size))}, 5)
            scaling[f"{size[0]}x{size[1]}"] = 1e6 * taken["kernel"]["median"] / (size[0] * size[1])
        report["ns a pixel"] = scaling
        print("\nns a pixel:", ", ".join(f"{size} {ns:.2f}" for size, ns in scaling.items()))
        report["skipping"] = skipped = skipping(model, max(3, options.runs // 3))
        print("\nwhat is left out, in CPU milliseconds of one thread; 1080p where not said")
        for name, taken in skipped.items():
            share = taken["median"] / skipped["whole"]["median"]
            print(f"  {name:40s} {taken['median']:8.2f} ms   {100 * share:6.1f} % of the whole")
    out = Path(__file__).with_name("results") / "kernel.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=2) + "\n")
    plot(report, out.with_suffix(".png"))


if __name__ == "__main__":
    main()
