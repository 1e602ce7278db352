"""Readings of distinct geometries, as the logarithm that kriging takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.measurement.kriging import Floats, Kriging, canonical
from raden_torch.measurement.readings import BrdfMeasurement

FLOOR = 10.0
"""A reflectance factor: below it the logarithm turns linear, so that noise is not blown up."""

_LOWEST = -5.0  # noise may be negative; its logarithm may not end
_LUMINANCE = 1


@dataclass(frozen=True)
class DistinctReadings:
    """Each geometry once.

    Attributes:
        angles_deg: `[M, 3]` incidence, receiving, tilt, canonical.
        logs: `[M, 3]` of XYZ reflectance factors, log(`FLOOR` + value).
        noise: `[M]` variance of the logarithm of Y over `spread`.
        spread: the variance of the logarithm of Y over all readings.
    """

    angles_deg: Floats
    logs: Floats
    noise: Floats
    spread: float

    def kriged(self, less: Floats | float = 0.0) -> Kriging:
        """Of the logarithms, less a part that is known."""
        return Kriging(self.angles_deg, self.logs - less, self.noise)


def distinct_readings(xyz: BrdfMeasurement, angles_deg: Floats | None = None) -> DistinctReadings:
    """Valid XYZ readings; those of one geometry, and of its equivalent at incidence 0, become their
    mean, weighted by their count. `std` becomes `noise`; 0 where there is none.

    Args:
        angles_deg: `[M, 3]` that stand in for the measurement's own.
    """
    if angles_deg is None:
        angles_deg = np.stack([xyz.incidence_deg, xyz.receiving_deg, xyz.tilt_deg], axis=1)
    angles, xyz = canonical(angles_deg[xyz.valid]), xyz.select(xyz.valid)
    distinct, index = np.unique(np.round(angles, 6), axis=0, return_inverse=True)
    index = index.ravel()
    weight = np.ones(len(xyz)) if xyz.count is None else np.maximum(xyz.count, 1.0)
    total = np.bincount(index, weight)
    factors = np.stack([np.bincount(index, weight * c) for c in xyz.values.T], axis=1)
    logs = np.log(FLOOR + np.maximum(factors / total[:, None], _LOWEST))
    std = np.zeros(len(xyz)) if xyz.std is None else np.nan_to_num(xyz.std[:, _LUMINANCE])
    variance = np.bincount(index, (weight * std) ** 2) / total**2
    spread = max(float(np.var(logs[:, _LUMINANCE])), 1e-12)
    noise = variance / np.exp(2 * logs[:, _LUMINANCE]) / spread
    return DistinctReadings(distinct, logs, noise, spread)
