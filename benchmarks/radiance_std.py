"""Standard deviations of a picture against Monte Carlo, and what they cost.

A simulated shell's values get stated errors: 1 % and 0.02 of a reading's own, a scale of 1 %, zeros
of 0.1 degrees. Measurements are drawn from them, fitted (`--interpolation`, by default chosen anew
in every draw) and shaded; the standard deviation of each pixel over the draws is compared with the
one that `shade(…, return_std=True)` gives of the values themselves. Own and systematic errors are
drawn apart, and together. Printed of propagated / drawn, over the pixels and channels: the median,
and the 5 % and 95 % quantiles, by scene and region; "outside" are pixels beyond the measured
angles. A drawn own standard deviation is itself uncertain by 1/√(2 draws); the four systematic
errors are drawn with exactly the stated covariance, so theirs is not.

Times are least processor times in one thread: of the fit, and of a 1080p frame with and without,
in memory that the process has already ("again"), and in turn, in fresh pages ("in turn"). Results
go to benchmarks/results/radiance_std_STEP_SCHEME.json; nothing is asserted.

    .venv/bin/python benchmarks/radiance_std.py --step 10 --draws 300
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from in_turn import least_cpu_ms
from torch import Tensor

import raden_torch as rt
from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.shading.radiance_std import RadianceStd
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.measurement.error_parts import ErrorParts, error_parts, zero_effects
from raden_torch.measurement.systematic_errors import SystematicErrors
from raden_torch.reflectance.regions import REGIONS, regions

OWN, FLOOR = 0.01, 0.02
STATED = SystematicErrors(scale_std=0.01, zero_std_deg=(0.1, 0.1, 0.1), white_deg=(45.0, 0.0, 0.0))
LAMP = (1.0, 1.0, 2.0)
SCENES = {
    "one lamp": [LAMP],
    "two lamps, 78 deg apart": [LAMP, (-1.0, -1.0, 2.0)],
    "two lamps, 2 deg apart": [LAMP, (1.05, 1.05, 2.0)],
}
KINDS = ("own", "systematic", "total")


def stated(name: str, step: float) -> rt.BrdfMeasurement:
    """The simulated shell with standard deviations: own errors, and what the zeros do."""
    m = rt.simulate_specimen(name, step_deg=step)
    m = replace(m, metadata=replace(m.metadata, systematic=STATED))
    own = OWN * abs(m.values) + FLOOR
    return replace(m, std=np.sqrt(own**2 + (zero_effects(m) ** 2).sum(-1)))


def drawn(
    m: rt.BrdfMeasurement,
    parts: ErrorParts,
    kind: str,
    common: Floats,
    random: np.random.Generator,
) -> rt.BrdfMeasurement:
    """A measurement whose errors are as stated; `common` are those of scale and zeros, `[4]`."""
    values = parts.values.copy()
    if kind != "own":
        values += parts.zeros @ common[1:]
        values *= 1 + STATED.scale_std * common[0]
    if kind != "systematic":
        values += np.sqrt(parts.variance) * random.normal(size=values.shape)
    return replace(m, values=values, std=None)


def monte_carlo(
    m: rt.BrdfMeasurement,
    draws: int,
    kinds: list[str],
    interpolation: str,
    gbuffer: rt.GBuffer,
) -> dict[str, dict[str, tuple[Floats, Floats]]]:
    """By scene and kind: mean and standard deviation of each pixel over the draws."""
    parts = error_parts(m, m.channels)
    random = np.random.default_rng(1)
    common = random.normal(size=(draws, 4))
    common -= common.mean(0)
    common = common @ np.linalg.inv(np.linalg.cholesky(common.T @ common / draws)).T
    sums = {s: {k: np.zeros((2, *gbuffer.normal.shape)) for k in kinds} for s in SCENES}
    for draw in range(draws):
        for kind in kinds:
            model = rt.fit(
                drawn(m, parts, kind, common[draw], random), interpolation=interpolation
            ).model
            for scene, picture in pictures(model, gbuffer):
                x = picture.double().numpy()
                sums[scene][kind] += np.stack([x, x**2])
        if draw % 20 == 19:
            print(f"{draw + 1} of {draws} draws", flush=True)
    moments = {s: {k: v / draws for k, v in of.items()} for s, of in sums.items()}
    return {
        s: {k: (v[0], np.sqrt(np.maximum(v[1] - v[0] ** 2, 0))) for k, v in of.items()}
        for s, of in moments.items()
    }


def pictures(model: rt.RadenBrdf, gbuffer: rt.GBuffer) -> Iterator[tuple[str, Tensor]]:
    with torch.no_grad():
        for scene, lamps in SCENES.items():
            yield scene, rt.shade(model, gbuffer, [rt.DirectionalLight(x) for x in lamps])


def places(gbuffer: rt.GBuffer, model: rt.RadenBrdf) -> dict[str, Bools]:
    """`[H, W]` by region, of the first lamp."""
    light = torch.tensor(LAMP).view(1, 3, 1, 1).expand_as(gbuffer.normal)
    angles = rt.raden_angles(gbuffer.normal, light, gbuffer.view_map(gbuffer.normal))
    degrees = np.rad2deg(torch.cat(angles, 1)[0].reshape(3, -1).T.numpy())
    low, high = np.array(model.measured_box_deg).T
    inside = ((degrees >= low) & (degrees <= high)).all(1)
    shape = gbuffer.normal.shape[2:]
    found = {name: (mask & inside).reshape(shape) for name, mask in regions(degrees).items()}
    return {**found, "outside": (~inside).reshape(shape)}


def compared(std: RadianceStd, mean: Floats, truth: Floats, kind: str, where: Bools) -> list[float]:
    """Median, 5 % and 95 % quantile of propagated / drawn; and how many pixels."""
    ours = getattr(std, kind).double().numpy()[0]
    lit = where & (mean[0].min(0) > 0.005 * mean.max()) & (truth[0].min(0) > 0)
    if lit.sum() < 10:
        return []
    ratio = (ours / np.maximum(truth[0], 1e-12))[:, lit]
    return [*np.quantile(ratio, (0.5, 0.05, 0.95)).round(3).tolist(), int(lit.sum())]


def frame_ms(model: rt.RadenBrdf, lamps: int, runs: int) -> dict[str, dict[str, float]]:
    """A 1080p frame of waves, under some lamps, with and without standard deviations."""
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, 1080), torch.linspace(-1.8, 1.8, 1920), indexing="ij"
    )
    waves = torch.stack([0.3 * torch.sin(7 * x), 0.3 * torch.cos(5 * y), torch.ones_like(x)])[None]
    view = torch.stack([-0.2 * x, -0.2 * y, torch.ones_like(x)])[None]
    gbuffer = rt.GBuffer(waves / waves.norm(dim=1, keepdim=True), view=view)
    lights = [rt.DirectionalLight((1, 0.8 * k - 0.5, 2)) for k in range(lamps)]

    def plain() -> None:
        rt.shade(model, gbuffer, lights)

    def with_std() -> None:
        rt.shade(model, gbuffer, lights, return_std=True)

    jobs = {"frame": plain, "frame with std": with_std}
    with torch.no_grad():
        again = {name: least_cpu_ms({name: job}, runs)[name] for name, job in jobs.items()}
        return {"again": again, "in turn": least_cpu_ms(jobs, runs)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--specimen", default="yakogai")
    parser.add_argument("--step", type=float, default=10.0)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--interpolation", default="auto")
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--runs", type=int, default=15)
    given = parser.parse_args()
    torch.set_num_threads(1)
    m = stated(given.specimen, given.step)
    start = time.process_time()
    plain = rt.fit(m, interpolation=given.interpolation)
    between = time.process_time()
    model = rt.fit(m, interpolation=given.interpolation, std=True).model
    seconds = between - start, time.process_time() - between
    print(f"fit {seconds[0]:.1f} s, with std {seconds[1]:.1f} s: {plain.report.interpolation}")
    times = {str(k): frame_ms(model, k, given.runs) for k in (1, 3)}
    print("1080p", times)
    gbuffer = sphere(given.size, samples=1)
    where = places(gbuffer, model)
    truth = monte_carlo(m, given.draws, given.kinds, given.interpolation, gbuffer)
    report: dict[str, dict[str, dict[str, list[float]]]] = {}
    with torch.no_grad():
        for scene, lamps in SCENES.items():
            lights = [rt.DirectionalLight(x) for x in lamps]
            _, std = rt.shade(model, gbuffer, lights, return_std=True)
            masks = {"all": np.logical_or.reduce(list(where.values())), **where}
            for kind in given.kinds:
                mean, scatter = truth[scene][kind]
                rows = {
                    name: compared(std, mean, scatter, kind, masks[name])
                    for name in ("all", *REGIONS, "outside")
                }
                report.setdefault(scene, {})[kind] = rows
                for name, row in rows.items():
                    if row:
                        print(f"{scene:26}{kind:12}{name:9}", *row)
    head = {"machine": platform.processor() or platform.machine(), **vars(given)}
    out = (
        Path(__file__).with_name("results")
        / f"radiance_std_{given.step:g}_{given.interpolation}.json"
    )
    out.parent.mkdir(exist_ok=True)
    head |= {"fit_s": seconds, "chosen": plain.report.interpolation, "frame_ms": times}
    out.write_text(json.dumps({**head, "propagated_over_drawn": report}, indent=1) + "\n")
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
