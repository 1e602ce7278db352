"""The reflection as a table, read trilinearly (Take 2012, §5.2 and §5.3).

Two kinds with one way of reading:

- *plain*, the paper's: one node per measured angle, axes incidence, receiving, tilt;
- *baked*: a finer table that another interpolation was written into. Its second axis is r − a, so
  that the mirror ridge runs along the first, and each measured cell is cut into as many pieces as
  that part of the measurement needs (`pieces`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import torch
from torch import Tensor, nn

from raden_torch.errors import InputError
from raden_torch.geometry import XYZ_DIM

Pieces = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]
"""Per axis, into how many pieces each measured cell is cut."""

_LEAST_STEP_DEG = 1e-3


class ReflectanceTable(nn.Module):
    """Total f_r (diffuse and specular) over incidence, receiving and tilt.

    Attributes:
        values: `[X, Y, Z, C]` in 1/sr, a parameter.
        first_deg, step_deg: the first measured angle and the distance between measured angles, per
            axis (incidence, receiving, tilt).
        pieces: None for a plain table; else its second axis is r − a.
    """

    _cuts_0: Tensor
    _cuts_1: Tensor
    _cuts_2: Tensor

    def __init__(
        self,
        values: Tensor,
        first_deg: tuple[float, float, float],
        step_deg: tuple[float, float, float],
        pieces: Pieces | None = None,
    ) -> None:
        super().__init__()
        if values.ndim != 4 or min(values.shape[:3]) < 2:
            raise InputError(
                "table: expected shape [X, Y, Z, C] with at least two nodes on each axis, got "
                f"{list(values.shape)}"
            )
        if not all(_LEAST_STEP_DEG <= step <= 180 for step in step_deg):
            raise InputError(f"table: step_deg: expected positive steps, got {step_deg}")
        if not all(abs(first) <= 180 for first in first_deg):
            raise InputError(f"table: expected first_deg within ±180, got {first_deg}")
        self.values = nn.Parameter(values)
        self.first_deg = first_deg
        self.step_deg = step_deg
        self.pieces = pieces
        for k, cuts in enumerate(pieces or ()):
            if 1 + sum(cuts) != values.shape[k] or min(cuts, default=0) < 1:
                raise InputError(
                    f"table: axis {k}: expected {1 + sum(cuts)} nodes for its pieces, got "
                    f"{values.shape[k]}"
                )
            self.register_buffer(f"_cuts_{k}", _cuts(cuts, values.device), persistent=False)
        if pieces is not None and len(pieces[1]) <= len(pieces[0]):
            raise InputError(
                "table: expected more cells along r − a than along a in a baked table, got fewer"
            )

    @property
    def cuts(self) -> tuple[Tensor, ...]:
        """Per axis of a baked table `[cells, 2]`: the first node of each cell, and its pieces."""
        return () if self.pieces is None else (self._cuts_0, self._cuts_1, self._cuts_2)

    @property
    def cells(self) -> tuple[int, int, int]:
        """Measured cells along incidence, receiving and tilt."""
        if self.pieces is None:
            a, r, t = (n - 1 for n in self.values.shape[:3])
        else:
            a, across, t = (len(cuts) for cuts in self.pieces)
            r = across - a
        return a, r, t

    @property
    def last_deg(self) -> tuple[float, float, float]:
        """The last measured angle, per axis."""
        axes = zip(self.first_deg, self.step_deg, self.cells, strict=True)
        a, r, t = (first + step * n for first, step, n in axes)
        return a, r, t

    def forward(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> tuple[Tensor, Tensor]:
        """The table at any angles, and how far it can be trusted there.

        Args:
            incidence, receiving, tilt: `[..., 1, H, W]` in radians, of one shape.

        Returns:
            f_r `[..., C, H, W]` in 1/sr, exact at nodes, the nearest edge's value outside the box;
            and its weight `[..., 1, H, W]`: 1 inside the box, falling linearly to 0 over one
            measured step outside.
        """
        positions, weight = self.positions(incidence, receiving, tilt)
        return trilinear(self.values.to(incidence.dtype), *positions), weight

    def positions(
        self, incidence: Tensor, receiving: Tensor, tilt: Tensor
    ) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor]:
        """Where any angles lie in the table, in nodes along its axes; and the weight of `forward`.

        Args:
            incidence, receiving, tilt: in radians, of one shape, which all results have.
        """
        inside, weight = [], torch.ones_like(incidence)
        for angle, first, step, n in zip(
            (incidence, receiving, tilt), self.first_deg, self.step_deg, self.cells, strict=True
        ):
            x = (torch.rad2deg(angle) - first) / step
            within = x.clamp(0, n)
            weight = weight * (1 - (x - within).abs()).clamp(min=0)
            inside.append(within)
        a, r, t = inside
        if self.pieces is not None:
            across = r - a + self.cells[0]  # in measured cells from the lowest r − a
            a, r, t = (self._cut(k, x) for k, x in enumerate((a, across, t)))
        return (a, r, t), weight

    def _cut(self, axis: int, x: Tensor) -> Tensor:
        """Measured cells → nodes: cell i begins at node `start` and is cut into `n` pieces."""
        cuts = self.cuts[axis].to(x.dtype)
        cell = x.detach().floor().clamp(0, len(cuts) - 1)
        index = cell.to(torch.int32)
        return cuts[:, 0][index] + (x - cell) * cuts[:, 1][index]

    def extra_repr(self) -> str:
        axes = zip(
            ("incidence", "receiving", "tilt"),
            self.first_deg,
            self.last_deg,
            self.step_deg,
            strict=True,
        )
        text = ", ".join(
            f"{name} {first:g}…{last:g} by {step:g}" for name, first, last, step in axes
        )
        return text if self.pieces is None else f"{text}, baked along r − a"


def _cuts(pieces: Sequence[int], device: torch.device) -> Tensor:
    """`[cells, 2]`: the first node of each cell, and its pieces."""
    n = torch.tensor(pieces, dtype=torch.float32, device=device)
    return torch.stack([n.cumsum(0) - n, n], dim=1)


def trilinear(table: Tensor, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Trilinear interpolation between the eight nodes around each position.

    Args:
        table: `[X, Y, Z, C]`.
        x, y, z: `[..., 1, H, W]` positions in nodes, within 0…X−1, 0…Y−1 and 0…Z−1.

    Returns:
        `[..., C, H, W]`.
    """
    channels = table.shape[-1]
    rows = table.reshape(-1, channels)
    total = torch.zeros((), dtype=table.dtype, device=table.device)
    for index, weight in corners((table.shape[0], table.shape[1], table.shape[2]), x, y, z):
        cell = rows[index]  # [..., 1, H, W, C]
        total = total + weight * cell.movedim(-1, XYZ_DIM).squeeze(XYZ_DIM - 1)
    return total


def corners(
    nodes: tuple[int, int, int], x: Tensor, y: Tensor, z: Tensor
) -> Iterator[tuple[Tensor, Tensor]]:
    """The eight nodes around each position of `trilinear`: their places in the table, counted
    along its last axis first (int32), and their weights."""
    corner, fraction = [], []
    for position, n in zip((x, y, z), nodes, strict=True):
        low = position.detach().floor().clamp(0, n - 2)
        corner.append(low.to(torch.int32))
        fraction.append(position - low)
    i, j, k = corner
    _, ny, nz = nodes
    first = (i * ny + j) * nz + k
    for di, dj, dk in product((0, 1), repeat=3):
        weight = torch.ones_like(x)
        for f, d in zip(fraction, (di, dj, dk), strict=True):
            weight = weight * (f if d else 1 - f)
        yield first + ((di * ny + dj) * nz + dk), weight
