"""An isotropic sample's readings at tilt t and −t are of one geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raden_torch.arrays import Floats, group_sums
from raden_torch.measurement.readings import BrdfMeasurement
from raden_torch.reflectance.grid import distinct
from raden_torch.reflectance.isotropic import mean_percent


def with_opposite_tilts(measurement: BrdfMeasurement) -> tuple[BrdfMeasurement, str]:
    """Every reading at both its tilt and the opposite one; where both were read, their mean.

    Returns:
        The valid readings, without azimuths, and what was assumed, in one sentence.
    """
    known = measurement.select(measurement.valid)
    geometry = known.angles_deg
    geometry[:, 2] = abs(geometry[:, 2])
    angles, index = distinct(geometry)
    weight = np.ones(len(known)) if known.count is None else np.maximum(known.count, 1.0)
    total = np.bincount(index, weight)

    def mean(columns: Floats, power: int = 1) -> Floats:
        sums = group_sums(weight[:, None] ** power * columns, index, len(angles))
        return sums / total[:, None] ** power

    values = mean(known.values)
    std = None if known.std is None else np.sqrt(mean(known.std**2, 2))
    count = None if known.count is None else np.bincount(index, known.count).astype(np.int64)
    rows = np.concatenate([np.arange(len(angles)), np.flatnonzero(angles[:, 2] > 0)])
    sign = np.where(np.arange(len(rows)) < len(angles), 1.0, -1.0)
    whole = replace(
        known,
        incidence_deg=angles[rows, 0],
        receiving_deg=angles[rows, 1],
        tilt_deg=sign * angles[rows, 2],
        values=values[rows],
        azimuth_deg=None,
        std=None if std is None else std[rows],
        count=None if count is None else count[rows],
        valid=np.ones(len(rows), bool),
    )
    apart = mean_percent(abs(known.values - values[index]), values[index])
    return whole, f"tilts t and -t are one geometry (readings lie {apart} off their mean)"
