"""An even random choice of a bounded number of samples from each cell, whatever comes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32, Ints

_PER_CELL = 96
_MOST = 8_000_000


@dataclass(eq=False)
class Reservoir:
    """Samples kept: each new one gets a random key, and a cell keeps those with the least keys.

    Attributes:
        size: at most so many in a cell.
        cell: `[n]`, ascending.
        shot: `[n]` which photograph each is from.
        x: `[n, 3]` place in the cell.
        y: `[n, 3]` value.
        pixel: `[n]` where in its photograph, row by row.
    """

    size: int
    cell: Ints
    shot: NDArray[np.int32]
    x: Floats32
    y: Floats32
    pixel: NDArray[np.int32]
    _key: NDArray[np.float64]
    _limit: Floats32
    _random: np.random.Generator

    @classmethod
    def of(cls, cells: int, seed: int = 0) -> Reservoir:
        """An empty one. Fewer samples a cell where there are very many cells."""
        return cls(
            size=int(np.clip(_MOST // cells, 24, _PER_CELL)),
            cell=np.zeros(0, np.intp),
            shot=np.zeros(0, np.int32),
            x=np.zeros((0, 3), np.float32),
            y=np.zeros((0, 3), np.float32),
            pixel=np.zeros(0, np.int32),
            _key=np.zeros(0),
            _limit=np.ones(cells, np.float32),
            _random=np.random.default_rng(seed),
        )

    def add(self, cell: Ints, shot: int, x: Floats32, y: Floats32, pixel: Ints) -> None:
        key = self._random.random(len(cell), np.float32)
        wanted = np.flatnonzero(key < self._limit[cell])
        self.cell = np.concatenate([self.cell, cell[wanted]])
        self.shot = np.concatenate([self.shot, np.full(len(wanted), shot, np.int32)])
        self.x = np.concatenate([self.x, x[wanted]])
        self.y = np.concatenate([self.y, y[wanted]])
        self.pixel = np.concatenate([self.pixel, pixel[wanted].astype(np.int32)])
        self._key = np.concatenate([self._key, cell[wanted] + key[wanted].astype(np.float64)])
        order = np.argsort(self._key)
        rank = rank_in_group(self.cell[order])
        kept = order[rank < self.size]
        last = order[rank == self.size - 1]
        self._limit[self.cell[last]] = (self._key[last] - self.cell[last]).astype(np.float32)
        for name in ("cell", "shot", "x", "y", "pixel", "_key"):
            setattr(self, name, getattr(self, name)[kept])


def rank_in_group(group: NDArray[np.integer]) -> Ints:
    """0, 1, 2, … within each run of equal values."""
    if not len(group):
        return np.zeros(0, np.intp)
    starts = np.flatnonzero(np.r_[True, group[1:] != group[:-1]])
    return np.arange(len(group)) - np.repeat(starts, np.diff(np.r_[starts, len(group)]))
