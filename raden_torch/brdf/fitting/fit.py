"""`fit`: fit a model to a measurement and report how well it fits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.diffuse_fit import FITS, DiffuseParameters, fit_diffuse
from raden_torch.brdf.fitting.error_tables import check_errors, error_tables
from raden_torch.brdf.fitting.fit_report import BY_HAND, FitReport, make_report
from raden_torch.brdf.fitting.interpolated_table import choose_interpolation, make_table
from raden_torch.brdf.fitting.tabulate import MAX_CELLS, Tabulated, tabulate
from raden_torch.brdf.model.layout_choice import choose_layout
from raden_torch.brdf.model.model import CosineDiffuse, Provenance, RadenBrdf
from raden_torch.errors import InputError, check_type
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.continuation import to_horizon

OUTSIDE = ("continued", "diffuse")


@dataclass(frozen=True)
class FitResult:
    """A fitted model and how it came about."""

    model: RadenBrdf
    report: FitReport


def fit(
    measurement: BrdfMeasurement,
    *,
    diffuse: DiffuseParameters | str | None = None,
    interpolation: str = "auto",
    validation: BrdfMeasurement | None = None,
    assume: str | None = None,
    outside: str = "continued",
    std: bool = False,
) -> FitResult:
    """Fit the model of Take (2012) to a measurement.

    Args:
        measurement: readings on a grid of incidence × receiving × tilt, whose gaps are filled; or
            scattered readings, which are kriged onto a 5 degree table. Bands that make no colour
            give a grey model.
        diffuse: what the diffuse formula follows more than 20 degrees off the mirror direction:
            "floor" (or None), the low values, as in the paper's fig. 6; "surface", the median, as
            in figs 7 and 8; or its parameters, set by hand. It decides what stands outside the box
            with `outside="diffuse"`, and how the gains I_d and I_s share the table out; in the box,
            with both at 1, the model is the same.
        interpolation: what lies between the nodes: "trilinear" (the paper), "cubic", "lobes" (see
            `reflectance.interpolation`), "kriging" (of scattered readings), or "auto": kriging
            where they are scattered, else the one that a hold-out, or `validation`, prefers.
        validation: readings off the grid to choose by, at least 200.
        assume: "isotropic", of a sample whose turn in its own plane changes nothing: then readings
            on one side (tilt ≥ 0), in one plane or of one view suffice; see
            `reflectance.isotropic`. "isotropic+reciprocal", of one that looks the same when light
            and view change places, too: then few readings in all directions suffice, as of a
            hundred photographs; see `reflectance.few_readings`. The report says what was measured
            and what follows.
        outside: what stands beyond the measured angles: "continued", what was measured continues
            to the horizon (`reflectance.continuation`), unless so large a table would be too
            large, which the report warns of; "diffuse", the paper's rule, eq. (6) alone.
        std: also find what the measurement's standard deviations do to the model, `model.errors`,
            which `shade(…, return_std=True)` reads; three to ten times the time of the fit.

    Returns:
        The model (float32, on the CPU) and a report.

    Raises:
        InputError: fewer than two values on an axis, unless assumed isotropic; no valid reading, a
            table too large; an interpolation or assumption that is not known or that the readings
            do not support; validation readings that are too few or outside the box; too few
            readings off the highlight to fit the surface to; with `std`, readings that state no
            standard deviation, or that do not fill a grid by themselves.

    Examples:
        >>> import raden_torch as rt
        >>> result = rt.fit(rt.simulate_specimen("akoya", step_deg=35), diffuse="surface")
        >>> result.report.measured, result.report.outside, result.report.diffuse_fit
        (75, 'continued', 'surface')
        >>> result.report.reading_rms < 1e-6
        True
    """
    diffuse = "floor" if diffuse is None else diffuse
    _check(measurement, diffuse, validation, outside)
    table = tabulate(measurement, assume)
    if outside == "continued" and (size := too_large(table)):
        outside = "diffuse"
        why = f"{size}: outside the measured box the diffuse part stands alone"
        table = replace(table, warnings=(*table.warnings, why))
    return _fitted(measurement, table, diffuse, interpolation, validation, outside, std)


def _check(
    measurement: BrdfMeasurement,
    diffuse: DiffuseParameters | str,
    validation: BrdfMeasurement | None,
    outside: str,
) -> None:
    hint = "load_measurement reads one from a file"
    check_type("measurement", measurement, BrdfMeasurement, hint)
    if outside not in OUTSIDE:
        raise InputError(f"outside: expected {' or '.join(OUTSIDE)}, got {outside!r}")
    if validation is not None:
        check_type("validation", validation, BrdfMeasurement, hint)
    check_type("diffuse", diffuse, (str, DiffuseParameters))
    if isinstance(diffuse, str) and diffuse not in FITS:
        raise InputError(f"diffuse: expected {' or '.join(FITS)}, got {diffuse!r}")


def _fitted(
    measurement: BrdfMeasurement,
    table: Tabulated,
    diffuse: DiffuseParameters | str,
    interpolation: str,
    validation: BrdfMeasurement | None,
    outside: str,
    std: bool,
) -> FitResult:
    """`fit` of a table of the measurement's readings."""
    parts = check_errors(measurement, table) if std else None
    parameters = (
        fit_diffuse(*for_diffuse(table), to=diffuse) if isinstance(diffuse, str) else diffuse
    )
    part = _diffuse_part(parameters)
    total = np.where(np.isnan(table.values), diffuse_at_nodes(table, parameters), table.values)
    chosen = choose_interpolation(table, total, interpolation, validation)
    model = RadenBrdf(part, make_table(table, total, chosen.scheme, outside))
    fitted_to = diffuse if isinstance(diffuse, str) else BY_HAND
    model.layout = choose_layout(model)
    report = make_report(
        measurement, table, model, parameters, chosen, diffuse_fit=fitted_to, outside=outside
    )
    if parts is not None:
        model.errors = error_tables(measurement, parts, model, total, chosen.scheme, outside)
    meta = measurement.metadata
    model.provenance = Provenance(
        meta.sample, meta.instrument, meta.simulated, measurement.sha256, report.as_dict()
    )
    return FitResult(model, report)


