"""Which readings of two measurements are of one geometry; what is one of them where the other is?

Where geometries differ, a quadratic through the nearest readings stands in, weighed by distance.
Beside the readings' own standard deviation it has that of their residuals: large where the sample
is steeper than the readings are close.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from raden_torch.arrays import Floats, Ints
from raden_torch.measurement.error_parts import ErrorParts
from raden_torch.measurement.readings import BrdfMeasurement
from raden_torch.reflectance.grid import DIGITS
from raden_torch.reflectance.local_quadratic import NUMBERS, local_quadratic

_NEIGHBOURS = 32  # three for each number of a quadratic in three angles
_REACH_DEG = 12.5  # of the nearest ten: beyond, it would be a guess
_ROWS_AT_ONCE = 4_000


@dataclass(frozen=True)
class MatchedReadings:
    """Rows, among the valid readings of each measurement, that are of one geometry."""

    first: Ints
    second: Ints


def geometries_deg(measurement: BrdfMeasurement) -> Floats:
    """`[M, 4]` incidence, receiving, tilt and sample azimuth (0 where none is given)."""
    m = measurement
    azimuth = np.zeros(len(m)) if m.azimuth_deg is None else m.azimuth_deg
    return np.column_stack([m.angles_deg, azimuth])


def same_geometries(first: BrdfMeasurement, second: BrdfMeasurement) -> MatchedReadings:
    """The geometries, within 5e-7 degree, that both have a valid reading of; each once."""
    keys = [np.round(geometries_deg(m)[m.valid], DIGITS) + 0.0 for m in (first, second)]  # −0 is 0
    of_first, of_second = ({tuple(key): row for row, key in enumerate(k.tolist())} for k in keys)
    both = [(row, of_second[key]) for key, row in of_first.items() if key in of_second]
    rows = np.array(both, np.intp).reshape(-1, 2)
    return MatchedReadings(rows[:, 0], rows[:, 1])


def interpolated_at(
    wanted: BrdfMeasurement, source: BrdfMeasurement, parts: ErrorParts
) -> tuple[Ints, ErrorParts]:
    """The source at the geometries of another measurement's valid readings.

    Args:
        source: at one sample azimuth.
        parts: of its valid readings.

    Returns:
        Which of the wanted readings have enough neighbours, and the source there.
    """
    places, known = geometries_deg(wanted)[wanted.valid], geometries_deg(source)[source.valid]
    count = min(_NEIGHBOURS, len(known))
    if count < NUMBERS + 2:
        return np.zeros(0, np.intp), parts.at(np.zeros(0, np.intp))
    away, near = KDTree(known).query(places, k=np.arange(1, count + 1))
    rows = np.flatnonzero(away[:, NUMBERS - 1] < _REACH_DEG)
    weights, added = np.empty((len(rows), count)), np.empty((len(rows), parts.values.shape[1]))
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        here = rows[part]
        offsets = (known[near[here]] - places[here, None])[..., :3]
        weights[part], added[part] = local_quadratic(offsets, away[here], parts.values[near[here]])
    return rows, parts.interpolated(weights, near[rows], added)
