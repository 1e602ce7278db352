"""A grid of angles: incidence × receiving × tilt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raden_torch.arrays import Bools, Floats, Ints

SAME_DEG = 1e-6
"""Angles this near each other are one."""
DIGITS = 6
"""Decimals of a degree to which angles are rounded before they are compared."""


def distinct(angles_deg: Floats) -> tuple[Floats, Ints]:
    """`[K, D]`: each of the rows `[N, D]` once, sorted; `[N]`: which of them each row is."""
    rows = np.round(angles_deg, DIGITS) + 0.0  # −0 becomes 0
    found, index = np.unique(rows, axis=0, return_inverse=True)
    return found, index.ravel()


class AngleGrid(NamedTuple):
    """Three ascending axes in degrees, `[A]`, `[R]` and `[T]`.

    What speaks of steps and positions needs evenly spaced axes of at least two nodes.
    """

    incidence_deg: Floats
    receiving_deg: Floats
    tilt_deg: Floats

    @classmethod
    def through(cls, angles_deg: Floats) -> tuple[AngleGrid, Ints]:
        """The smallest grid that has nodes at all angles `[M, 3]`, and which node each has."""
        rounded = np.round(angles_deg, DIGITS)
        axes, index = zip(
            *(np.unique(column, return_inverse=True) for column in rounded.T), strict=True
        )
        return cls(*axes), np.stack([i.ravel() for i in index], axis=1)

    @classmethod
    def around(cls, angles_deg: Floats, step_deg: float) -> AngleGrid:
        """Nodes at whole steps that enclose the angles `[M, 3]`."""
        low = np.floor(angles_deg.min(axis=0) / step_deg)
        high = np.ceil(angles_deg.max(axis=0) / step_deg)
        return cls(*(step_deg * np.arange(a, b + 1) for a, b in zip(low, high, strict=True)))

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.incidence_deg), len(self.receiving_deg), len(self.tilt_deg)

    @property
    def low(self) -> Floats:
        """`[3]`, the first node's angles."""
        return np.array([axis[0] for axis in self])

    @property
    def high(self) -> Floats:
        """`[3]`, the last node's."""
        return np.array([axis[-1] for axis in self])

    @property
    def step(self) -> Floats:
        """`[3]`."""
        return np.array([axis[1] - axis[0] for axis in self])

    @property
    def is_mirrored(self) -> bool:
        """True where the grid holds the equivalents (0, −r, −t) of its plane at incidence 0."""
        even = all(np.allclose(axis, -axis[::-1], atol=SAME_DEG) for axis in self[1:])
        return bool(abs(self.incidence_deg[0]) < SAME_DEG and even)

    def nodes_deg(self) -> Floats:
        """`[A, R, T, 3]`, the angles of every node."""
        return np.stack(np.meshgrid(*self, indexing="ij"), axis=-1)

    def part(self, smaller: AngleGrid) -> tuple[slice, slice, slice]:
        """Where the nodes of a smaller grid of the same steps lie in this one."""
        first = np.rint((smaller.low - self.low) / self.step).astype(int)
        a, r, t = (slice(int(i), int(i) + n) for i, n in zip(first, smaller.shape, strict=True))
        return a, r, t

    def every_second(self) -> AngleGrid:
        return AngleGrid(*(axis[::2] for axis in self))

    def positions(self, angles_deg: Floats) -> Floats:
        """`[M, 3]`: where angles lie, counted in steps from the first node."""
        return np.asarray((angles_deg - self.low) / self.step)

    def contains(self, angles_deg: Floats) -> Bools:
        """`[M]`: within the box, its faces included."""
        low, high = self.low - SAME_DEG, self.high + SAME_DEG
        return np.asarray(((angles_deg >= low) & (angles_deg <= high)).all(axis=-1))

    def find(self, angles_deg: Floats) -> tuple[Ints, Bools]:
        """`[M, 3]`: the nodes at these angles, of axes that need not be even; `[M]`: there is one
        (else the node found is another)."""
        index, there = [], np.ones(angles_deg.shape[:-1], bool)
        for axis, angle in zip(self, np.moveaxis(angles_deg, -1, 0), strict=True):
            place = np.clip(np.searchsorted(axis, angle - SAME_DEG), 0, len(axis) - 1)
            there &= abs(axis[place] - angle) < SAME_DEG
            index.append(place)
        return np.stack(index, axis=-1), there
