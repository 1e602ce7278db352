"""How fast the model is evaluated: ratios within one run, losses beside wins.

`naive` is what one writes first: `atan2`, `acos` and a 5-D `grid_sample`. `floor` copies a tensor
so that as many bytes move as the model reads and writes (48 a pixel: three maps in, one image out).
Each form is timed in turn, so that a drift of the machine hits all alike. Results go to
benchmarks/results/kernel.json; nothing is asserted.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

import raden_torch as rt
from raden_torch import geometry
from raden_torch.brdf import kernel
from raden_torch.brdf.model import CosineDiffuse
from raden_torch.brdf.table import ReflectanceTable

FRAME = (1080, 1920)
SIZES = [(64, 64), (256, 256), (512, 512), (1080, 1920), (2160, 3840), (4320, 7680)]
Maps = tuple[Tensor, Tensor, Tensor]


def naive(model: rt.RadenBrdf, normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """The straightforward form: cross products, quadrants, and one 5-D lookup."""
    n, l, v = (torch.nn.functional.normalize(m, dim=1) for m in (normal, light, view))  # noqa: E741
    p = torch.nn.functional.normalize(torch.linalg.cross(l, v, dim=1), dim=1)
    sine = geometry.dot(n, p)
    flat = torch.nn.functional.normalize(n - sine * p, dim=1)
    a = torch.atan2(geometry.dot(torch.linalg.cross(l, flat, dim=1), p), geometry.dot(l, flat))
    r = torch.atan2(geometry.dot(torch.linalg.cross(flat, v, dim=1), p), geometry.dot(flat, v))
    t = torch.pi / 2 - torch.acos(sine.clamp(-1, 1))
    flip = torch.where(a < 0, -1.0, 1.0)
    a, r, t = a * flip, r * flip, t * flip
    diffuse = model.diffuse(a, r, t)
    table = model.table
    position = torch.stack([t, r, a], -1).rad2deg()[:, :1]
    last, first = (torch.tensor(x[::-1]) for x in (table.last_deg, table.first_deg))
    at = 2 * (position - first) / (last - first) - 1
    values = table.values.permute(3, 0, 1, 2)[None]
    total = torch.nn.functional.grid_sample(
        values, at, padding_mode="border", align_corners=True
    ).squeeze(2)
    step = 2 * torch.tensor(table.step_deg[::-1]) / (last - first)
    weight = (1 - (at.abs() - 1).clamp(min=0) / step).clamp(min=0).prod(-1)
    f = diffuse + weight * (total - diffuse)
    return torch.where((geometry.dot(n, l) > 0) & (geometry.dot(n, v) > 0), f, 0.0)


def table_model(nodes: tuple[int, int, int]) -> rt.RadenBrdf:
    """A smooth lobe on 0…70° x ±70° x ±70°."""
    a, r, t = torch.meshgrid(
        torch.linspace(0, 70, nodes[0]), *(torch.linspace(-70, 70, n) for n in nodes[1:]),
        indexing="ij",
    )  # fmt: skip
    lobe = torch.exp(-(((r - a) / 12) ** 2) - (t / 12) ** 2)[..., None]
    values = 0.1 + lobe * torch.tensor([1.0, 1.5, 2.0])
    steps = (70 / (nodes[0] - 1), 140 / (nodes[1] - 1), 140 / (nodes[2] - 1))
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
    return rt.RadenBrdf(diffuse, ReflectanceTable(values, (0.0, -70.0, -70.0), steps))


def random_maps(height: int, width: int) -> Maps:
    """Every pixel a geometry of its own, most of them inside the table: the worst case."""

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


def times(forms: dict[str, Callable[[], object]], runs: int) -> dict[str, dict[str, float]]:
    """Milliseconds of each form, taken in turn."""
    taken: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(runs + 1):
        for name, form in forms.items():
            form()  # the one before must not leave its threads spinning or its caches warm
            start = time.perf_counter()
            form()
            taken[name].append(1e3 * (time.perf_counter() - start))
    return {
        name: {"median": statistics.median(ms[1:]), "least": min(ms[1:])}
        for name, ms in taken.items()
    }


def copy_of(pixels: int) -> Callable[[], object]:
    source, target = torch.rand(6 * pixels), torch.empty(6 * pixels)
    return lambda: target.copy_(source)


def at_level(level: str, form: Callable[..., object], *arguments: object) -> Callable[[], object]:
    def run() -> object:
        with kernel.using(level):
            return form(*arguments)

    return run


def forms_of(model: rt.RadenBrdf, maps: Maps) -> dict[str, Callable[[], object]]:
    forms: dict[str, Callable[[], object]] = {
        "floor": copy_of(maps[0].numel() // 3),
        "naive": lambda: naive(model, *maps),
        "eager": at_level(kernel.OFF, model, *maps),
    }
    return forms | {f"kernel {level}": at_level(level, model, *maps) for level in kernel.LEVELS}


def ratios(ms: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    return {
        name: {
            **taken,
            "x faster than naive": ms["naive"]["median"] / taken["median"],
            "x floor": taken["median"] / ms["floor"]["median"],
            "x floor, least times": taken["least"] / ms["floor"]["least"],
        }
        for name, taken in ms.items()
    }


def shading(model: rt.RadenBrdf, runs: int) -> dict[str, dict[str, float]]:
    """`shade` of a frame under two lamps: the whole of it, and a tenth."""
    normal, light, view = plate_maps(*FRAME)
    lamps = [rt.DirectionalLight((0.3, 0.2, 1.0)), rt.PointLight((0.5, 0.5, 2.0))]
    block = torch.zeros(1, 1, *FRAME)
    block[..., 300:700, 600:1118] = 1
    scattered = (torch.rand(1, 1, *FRAME, generator=torch.Generator().manual_seed(1)) < 0.1).float()
    forms = {}
    for name, mask in {"whole": None, "10 % block": block, "10 % scattered": scattered}.items():
        gbuffer = rt.GBuffer(normal, view, position=light, mask=mask)
        forms[name] = at_level(kernel.level(), rt.shade, model, gbuffer, lamps)
    gbuffer = rt.GBuffer(-normal, view, position=light)
    forms["back-facing"] = at_level(kernel.level(), rt.shade, model, gbuffer, lamps)
    gbuffer = rt.GBuffer(normal, view, position=light)
    forms["whole, eager"] = at_level(kernel.OFF, rt.shade, model, gbuffer, lamps)
    return times(forms, runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=11)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    small, baked = table_model((15, 29, 29)), table_model((57, 113, 113))
    report: dict[str, object] = {
        "machine": platform.processor() or platform.machine(),
        "threads": options.threads,
        "load": os.getloadavg(),
        "torch": torch.__version__,
        "levels": kernel.LEVELS,
    }
    with torch.no_grad():
        for table, model in {"15x29x29": small, "57x113x113": baked}.items():
            for scene, make in {"random": random_maps, "plate": plate_maps}.items():
                rows = ratios(times(forms_of(model, make(*FRAME)), options.runs))
                report[f"1080p, {table}, {scene}"] = rows
                print(f"\n1080p, table {table}, {scene} geometries")
                for name, row in rows.items():
                    print(
                        f"  {name:16s} {row['median']:8.2f} ms   {row['x faster than naive']:6.1f}"
                        f" x naive   {row['x floor']:6.2f} x floor"
                    )
        scaling = {}
        for size in SIZES:
            taken = times({"kernel": at_level(kernel.level(), small, *plate_maps(*size))}, 5)
            scaling[f"{size[0]}x{size[1]}"] = 1e6 * taken["kernel"]["median"] / (size[0] * size[1])
        report["ns a pixel"] = scaling
        print("\nns a pixel:", ", ".join(f"{size} {ns:.2f}" for size, ns in scaling.items()))
        report["shade"] = shaded = shading(small, options.runs)
        print("\nshade, two lamps, 1080p")
        for name, taken in shaded.items():
            share = taken["median"] / shaded["whole"]["median"]
            print(f"  {name:16s} {taken['median']:8.2f} ms   {100 * share:6.1f} % of the whole")
    out = Path(__file__).with_name("results") / "kernel.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
