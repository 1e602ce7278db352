"""The cells of the raden grid, and where a sample lies in its cell.

A sample of incidence a, receiving r, tilt t belongs to the cell of the nearest node;
x = (Δa, Δr, Δt) is its place there in steps, −0.5…0.5. At incidence 0, (a, r, t) and (−a, −r, −t)
are one geometry: a sample near it stands in two cells, (0, r, t) and (0, −r, −t), on both sides of
the node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Ints
from raden_torch.errors import InputError

_SCATTERED_TO_DEG = 80.0
"""The last node of the cells that scattered readings are gathered in."""
MAX_CELLS = 2_000_000


@dataclass(frozen=True)
class CellGrid:
    """A grid of incidence 0…limit, receiving and tilt −limit…limit.

    Attributes:
        step_deg: between nodes.
        limit_deg: the last node; a whole number of steps.
    """

    step_deg: float = 5.0
    limit_deg: float = 70.0

    def __post_init__(self) -> None:
        steps = self.limit_deg / self.step_deg if self.step_deg > 0 else 0.0
        if not (0 < self.limit_deg < 90 and steps >= 1 and abs(steps - round(steps)) < 1e-6):
            raise InputError(
                "grid: expected a whole number of steps and a limit below 90 degrees, got steps "
                f"of {self.step_deg:g} up to {self.limit_deg:g} degrees"
            )
        if self.cells > MAX_CELLS:
            raise InputError(
                f"grid: expected at most {MAX_CELLS} cells, got {self.cells} by steps of "
                f"{self.step_deg:g} degrees; take a coarser step"
            )

    @classmethod
    def reaching(cls, step_deg: float = 5.0, *, scattered: bool) -> CellGrid:
        """As far as readings count: scattered ones, which need no neighbours, further."""
        return cls(step_deg, _SCATTERED_TO_DEG) if scattered else cls(step_deg)

    @property
    def side(self) -> int:
        return round(self.limit_deg / self.step_deg)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Nodes of incidence, receiving and tilt."""
        return self.side + 1, 2 * self.side + 1, 2 * self.side + 1

    @property
    def cells(self) -> int:
        a, r, t = self.shape
        return a * r * t

    def nodes_deg(self) -> Floats:
        """`[cells, 3]` incidence, receiving, tilt."""
        incidence = self.step_deg * np.arange(self.side + 1)
        both = self.step_deg * np.arange(-self.side, self.side + 1)
        mesh = np.meshgrid(incidence, both, both, indexing="ij")
        return np.stack([axis.ravel() for axis in mesh], axis=1)

    def sort(self, angles: NDArray[np.float32]) -> tuple[Ints, Ints, NDArray[np.float32]]:
        """Which samples `[P, 3]` lie in the grid: their rows, cells, and places x `[n, 3]`."""
        step = np.float32(self.step_deg)
        node = np.rint(angles / step)
        inside = (abs(node) <= self.side).all(axis=1) & np.isfinite(angles).all(axis=1)
        rows = np.flatnonzero(inside)
        place, node = angles[rows] / step, node[rows]
        again = np.flatnonzero(node[:, 0] == 0)
        rows = np.concatenate([rows, rows[again]])
        x = np.concatenate([place - node, node[again] - place[again]])
        node = np.concatenate([node, -node[again]]).astype(np.intp)
        _, receivings, tilts = self.shape
        cell = (node[:, 0] * receivings + node[:, 1] + self.side) * tilts + node[:, 2] + self.side
        return rows, cell, x


TERMS = 10


def basis(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """`[n, 10]`: 1, Δa, Δr, Δt, their squares, and the products Δr Δt, Δa Δt, Δa Δr."""
    a, r, t = x.T
    return np.stack([np.ones_like(a), a, r, t, a * a, r * r, t * t, r * t, a * t, a * r], axis=1)
