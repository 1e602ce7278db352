"""Scattered readings → a table, and what lies between its nodes: kriging of the logarithm.

The table's nodes are kriged from the readings (`measurement.kriging`), so that the highlights'
shape can be fitted to them as to measured ones. Then what the readings leave over of that shape is
kriged again, and read at any angle, not only at nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from raden_torch.brdf.fill import REACH, Bools, Filled, Floats
from raden_torch.brdf.interpolation.lobes import Axes
from raden_torch.brdf.interpolation.schemes import CAP, Reconstruction
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.distinct import FLOOR, DistinctReadings, distinct_readings
from raden_torch.measurement.kriging import canonical

SCHEME = "kriging"
"""What the choice of an interpolation calls it."""

_SMOOTHNESS = (0.0, 1e-4, 1e-3, 1e-2)
"""Noise that nobody stated, over the process' variance: the one that leave-one-out prefers."""
_TRIED = 2000  # readings, to choose it by


def gather(xyz: BrdfMeasurement) -> DistinctReadings:
    """Scattered readings, with the noise that predicts each of them best from the others."""
    readings = distinct_readings(xyz)
    rows = np.linspace(0, len(readings.logs) - 1, min(_TRIED, len(readings.logs))).astype(int)
    tried = [replace(readings, noise=readings.noise + extra) for extra in _SMOOTHNESS]
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
    place = _in_nodes(axes_deg, readings.angles_deg)
    measured, touched = np.zeros(shape, bool), np.zeros(shape, bool)
    measured[tuple(np.rint(place).astype(int).T)] = True
    for corner in np.indices((2, 2, 2)).reshape(3, -1).T:
        touched[tuple(np.where(corner, np.ceil(place), np.floor(place)).astype(int).T)] = True
    near = ndimage.binary_dilation(touched, iterations=REACH)
    nodes = np.stack(np.meshgrid(*axes_deg, indexing="ij"), axis=-1)
    table = np.full((*shape, 3), np.nan)
    table[near] = np.maximum(np.exp(readings.kriged()(nodes[near])) - FLOOR, 0)
    nothing = np.zeros(shape, bool)
    return table, measured, Filled(table, nothing, near & ~measured, ~near, nothing, float("nan"))


def between_readings(
    base: Reconstruction, readings: DistinctReadings, beyond: DistinctReadings
) -> Reconstruction:
    """A function of the angles that goes through the readings.

    Args:
        base: of the readings' table; its lobes are what the kriging is spared.
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
    shape = 0.0 if base.lobes is None else base.lobes(*known.angles_deg.T)[:, None]
    left_over = known.kriged(shape)
    peak = np.zeros_like(base.cap)
    place = np.rint(_in_nodes(base.axes_deg, readings.angles_deg)).astype(int)
    np.maximum.at(peak, tuple(place.T), np.exp(readings.logs) - FLOOR)
    return Reconstruction(
        base.axes_deg,
        lambda node, channels: left_over(low + node * step)[:, channels],
        True,
        np.maximum(base.cap, CAP * ndimage.maximum_filter(peak, (3, 3, 3, 1))),
        base.lobes,
    )


def _in_nodes(axes_deg: Axes, angles_deg: Floats) -> Floats:
    """`[M, 3]`: positions counted in nodes; of equivalents at incidence 0 the one in the box."""
    low, high = (np.array([axis[end] for axis in axes_deg]) for end in (0, -1))
    step = np.array([axis[1] - axis[0] for axis in axes_deg])
    outside = ((angles_deg < low - 1e-6) | (angles_deg > high + 1e-6)).any(axis=1)
    inside = np.where(outside[:, None], angles_deg * [1.0, -1.0, -1.0], angles_deg)
    return np.asarray(np.round((inside - low) / step, 6))
