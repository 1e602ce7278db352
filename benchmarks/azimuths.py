"""The error of a model of several sample azimuths between them, on simulated shells.

    python benchmarks/azimuths.py [--out DIR]

Two shells whose truth is known at every azimuth: yakogai, whose film planes lean to both sides
(half a turn leaves it as it is), and akoya whose layers lean by 5 degrees against the surface to
one side (a whole turn). Each is scanned on the 5 degree grid at 4, 8 and 12 azimuths over its
period, fitted azimuth by azimuth with cubic interpolation, and compared with the truth at 4000
geometries of the box, half of them near the mirror direction: at random azimuths, at the scanned
ones, and with its mean, which knows no azimuth. Prints RMS error of f_r over the RMS of f_r, for
the table of docs/accuracy.md; highlight: the half vector within 15 degrees of the normal.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.optics.shell_colour import ShellColour
from raden_torch.optics.specimens import directions, turned

TESTS, LEAN_DEG, COUNTS = 4000, 5.0, (4, 8, 12)
GRID_DEG = np.stack(
    np.meshgrid(
        np.arange(0, 71, 5.0), np.arange(-70, 71, 5.0), np.arange(-70, 71, 5.0), indexing="ij"
    ),
    axis=-1,
).reshape(-1, 3)

Truth = Callable[[Floats, Floats], Floats]
"""XYZ reflectance factors `[M, 3]` of angles `[M, 3]` and azimuths `[M]` in degrees."""


def truth_of(name: str, lean_deg: float) -> Truth:
    colour, lean = ShellColour.of(name), np.radians(lean_deg)
    to_layers = np.array(
        [[np.cos(lean), 0, -np.sin(lean)], [0, 1, 0], [np.sin(lean), 0, np.cos(lean)]]
    )

    def factors(angles_deg: Floats, azimuth_deg: Floats) -> Floats:
        light, view = directions(np.radians(angles_deg))
        light, view = (turned(x, -np.radians(azimuth_deg)) @ to_layers.T for x in (light, view))
        above = (light[:, 2] > 1e-6) & (view[:, 2] > 1e-6)
        f = np.zeros((len(light), 3))
        f[above] = colour.xyz_per_sr(light[above], view[above])
        return FACTOR_PER_SR * f

    return factors


def measured(truth: Truth, angles_deg: Floats, azimuth_deg: float | Floats) -> BrdfMeasurement:
    azimuth = np.broadcast_to(azimuth_deg, len(angles_deg)).astype(float)
    return BrdfMeasurement(*angles_deg.T, truth(angles_deg, azimuth), azimuth_deg=azimuth)


def f_r(model: AnisotropicBrdf, angles_deg: Floats, azimuth_deg: Floats | None) -> Floats:
    """`[M, 3]` linear RGB in 1/sr; the mean where no azimuth is given."""
    light, view = directions(np.radians(angles_deg))
    n, l, v = (  # noqa: E741
        torch.from_numpy(np.array(x.T)).float().view(1, 3, -1, 1)
        for x in (np.broadcast_to([0.0, 0.0, 1.0], light.shape), light, view)
    )
    tangent = None
    if azimuth_deg is not None:
        angle = np.radians(azimuth_deg)
        along = np.stack([np.cos(angle), np.sin(angle), 0 * angle])
        tangent = torch.from_numpy(along).float().view(1, 3, -1, 1)
    with torch.no_grad():
        return model(n, l, v, tangent)[0, :, :, 0].T.numpy().astype(float)


def errors(found: Floats, true: Floats, highlight: Floats) -> dict[str, float]:
    parts = {"all": np.ones(len(true), bool), "highlight": highlight}
    return {
        name: float(np.sqrt(np.mean((found[m] - true[m]) ** 2) / np.mean(true[m] ** 2)))
        for name, m in parts.items()
    }


def rows_of(name: str, lean_deg: float, period: float) -> list[dict[str, object]]:
    truth, rng = truth_of(name, lean_deg), np.random.default_rng(5)
    angles = rng.uniform([0, -70, -70], [70, 70, 70], (TESTS, 3))
    angles[::2, 1] = np.clip(angles[::2, 0] + rng.normal(0, 8, len(angles[::2])), -70, 70)
    angles[::2, 2] = rng.normal(0, 8, len(angles[::2]))
    azimuth = rng.uniform(0, period, TESTS)
    light, view = directions(np.radians(angles))
    half = light + view
    highlight = half[:, 2] > np.cos(np.radians(15)) * np.linalg.norm(half, axis=1)
    true = measured(truth, angles, azimuth).as_rgb().values / FACTOR_PER_SR
    models = {}
    rows: list[dict[str, object]] = []
    for count in COUNTS:
        nodes = np.arange(count) * period / count
        for node in nodes:
            if node not in models:
                part = measured(truth, GRID_DEG, node)
                models[node] = fit(part, interpolation="cubic").model
        model = AnisotropicBrdf([models[x] for x in nodes], nodes.tolist(), period_deg=period)
        on = rng.choice(nodes, TESTS)
        at_nodes = measured(truth, angles, on).as_rgb().values / FACTOR_PER_SR
        row: dict[str, object] = {"shell": name, "lean": lean_deg, "azimuths": count}
        row["between"] = errors(f_r(model, angles, azimuth), true, highlight)
        row["at"] = errors(f_r(model, angles, on), at_nodes, highlight)
        row["mean"] = errors(f_r(model, angles, None), true, highlight)
        print(json.dumps(row), flush=True)
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    given = parser.parse_args()
    rows = [*rows_of("yakogai", 0.0, 180.0), *rows_of("akoya", LEAN_DEG, 360.0)]
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "azimuths.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
