"""A frame under an environment: error and time of distant lamps and of the prefiltered table.

Errors are against every texel as a lamp, over the peak of the picture, at pixels of a sphere that
are spread evenly. Times are CPU seconds of one thread by turns, over those of one lamp on the same
frame. Results go to benchmarks/results/environment.json and .png; nothing is asserted.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.files.environment_file import load_environment
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.brdf.model import simd
from raden_torch.brdf.shading import latlong
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.sphere_gbuffer import sphere

SHARED = Path(__file__).parents[2] / "shared/data/lightprobe/Grace_Cathedral.hdr"
LAMPS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
SIZE = 1440
"""Pixels a side of the sphere, as many as 1080p."""
EVERY = 18
"""Pixel along each side is compared."""
MANY = 64
"""Lamps that are timed once, without a warm-up."""
LAMP = rt.DirectionalLight((1.0, 1.0, 2.0))
Row = dict[str, float]


def built_in(height: int = 128) -> EnvironmentLight:
    """A dim room with a gradient, a window and two small lamps (made by code)."""
    x, y, z = latlong.directions(height, 2 * height)
    window = (x < -0.3) & (y.abs() < 0.4) & (z > -0.2)
    radiance = torch.stack([0.20 + 0.1 * y, 0.2 + 0.12 * y, 0.22 + 0.16 * y])
    radiance[:, window] = torch.tensor([3.0, 3.4, 4.0], dtype=torch.float64)[:, None]
    for at, colour in (((0.5, 0.7, 0.5), (300, 240, 160)), ((0.1, 0.3, -0.9), (80, 90, 100))):
        axis = torch.nn.functional.normalize(torch.tensor(at, dtype=torch.float64), dim=0)
        lit = torch.einsum("c,chw->hw", axis, torch.stack([x, y, z])) > math.cos(math.radians(2.5))
        radiance[:, lit] = torch.tensor(colour, dtype=torch.float64)[:, None]
    return EnvironmentLight(radiance.float())


def materials() -> dict[str, Reflection]:
    """A shell of broad lobes, one of narrower ones, and a polished coat."""
    return {
        "mexican shell (matt)": rt.fit(rt.simulate_specimen("mexican")).model,
        "akoya shell (lustrous)": rt.fit(rt.simulate_specimen("akoya")).model,
        "black urushi, roughness 0.07 (polished)": black_urushi(0.07),
    }


def scene(size: int, near: bool) -> rt.GBuffer:
    ball = sphere(size, samples=1)
    return ball if near else rt.GBuffer(ball.normal, view=(0.1, 0.0, 1.0), mask=ball.mask)


def thinned(gbuffer: rt.GBuffer) -> rt.GBuffer:
    maps = {
        name: value[..., ::EVERY, ::EVERY].contiguous() if value.shape[-1] > 1 else value
        for name, value in vars(gbuffer).items()
        if isinstance(value, Tensor)
    }
    return replace(gbuffer, **maps)


def error_of(image: Tensor, truth: Tensor, mask: Tensor) -> Row:
    """Percent of the peak."""
    error = 100 * ((image - truth) / truth.max())[:, :, mask[0, 0] > 0]
    return {"rms": float(error.square().mean().sqrt()), "max": float(error.abs().max())}


def over_one_lamp(
    material: Reflection, gbuffer: rt.GBuffer, light: EnvironmentLight, runs: int
) -> Row:
    """The time over one lamp's, and both in CPU seconds, the least of the runs."""
    taken: dict[str, list[float]] = {"seconds": [], "one lamp": []}
    for _ in range(runs + 1):
        for name, by in (("seconds", light), ("one lamp", LAMP), ("one lamp", LAMP)):
            start = time.process_time()
            rt.shade(material, gbuffer, by)
            taken[name].append(time.process_time() - start)
    found = {name: min(times) for name, times in taken.items()}
    return {**found, "x one lamp": found["seconds"] / found["one lamp"]}


