"""A measurement as a regular grid: what stands in each cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, group_sums
from raden_torch.reflectance.grid import AngleGrid

_MAX_CELLS = 20_000_000
_SCATTERED = 50  # a grid with more cells than this many per reading is not a grid


def is_filled(angles_deg: Floats) -> bool:
    """Whether the geometries `[M, 3]` fill a good part of the grid through all of them."""
    cells = np.prod(AngleGrid.through(angles_deg)[0].shape, dtype=np.float64)
    return bool(cells <= min(_MAX_CELLS, _SCATTERED * len(angles_deg) + 1000))


@dataclass(frozen=True)
class ReadingGrid:
    """A measurement seen as a regular grid; NaN where a cell has no valid reading.

    Attributes:
        incidence_deg, receiving_deg, tilt_deg: the axes in degrees, ascending: A, R and T values.
        values: `[A, R, T, C]` reflectance factors, the perfect reflecting diffuser = 100.
        channels: the C channel names.
    """

    incidence_deg: Floats
    receiving_deg: Floats
    tilt_deg: Floats
    values: Floats
    channels: tuple[str, ...]

    @property
    def axes_deg(self) -> AngleGrid:
        return AngleGrid(self.incidence_deg, self.receiving_deg, self.tilt_deg)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """`[A, R, T]`: True where the cell holds a valid reading."""
        return np.asarray(~np.isnan(self.values).any(axis=-1))

    @classmethod
    def of(
        cls, angles_deg: Floats, values: Floats, weight: Floats, channels: tuple[str, ...]
    ) -> ReadingGrid:
        """The mean of the readings of each cell, by their weight; a lone one is kept to the bit.

        Args:
            angles_deg: `[M, 3]`, of all readings: their distinct values are the axes.
            values: `[M, C]`, NaN in a row that does not count.
            weight: `[M]`, above 0.
        """
        grid, index = AngleGrid.through(angles_deg)
        cells = int(np.prod(grid.shape, dtype=np.float64))
        counts = ~np.isnan(values).any(axis=1)
        flat = np.ravel_multi_index(tuple(index.T), grid.shape)[counts]
        values, weight = values[counts], weight[counts]
        total = group_sums(values * weight[:, None], flat, cells)
        with np.errstate(invalid="ignore"):
            means = total / np.bincount(flat, weight, cells)[:, None]
        once = np.bincount(flat, minlength=cells)[flat] == 1
        means[flat[once]] = values[once]
        return cls(*grid, means.reshape(*grid.shape, -1), channels)
