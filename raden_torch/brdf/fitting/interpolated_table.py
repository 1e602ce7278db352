"""Choose an interpolator for a tabulated measurement, and make the model's table with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.bake import bake, in_parts
from raden_torch.brdf.fitting.tabulate import Tabulated
from raden_torch.brdf.model.reflectance_table import Pieces, ReflectanceTable
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.continuation import continued
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.interpolation import SCHEMES, Interpolant, interpolate, why_not
from raden_torch.reflectance.log_readings import LUMINANCE, LogReadings
from raden_torch.reflectance.scattered import KRIGING, through_readings
from raden_torch.reflectance.scheme_choice import LEAST_READINGS, best, hold_out_losses, losses


@dataclass(frozen=True)
class Choice:
    """An interpolator, and why.

    Attributes:
        scheme: a key of `SCHEMES`, or "kriging".
        why: one sentence.
        losses: the loss of every scheme that was compared (trilinear = 1).
    """

    scheme: str
    why: str
    losses: dict[str, float] = field(default_factory=dict)


def choose_interpolation(
    table: Tabulated, total: Floats, wanted: str, validation: BrdfMeasurement | None
) -> Choice:
    """Decide what lies between the nodes; see `reflectance.scheme_choice`.

    Args:
        total: `[A, R, T, C]` f_r without gaps.
        wanted: a key of `SCHEMES`, "kriging" (of scattered readings), or "auto".

    Raises:
        InputError: see `fit`.
    """
    if wanted not in ("auto", *SCHEMES, KRIGING):
        raise InputError(
            f"interpolation: expected auto, {', '.join(SCHEMES)} or {KRIGING}, got {wanted!r}"
        )
    if wanted == KRIGING and table.scattered is None:
        raise InputError(
            "interpolation: expected another than kriging, which is for scattered readings, got "
            "readings that fill a grid"
        )
    reason = why_not(table.grid)
    if reason and wanted not in ("auto", "trilinear"):
        raise InputError(
            f"interpolation: expected trilinear or auto for this measurement, got {wanted}: "
            f"{reason}"
        )
    if wanted != "auto":
        return Choice(wanted, "as asked for")
    if reason:
        return Choice("trilinear", f"the only one that supports this measurement: {reason}")
    xyz = table.channels.factors(total)
    if validation is not None:
        points, truth = _validation_points(table, validation)
        found = losses(_all_schemes(table, xyz), points, truth)
        return Choice(best(found), f"best on {len(truth)} validation readings", found)
    if table.scattered is not None:
        return Choice(KRIGING, "its readings are scattered")
    known = (table.measured | table.assumed) & ~table.averaged
    found = hold_out_losses(table.grid, xyz, known)
    if not found:
        return Choice("trilinear", "too few nodes to hold some out")
    return Choice(best(found), "best on nodes held out of the measurement", found)


def make_table(table: Tabulated, total: Floats, scheme: str, outside: str) -> ReflectanceTable:
    """The model's table: the nodes themselves for trilinear, else the interpolator baked.

    Args:
        outside: "continued": the table reaches to the horizon; "diffuse": it ends with the box.
    """
    if scheme == "trilinear" and outside == "diffuse":
        return _as_table(table.grid, total)
    xyz = table.channels.factors(total)
    function, like = _function(table, xyz, scheme)
    reaching = continued(function, xyz) if outside == "continued" else function
    if scheme == "trilinear":
        values = table.channels.f_r(in_parts(reaching, reaching.grid.nodes_deg().reshape(-1, 3)))
        whole = values.reshape(*reaching.grid.shape, -1)
        whole[reaching.grid.part(table.grid)] = total  # measured nodes to the bit
        return _as_table(reaching.grid, whole)
    baked = bake(reaching, like=like)
    return _as_table(reaching.grid, table.channels.f_r(baked.values), baked.pieces)


def _as_table(grid: AngleGrid, f_r: Floats, pieces: Pieces | None = None) -> ReflectanceTable:
    first, step = (tuple(values.tolist()) for values in (grid.low, grid.step))
    return ReflectanceTable(torch.from_numpy(f_r).float(), first, step, pieces)


def _all_schemes(table: Tabulated, xyz: Floats) -> Iterator[tuple[str, Interpolant]]:
    for name in (*SCHEMES, KRIGING) if table.scattered is not None else SCHEMES:
        yield name, _function(table, xyz, name)[0]


def _function(table: Tabulated, xyz: Floats, scheme: str) -> tuple[Interpolant, Interpolant | None]:
    """What lies between the nodes; and a function that is read sooner and has the same shape."""
    if scheme != KRIGING or table.scattered is None:
        return interpolate(table.grid, xyz, scheme), None
    base = interpolate(table.grid, xyz, "lobes")
    unread = table.without_neighbour
    beyond = LogReadings.of_nodes(table.grid.nodes_deg()[unread], xyz[unread])
    return through_readings(base, table.scattered, beyond), base


def _validation_points(table: Tabulated, validation: BrdfMeasurement) -> tuple[Floats, Floats]:
    """`[M, 3]` degrees and `[M]` Y of the valid readings."""
    usable = validation.select(validation.valid)
    if len(usable) < LEAST_READINGS:
        raise InputError(
            f"validation: expected at least {LEAST_READINGS} valid readings off the grid, got "
            f"{len(usable)}"
        )
    points = usable.angles_deg
    outside = int((~table.grid.contains(points)).sum())
    if outside:
        box = ", ".join(f"{axis[0]:g}…{axis[-1]:g}" for axis in table.grid)
        raise InputError(
            "validation: expected readings within the measured box (incidence, receiving, tilt "
            f"{box} deg), got {outside} of {len(usable)} outside it; leave them out"
        )
    return points, usable.as_xyz().values[:, LUMINANCE]
