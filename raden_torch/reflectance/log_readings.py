"""Readings of distinct geometries, as the logarithm that kriging takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints, group_sums
from raden_torch.errors import InputError
from raden_torch.reflectance.grid import distinct
from raden_torch.reflectance.kriging import Kriging
from raden_torch.reflectance.symmetry import canonical

FLOOR = 10.0
"""A reflectance factor: below it the logarithm turns linear, so that noise is not blown up."""
MAX_READINGS = 500_000
"""A fit of a million does not end in minutes; so close to each other they tell kriging less than a
grid of them."""
LUMINANCE = 1
"""The channel that errors are told by: Y."""

_LOWEST = -5.0  # noise may be negative; its logarithm may not end


@dataclass(frozen=True)
class LogReadings:
    """Each geometry once.

    Attributes:
        angles_deg: `[M, 3]` incidence, receiving, tilt, canonical.
        logs: `[M, C]` of reflectance factors, X, Y, Z the first three, log(`FLOOR` + value).
        noise: `[M]` variance of the logarithm of Y over `spread`.
        spread: the variance of the logarithm of Y over all readings.
    """

    angles_deg: Floats
    logs: Floats
    noise: Floats
    spread: float

    @classmethod
    def of(
        cls,
        angles_deg: Floats,
        xyz: Floats,
        std: Floats | None = None,
        count: Ints | None = None,
    ) -> LogReadings:
        """Readings of one geometry, and of its equivalent at incidence 0, become their mean.

        Args:
            angles_deg: `[M, 3]`.
            xyz: `[M, C]` reflectance factors, X, Y, Z the first three.
            std: `[M, 3]` of these, which becomes `noise`; 0 where there is none.
            count: `[M]`, the weight of each.

        Raises:
            InputError: more than `MAX_READINGS`.
        """
        if len(angles_deg) > MAX_READINGS:
            raise InputError(
                f"measurement: expected at most {MAX_READINGS} scattered readings, got "
                f"{len(angles_deg)}; `raden convert IN OUT.csv --step 5` makes a grid of MERL's"
            )
        angles, index = distinct(canonical(angles_deg))
        weight = np.ones(len(xyz)) if count is None else np.maximum(count, 1.0)
        total = np.bincount(index, weight)
        factors = group_sums(weight[:, None] * xyz, index, len(angles))
        logs = np.log(FLOOR + np.maximum(factors / total[:, None], _LOWEST))
        own = np.zeros(len(xyz)) if std is None else np.nan_to_num(std[:, LUMINANCE])
        variance = np.bincount(index, (weight * own) ** 2) / total**2
        spread = max(float(np.var(logs[:, LUMINANCE])), 1e-12)
        noise = variance / np.exp(2 * logs[:, LUMINANCE]) / spread
        return cls(angles, logs, noise, spread)

    @classmethod
    def of_nodes(cls, angles_deg: Floats, xyz: Floats) -> LogReadings:
        """Nodes `[M, 3]` with values `[M, 3]`, as if they had been read without noise."""
        angles, first = np.unique(canonical(angles_deg), axis=0, return_index=True)
        logs = np.log(FLOOR + np.maximum(xyz[first], 0))
        return cls(angles, logs, np.zeros(len(first)), 1.0)

    def and_of(self, others: LogReadings) -> LogReadings:
        """Both; the noise of both is told over this one's spread."""
        return LogReadings(
            np.concatenate([self.angles_deg, others.angles_deg]),
            np.concatenate([self.logs, others.logs]),
            np.concatenate([self.noise, others.noise]),
            self.spread,
        )

    def kriged(self, less: Floats | float = 0.0) -> Kriging:
        """Of the logarithms, less a part that is known."""
        return Kriging(self.angles_deg, self.logs - less, self.noise)
