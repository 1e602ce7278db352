"""The paper's rule outside the measured box, its formula fitted to the floor and to the surface.

Truth: real materials in 12,000 directions to 80° each (`whole_hemisphere`), which no fit sees.
Printed for each material, and as the median over all: the median relative error of Y and mean
|Δ log(1+Y)| outside the box, and the green exponent n.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import raden_torch as rt
from raden_torch.brdf.fitting.diffuse_fit import FITS
from raden_torch.brdf.fitting.score import reflectance_factors
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

DATA = Path(__file__).resolve().parents[2] / "shared/data/whole_hemisphere"
LEAST = 1e-9  # of a measured Y that an error is divided by


def outside(measured: BrdfMeasurement, truth: BrdfMeasurement) -> BrdfMeasurement:
    """The valid readings beyond the angles of a measurement."""
    low, high = measured.angles_deg.min(axis=0), measured.angles_deg.max(axis=0)
    beyond = ((truth.angles_deg < low) | (truth.angles_deg > high)).any(axis=1)
    return truth.select(beyond & truth.valid)


def errors(model: rt.RadenBrdf, truth: BrdfMeasurement) -> tuple[float, float]:
    """Median relative error of Y, and mean |Δ log(1+Y)|."""
    found = reflectance_factors(model, truth) @ np.linalg.inv(xyz_to_rgb_matrix())[1]
    y = truth.as_xyz().values[:, 1]
    logs = np.log1p(np.maximum(found, 0)) - np.log1p(np.maximum(y, 0))
    return float(np.median(abs(found - y) / np.maximum(y, LEAST))), float(np.mean(abs(logs)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--interpolation", default="auto", help="of the table; trilinear is fast")
    interpolation = parser.parse_args().interpolation
    found: dict[str, list[tuple[float, float]]] = {to: [] for to in FITS}
    for file in sorted(DATA.glob("*.hemisphere.csv")):
        name = file.name.removesuffix(".hemisphere.csv")
        measured = rt.load_measurement(DATA / f"{name}.csv")
        truth = outside(measured, rt.load_measurement(file))
        for to in FITS:
            result = rt.fit(measured, diffuse=to, outside="diffuse", interpolation=interpolation)
            found[to].append(errors(result.model, truth))
            relative, log = found[to][-1]
            n = result.report.diffuse_exponent[1]
            print(f"{name}, {to}: {relative:.3f}; {log:.3f}; n = {n:.2f}", flush=True)
    for to, scores in found.items():
        relative, log = np.median(scores, axis=0)
        worst, best = np.max(scores, axis=0)[0], np.min(scores, axis=0)[0]
        print(f"median, {to}: {relative:.3f} ({best:.2f} to {worst:.2f}); {log:.3f}")


if __name__ == "__main__":
    main()
