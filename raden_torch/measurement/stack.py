"""The readings of several measurements in one table, by the cell they are of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, group_sums
from raden_torch.measurement.colour_conversion import matrix_to
from raden_torch.measurement.compare import common_channels
from raden_torch.measurement.error_parts import stated_variance
from raden_torch.measurement.matching import geometries_deg
from raden_torch.measurement.readings import BrdfMeasurement
from raden_torch.reflectance.grid import distinct


@dataclass(frozen=True)
class Stack:
    """All valid readings `[N]` of all measurements, and which cell `[K]` each is of."""

    channels: tuple[str, ...]
    angles: Floats  # [K, 4]
    cell: NDArray[np.intp]  # [N]
    source: NDArray[np.intp]  # [N]
    values: Floats  # [N, C]
    weight: Floats  # [N, C]
    count: Floats  # [N]

    @classmethod
    def of(cls, measurements: Sequence[BrdfMeasurement]) -> Stack:
        channels = common_channels(tuple(measurements))
        kept = [m.select(m.valid) for m in measurements]
        cells, cell = distinct(np.concatenate([geometries_deg(m) for m in kept]))
        values, variances = [], []
        for m in kept:
            matrix = matrix_to(m, channels)
            values.append(m.values @ matrix.T)
            variances.append(stated_variance(m) @ (matrix**2).T)
        stacked, variance = np.concatenate(values), np.concatenate(variances)
        floor = (1e-9 * abs(stacked).max(initial=1e-6)) ** 2  # a std of 0 is rounding
        return cls(
            channels,
            cells,
            cell,
            np.repeat(np.arange(len(kept)), [len(m) for m in kept]),
            stacked,
            1.0 / np.maximum(variance, floor),
            np.concatenate([np.ones(len(m)) if m.count is None else m.count for m in kept]),
        )

    @property
    def several(self) -> NDArray[np.bool_]:
        """`[K]`: more than one measurement has a reading there."""
        pairs = np.unique(np.stack([self.cell, self.source], axis=1), axis=0)
        return np.bincount(pairs[:, 0], minlength=len(self.angles)) > 1

    def total(self, rows: Floats) -> Floats:
        """`[K, C]` sums over the readings of each cell."""
        return group_sums(rows, self.cell, len(self.angles))

    def rescaled(self, errors: Floats) -> tuple[Floats, Floats]:
        """`[N, C]` values and weights without these errors `[S]` of the scales."""
        factor = np.exp(errors)[self.source, None]
        return self.values / factor, self.weight * factor**2

    def mean(self, values: Floats, weight: Floats) -> Floats:
        """`[K, C]`; a lone reading is kept to the bit."""
        mean = self.total(values * weight) / self.total(weight)
        alone = np.bincount(self.cell, minlength=len(self.angles))[self.cell] == 1
        mean[self.cell[alone]] = values[alone]
        return mean
