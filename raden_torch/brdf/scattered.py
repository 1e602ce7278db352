"""Scattered readings → a table, and what lies between its nodes: kriging of the logarithm.

The table's nodes are kriged from the readings (`measurement.kriging`), so that the highlights'
shape can be fitted to them as to measured ones. Then what the readings leave over of that shape is
kriged again, and read at any angle, not only at nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from raden_torch.brdf.fill import REACH, Bools, Filled, Floats
from raden_torch.brdf.interpolation.lobes import Axes, Lobes
from raden_torch.brdf.interpolation.schemes import CAP, Reconstruction
from raden_torch.measurement.distinct import FLOOR, DistinctReadings
from raden_torch.measurement.kriging import Kriging, canonical

SCHEME = "kriging"
"""What the choice of an interpolation calls it."""

_SMOOTHNESS = (0.0, 1e-4, 1e-3, 1e-2)
"""Noise that nobody stated, over the process' variance: the one that leave-one-out prefers."""
_TRIED = 800  # readings, to choose by
_LUMINANCE = 1


def with_noise(readings: DistinctReadings) -> DistinctReadings:
    """Scattered readings, with the noise that predicts each of them best from the others."""
    tried = [replace(readings, noise=readings.noise + extra) for extra in _SMOOTHNESS]
    rows = _some(readings)
    errors = [float(np.mean(abs(one.kriged().leave_one_out(rows)[0]))) for one in tried]
    return tried[int(np.argmin(errors))]


def known_nodes(angles_deg: Floats, xyz: Floats) -> DistinctReadings:
    """Nodes `[M, 3]` with values `[M, 3]`, as if they had been read."""
    angles, first = np.unique(canonical(angles_deg), axis=0, return_index=True)
    logs = np.log(FLOOR + np.maximum(xyz[first], 0))
    return DistinctReadings(angles, logs, np.zeros(len(first)), 1.0)


def on_table(axes_deg: Axes, readings: DistinctReadings) -> tuple[Floats, Bools, Filled]:
    """Krige a table's nodes.

    Args:
        axes_deg: incidence, receiving, tilt, evenly spaced, enclosing the readings.

    Returns:
        XYZ reflectance factors `[A, R, T, 3]`, NaN beyond `REACH` steps from the nodes around a
        reading; where a reading lies within half a step, `[A, R, T]`; the same with its history.
    """
    shape = tuple(len(axis) for axis in axes_deg)
    touched = np.zeros(shape, bool)
    equivalents = readings.angles_deg[abs(readings.angles_deg[:, 0]) < 1e-6] * [1.0, -1.0, -1.0]
    measured, from_equivalent = (
        nodes_read(axes_deg, angles) for angles in (readings.angles_deg, equivalents)
    )
    for angles in (readings.angles_deg, equivalents):
        place = _in_nodes(axes_deg, angles)
        for corner in np.indices((2, 2, 2)).reshape(3, -1).T:
            around = np.where(corner, np.ceil(place), np.floor(place))
            touched[tuple(around.astype(int).T)] = True
    from_equivalent &= ~measured
    near = ndimage.binary_dilation(touched, iterations=REACH)
    nodes = np.stack(np.meshgrid(*axes_deg, indexing="ij"), axis=-1)
    table = np.full((*shape, 3), np.nan)
    table[near] = np.maximum(np.exp(readings.kriged()(nodes[near])) - FLOOR, 0)
    kriged = near & ~measured & ~from_equivalent
    nothing = np.zeros(shape, bool)
    return table, measured, Filled(table, from_equivalent, kriged, ~near, nothing, float("nan"))


def nodes_read(axes_deg: Axes, angles_deg: Floats) -> Bools:
    """`[A, R, T]`: where one of the angles `[M, 3]`, within the box, lies within half a step."""
    read = np.zeros([len(axis) for axis in axes_deg], bool)
    read[tuple(np.rint(_in_nodes(axes_deg, angles_deg)).astype(int).T)] = True
    return read


def between_readings(
    base: Reconstruction, readings: DistinctReadings, beyond: DistinctReadings
) -> Reconstruction:
    """A function of the angles that goes through the readings.

    Args:
        base: of the readings' table; its lobes are what the kriging is spared, where that predicts
            readings better that are left out.
        beyond: nodes that no reading reaches, and what stands there instead.
    """
    low = np.array([axis[0] for axis in base.axes_deg])
    step = np.array([axis[1] - axis[0] for axis in base.axes_deg])
    known = replace(
        readings,
        angles_deg=np.concatenate([readings.angles_deg, beyond.angles_deg]),
        logs=np.concatenate([readings.logs, beyond.logs]),
        noise=np.concatenate([readings.noise, beyond.noise]),
    )
    lobes = _helpful(base.lobes, readings)
    left_over = known.kriged(0.0 if lobes is None else lobes(*known.angles_deg.T)[:, None])
    peak = np.zeros_like(base.cap)
    place = np.rint(_in_nodes(base.axes_deg, readings.angles_deg)).astype(int)
    np.maximum.at(peak, tuple(place.T), np.exp(readings.logs) - FLOOR)
    return Reconstruction(
        base.axes_deg,
        lambda node, channels: left_over(low + node * step)[:, channels],
        True,
        np.maximum(base.cap, CAP * ndimage.maximum_filter(peak, (3, 3, 3, 1))),
        lobes,
    )


def _helpful(lobes: Lobes | None, readings: DistinctReadings) -> Lobes | None:
    """The lobes, unless readings that are left out are predicted better without."""
    if lobes is None:
        return None
    plain = _left_out(readings, readings.kriged())
    spared = _left_out(readings, readings.kriged(lobes(*readings.angles_deg.T)[:, None]))
    return lobes if float(np.sum(spared / plain)) < 2 else None


def _left_out(readings: DistinctReadings, kriging: Kriging) -> Floats:
    """`[2]`: RMS error of Y, and mean |Δ log(1 + Y)|, of readings left out."""
    rows = _some(readings)
    logs = readings.logs[rows, _LUMINANCE]
    truth = np.exp(logs) - FLOOR
    found = np.exp(logs + kriging.leave_one_out(rows)[0][:, _LUMINANCE]) - FLOOR
    apart = np.log1p(np.maximum(found, 0)) - np.log1p(np.maximum(truth, 0))
    error = np.array([np.sqrt(np.mean((found - truth) ** 2)), np.mean(abs(apart))])
    return np.maximum(error, 1e-12)


def _some(readings: DistinctReadings) -> NDArray[np.intp]:
    """Rows to leave out, one after another: all of them, or some where they are many."""
    last = len(readings.logs) - 1
    return np.unique(np.linspace(0, last, min(_TRIED, last + 1)).astype(np.intp))


def _in_nodes(axes_deg: Axes, angles_deg: Floats) -> Floats:
    """`[M, 3]`: positions counted in nodes; of equivalents at incidence 0 the one in the box."""
    low, high = (np.array([axis[end] for axis in axes_deg]) for end in (0, -1))
    step = np.array([axis[1] - axis[0] for axis in axes_deg])
    beyond = np.maximum(low - angles_deg, angles_deg - high).max(axis=1, keepdims=True)
    inside = np.where(beyond > 1e-6, angles_deg * [1.0, -1.0, -1.0], angles_deg)
    return np.asarray(np.round((inside - low) / step, 6))