def too_large(table: Tabulated) -> str:
    """What is wrong where a table that reaches to the horizon would be too large; else empty."""
    shape = to_horizon(table.grid).shape
    if math.prod(shape) <= MAX_CELLS:
        return ""
    return (
        f"on its steps a table to the horizon has {' x '.join(map(str, shape))} nodes, more than "
        f"{MAX_CELLS}"
    )


def for_diffuse(table: Tabulated) -> tuple[tuple[Floats, Floats, Floats], Floats]:
    """Angles and f_r to fit the diffuse part to: the readings; the nodes, where they follow from
    readings that are too few angles for eqs (3)–(6)."""
    if not table.assumed.any():
        return table.reading_angles, table.readings
    known = ~np.isnan(table.values).any(axis=-1)
    a, r, t = (angle[known] for angle in _node_angles(table))
    return (a, r, t), table.values[known]


def _node_angles(table: Tabulated) -> Floats:
    """`[3, A, R, T]`: incidence, receiving and tilt of the nodes, in radians."""
    return np.deg2rad(np.moveaxis(table.grid.nodes_deg(), -1, 0))


def _diffuse_part(parameters: DiffuseParameters) -> CosineDiffuse:
    scale, exponent = (
        torch.tensor(v, dtype=torch.float32, device="cpu")
        for v in (parameters.scale, parameters.exponent)
    )
    return CosineDiffuse(scale, exponent)


def diffuse_at_nodes(table: Tabulated, parameters: DiffuseParameters) -> Floats:
    """`[A, R, T, 3]` f_r of the diffuse part, which nodes without a measured neighbour take."""
    angles = _node_angles(table)
    with torch.no_grad():
        part = _diffuse_part(parameters)(*(torch.from_numpy(a)[:, None] for a in angles))
    return part.movedim(1, -1).numpy()  # of [A, 3, R, T]
