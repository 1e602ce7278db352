"""The measured reflection as a table, read trilinearly (Take 2012, §5.2 and §5.3)."""

from __future__ import annotations

from itertools import product

import torch
from torch import Tensor, nn

from raden_torch.errors import InputError
from raden_torch.geometry import XYZ_DIM


class ReflectanceTable(nn.Module):
    """Total f_r (diffuse and specular) on a regular grid of (incidence, receiving, tilt).

    Attributes:
        values: `[A, R, T, C]` in 1/sr, a parameter.
        first_deg, step_deg: the angle of the first node and the distance between nodes, per axis.
    """

    def __init__(
        self,
        values: Tensor,
        first_deg: tuple[float, float, float],
        step_deg: tuple[float, float, float],
    ) -> None:
        super().__init__()
        if values.ndim != 4 or min(values.shape[:3]) < 2:
            raise InputError(
                f"table: shape {list(values.shape)}; [A, R, T, C] with at least two nodes on each "
                "axis was wanted"
            )
        if min(step_deg) <= 0:
            raise InputError(f"table: step_deg {step_deg}; positive steps were wanted")
        self.values = nn.Parameter(values)
        self.first_deg = first_deg
        self.step_deg = step_deg

    @property
    def last_deg(self) -> tuple[float, float, float]:
        """The angle of the last node, per axis."""
        nodes = self.values.shape[:3]
        axes = zip(self.first_deg, self.step_deg, nodes, strict=True)
        a, r, t = (first + step * (n - 1) for first, step, n in axes)
        return a, r, t

    def forward(self, incidence: Tensor, receiving: Tensor, tilt: Tensor) -> tuple[Tensor, Tensor]:
        """The table at any angles, and how far it can be trusted there.

        Args:
            incidence, receiving, tilt: `[..., 1, H, W]` in radians, of one shape.

        Returns:
            f_r `[..., C, H, W]` in 1/sr, exact at nodes, the nearest edge's value outside the box;
            and its weight `[..., 1, H, W]`: 1 inside the box, falling linearly to 0 over one grid
            step outside.
        """
        position, weight = [], torch.ones_like(incidence)
        for angle, first, step, n in zip(
            (incidence, receiving, tilt),
            self.first_deg,
            self.step_deg,
            self.values.shape[:3],
            strict=True,
        ):
            x = (torch.rad2deg(angle) - first) / step
            inside = x.clamp(0, n - 1)
            weight = weight * (1 - (x - inside).abs()).clamp(min=0)
            position.append(inside)
        return trilinear(self.values.to(incidence.dtype), *position), weight

    def extra_repr(self) -> str:
        axes = zip(
            ("incidence", "receiving", "tilt"),
            self.first_deg,
            self.last_deg,
            self.step_deg,
            strict=True,
        )
        return ", ".join(
            f"{name} {first:g}…{last:g} by {step:g}" for name, first, last, step in axes
        )


def trilinear(table: Tensor, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Trilinear interpolation between the eight nodes around each position.

    Args:
        table: `[X, Y, Z, C]`.
        x, y, z: `[..., 1, H, W]` positions in nodes, within 0…X−1, 0…Y−1 and 0…Z−1.

    Returns:
        `[..., C, H, W]`.
    """
    nx, ny, nz, channels = table.shape
    rows = table.reshape(-1, channels)
    corner, fraction = [], []
    for position, n in ((x, nx), (y, ny), (z, nz)):
        low = position.detach().floor().clamp(max=n - 2)
        corner.append(low.to(torch.int32))
        fraction.append(position - low)
    i, j, k = corner
    first = (i * ny + j) * nz + k
    total = torch.zeros((), dtype=table.dtype, device=table.device)
    for di, dj, dk in product((0, 1), repeat=3):
        weight = torch.ones_like(x)
        for f, d in zip(fraction, (di, dj, dk), strict=True):
            weight = weight * (f if d else 1 - f)
        cell = rows[first + ((di * ny + dj) * nz + dk)]  # [..., 1, H, W, C]
        total = total + weight * cell.movedim(-1, XYZ_DIM).squeeze(XYZ_DIM - 1)
    return total
