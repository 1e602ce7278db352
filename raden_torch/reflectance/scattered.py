"""Scattered readings → a table, and what lies between its nodes: kriging of the logarithm.

The table's nodes are kriged from the readings (`kriging.py`), so that the highlights'
shape can be fitted to them as to measured ones. Then what the readings leave over of that shape is
kriged again, and read at any angle, not only at nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from raden_torch.arrays import Bools, Floats, Ints
from raden_torch.reflectance.gap_filling import REACH, Filled
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.interpolation import CAP, Interpolant
from raden_torch.reflectance.kriging import Kriging
from raden_torch.reflectance.lobes import Lobes
from raden_torch.reflectance.log_readings import FLOOR, LUMINANCE, LogReadings
from raden_torch.reflectance.symmetry import TURNED, at_perpendicular

KRIGING = "kriging"
"""What the choice of an interpolation calls it."""

_SMOOTHNESS = (0.0, 1e-4, 1e-3, 1e-2)
"""Noise that nobody stated, over the process' variance: the one that leave-one-out prefers."""
_TRIED = 800  # readings, to choose by


def with_noise(readings: LogReadings) -> LogReadings:
    """Scattered readings, with the noise that predicts each of them best from the others."""
    tried = [replace(readings, noise=readings.noise + extra) for extra in _SMOOTHNESS]
    rows = _some(readings)
    errors = [float(np.mean(abs(one.kriged().leave_one_out(rows)[0]))) for one in tried]
    return tried[int(np.argmin(errors))]


def on_grid(grid: AngleGrid, readings: LogReadings) -> tuple[Floats, Bools, Filled]:
    """Krige a grid's nodes.

    Args:
        grid: evenly spaced, enclosing the readings.

    Returns:
        Reflectance factors `[A, R, T, C]`, NaN beyond `REACH` steps from the nodes around a
        reading; where a reading lies within half a step, `[A, R, T]`; the same with its history.
    """
    touched = np.zeros(grid.shape, bool)
    equivalents = readings.angles_deg[at_perpendicular(readings.angles_deg)] * TURNED
    measured, from_equivalent = (
        nodes_read(grid, angles) for angles in (readings.angles_deg, equivalents)
    )
    for angles in (readings.angles_deg, equivalents):
        place = _in_nodes(grid, angles)
        for corner in np.indices((2, 2, 2)).reshape(3, -1).T:
            around = np.where(corner, np.ceil(place), np.floor(place))
            touched[tuple(around.astype(int).T)] = True
    from_equivalent &= ~measured
    near = ndimage.binary_dilation(touched, iterations=REACH)
    table = np.full((*grid.shape, readings.logs.shape[1]), np.nan)
    table[near] = np.maximum(np.exp(readings.kriged()(grid.nodes_deg()[near])) - FLOOR, 0)
    kriged = near & ~measured & ~from_equivalent
    nothing = np.zeros(grid.shape, bool)
    return table, measured, Filled(table, from_equivalent, kriged, ~near, nothing, float("nan"))


def nodes_read(grid: AngleGrid, angles_deg: Floats) -> Bools:
    """`[A, R, T]`: where one of the angles `[M, 3]`, within the box, lies within half a step."""
    read = np.zeros(grid.shape, bool)
    read[tuple(np.rint(_in_nodes(grid, angles_deg)).astype(int).T)] = True
    return read


def nodes_read_beside(grid: AngleGrid, angles_deg: Floats) -> Bools:
    """The same of angles that may lie beyond the box, up to half a step beside its nodes."""
    near = (abs(angles_deg) <= grid.high + grid.step / 2).all(axis=1)
    return nodes_read(grid, np.clip(angles_deg[near], grid.low, grid.high))


def through_readings(base: Interpolant, readings: LogReadings, beyond: LogReadings) -> Interpolant:
    """A function of the angles that goes through the readings.

    Args:
        base: of the readings' table; its lobes are what the kriging is spared, where that predicts
            readings better that are left out.
        beyond: nodes that no reading reaches, and what stands there instead.
    """
    low, step = base.grid.low, base.grid.step
    known = readings.and_of(beyond)
    lobes = _helpful(base.lobes, readings)
    left_over = known.kriged(0.0 if lobes is None else lobes(*known.angles_deg.T)[:, None])
    peak = np.zeros_like(base.cap)
    place = np.rint(_in_nodes(base.grid, readings.angles_deg)).astype(int)
    np.maximum.at(peak, tuple(place.T), np.exp(readings.logs) - FLOOR)
    return Interpolant(
        base.grid,
        lambda node, channels: left_over(low + node * step)[:, channels],
        True,
        np.maximum(base.cap, CAP * ndimage.maximum_filter(peak, (3, 3, 3, 1))),
        lobes,
    )


def _helpful(lobes: Lobes | None, readings: LogReadings) -> Lobes | None:
    """The lobes, unless readings that are left out are predicted better without."""
    if lobes is None:
        return None
    plain = _left_out(readings, readings.kriged())
    spared = _left_out(readings, readings.kriged(lobes(*readings.angles_deg.T)[:, None]))
    return lobes if float(np.sum(spared / plain)) < 2 else None


def _left_out(readings: LogReadings, kriging: Kriging) -> Floats:
    """`[2]`: RMS error of Y, and mean |Δ log(1 + Y)|, of readings left out."""
    rows = _some(readings)
    logs = readings.logs[rows, LUMINANCE]
    truth = np.exp(logs) - FLOOR
    found = np.exp(logs + kriging.leave_one_out(rows)[0][:, LUMINANCE]) - FLOOR
    apart = np.log1p(np.maximum(found, 0)) - np.log1p(np.maximum(truth, 0))
    error = np.array([np.sqrt(np.mean((found - truth) ** 2)), np.mean(abs(apart))])
    return np.maximum(error, 1e-12)


def _some(readings: LogReadings) -> Ints:
    """Rows to leave out, one after another: all of them, or some where they are many."""
    last = len(readings.logs) - 1
    return np.unique(np.linspace(0, last, min(_TRIED, last + 1)).astype(np.intp))


def _in_nodes(grid: AngleGrid, angles_deg: Floats) -> Floats:
    """`[M, 3]`: positions counted in nodes; of equivalents at incidence 0 the one in the box."""
    inside = np.where(grid.contains(angles_deg)[:, None], angles_deg, angles_deg * TURNED)
    return np.asarray(np.round(grid.positions(inside), 6))