def measured(
    material: Reflection, light: EnvironmentLight, runs: int, say: Callable[[str, Row], None]
) -> dict[str, Row]:
    """Every form's error and time."""
    rows: dict[str, Row] = {}
    for near in (False, True):
        camera = "near camera" if near else "far camera"
        frame = scene(SIZE, near)
        some = thinned(frame)
        assert some.mask is not None
        truth = rt.shade(material, some, replace(light, samples="all"))
        if not near:
            for count in LAMPS:
                lamps = replace(light, samples=count)
                row = error_of(rt.shade(material, some, lamps), truth, some.mask)
                row |= over_one_lamp(material, frame, lamps, runs if count < MANY else 0)
                rows[str(count)] = row
                say(f"{count} lamps", row)
        start = time.process_time()
        image = rt.shade(material, frame, light)
        first = time.process_time() - start
        row = error_of(image[..., ::EVERY, ::EVERY], truth, some.mask)
        row |= {"first frame": first, **over_one_lamp(material, frame, light, runs)}
        rows[f"table, {camera}"] = row
        say(f"table, {camera}", row)
        if type(material) is not rt.RadenBrdf:  # minutes
            break
    return rows


def plot(report: dict[str, dict[str, Row]], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.4), layout="constrained")
    by_count, by_time = figure.subplots(1, 2, sharey=True)
    for number, (name, rows) in enumerate(report.items()):
        colour = f"C{number}"
        lamps = [row for form, row in rows.items() if form.isdigit()]
        counts = [int(form) for form in rows if form.isdigit()]
        times = [row["x one lamp"] for row in lamps]
        for ax, across in ((by_count, counts), (by_time, times)):
            for kind, style in (("rms", "o-"), ("max", ".:")):
                label = f"{name}, {kind}" if ax is by_count else None
                ax.plot(across, [row[kind] for row in lamps], style, color=colour, label=label)
        for form, row in rows.items():
            if form.isdigit():
                continue
            marker = "s" if "far" in form else "^"
            for kind, fill in (("rms", colour), ("max", "none")):
                by_time.plot(row["x one lamp"], row[kind], marker, color=colour, mfc=fill, ms=8)
    for marker, camera in (("s", "far"), ("^", "near")):
        by_time.plot([], [], marker, color="grey", ls="", label=f"table, {camera} camera")
    by_count.set(xlabel="lamps by median cut", ylabel="error, % of the picture's peak")
    by_time.set(xlabel="CPU time / one lamp's on the same frame; open: largest error")
    for ax in (by_count, by_time):
        ax.set(xscale="log", yscale="log")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", type=Path, help="a lat-long .hdr or .exr")
    parser.add_argument("--built-in", action="store_true", help="the map made by code")
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    path = options.map or (SHARED if SHARED.exists() and not options.built_in else None)
    light = built_in() if path is None else load_environment(path)
    torch.set_num_threads(1)

    def say(form: str, row: Row) -> None:
        print(
            f"  {form:20s} RMS {row['rms']:7.3f} %  max {row['max']:7.2f} %  "
            f"{row['x one lamp']:8.2f} x one lamp  {row['seconds']:.3f} s",
            flush=True,
        )

    report: dict[str, dict[str, Row]] = {}
    load = os.getloadavg()
    with torch.no_grad():
        for name, material in materials().items():
            print(name)
            report[name] = measured(material, light, options.runs, say)
    out = Path(__file__).with_name("results") / "environment.json"
    out.parent.mkdir(exist_ok=True)
    head = {
        "map": "built in" if path is None else path.name,
        "texels": list(light.radiance.shape[1:]),
        "machine": platform.processor() or platform.machine(),
        "instructions": simd.level(),
        "threads": 1,
        "load": load,
        "torch": torch.__version__,
    }
    out.write_text(json.dumps({**head, "materials": report}, indent=2) + "\n")
    plot(report, out.with_suffix(".png"))
    print(head)


if __name__ == "__main__":
    main()
