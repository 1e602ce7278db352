"""`fit`: a measurement becomes a model, and says how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from raden_torch.brdf.diffuse_fit import DiffuseParameters, fit_diffuse
from raden_torch.brdf.fit_report import FitReport, make_report
from raden_torch.brdf.model import CosineDiffuse, Provenance, RadenBrdf
from raden_torch.brdf.table import ReflectanceTable
from raden_torch.brdf.tabulate import Tabulated, tabulate
from raden_torch.measurement import BrdfMeasurement


@dataclass(frozen=True)
class FitResult:
    """A fitted model and how it came about."""

    model: RadenBrdf
    report: FitReport


def fit(measurement: BrdfMeasurement, *, diffuse: DiffuseParameters | None = None) -> FitResult:
    """Fit the model of Take (2012) to a measurement.

    Args:
        measurement: readings on a grid of incidence × receiving × tilt, whose gaps are filled; or
            scattered readings, which are regularised onto a 5 degree table. Bands that make no
            colour give a grey model.
        diffuse: the diffuse parameters, set by hand as in the paper; fitted where None.

    Returns:
        The model (float32, on the CPU) and a report.

    Raises:
        InputError: fewer than two values on an axis, no valid reading, or a table too large.
    """
    table = tabulate(measurement)
    parameters = diffuse or fit_diffuse(table.reading_angles, table.readings)
    model = _assemble(table, parameters)
    report = make_report(measurement, table, model, parameters, fitted=diffuse is None)
    meta = measurement.metadata
    model.provenance = Provenance(
        meta.sample, meta.instrument, meta.simulated, measurement.sha256, report.as_dict()
    )
    return FitResult(model, report)


def _assemble(tabulated: Tabulated, parameters: DiffuseParameters) -> RadenBrdf:
    diffuse = CosineDiffuse(
        *(torch.tensor(v, dtype=torch.float32) for v in (parameters.scale, parameters.exponent))
    )
    a, r, t = tabulated.axes_deg
    angles = np.meshgrid(*map(np.deg2rad, (a, r, t)), indexing="ij")
    with torch.no_grad():
        part = diffuse(*(torch.from_numpy(angle)[:, None] for angle in angles))  # [A, 3, R, T]
    part_at_nodes = part.movedim(1, -1).numpy()
    total = np.where(np.isnan(tabulated.values), part_at_nodes, tabulated.values)
    table = ReflectanceTable(
        torch.from_numpy(total).float(),
        first_deg=(float(a[0]), float(r[0]), float(t[0])),
        step_deg=(float(a[1] - a[0]), float(r[1] - r[0]), float(t[1] - t[0])),
    )
    return RadenBrdf(diffuse, table)
