"""A quadrature over all directions that is finest about the mirror direction.

Rings of cells around the mirror direction R: a cell is as wide as a fixed part of its distance
from R, down to half a degree and up to `_WIDEST`. In each cell f_r cos θi is integrated by itself
(`ring_weights`), once for each angle θ between N and V, and multiplied by the surroundings' mean
over the cell. What is lost is how the two vary together within a cell: little where a material
changes slowly away from R, however sharp it is at R.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection, Surface, reflected

_SMALLEST = math.radians(0.5)
_GROWTH = 1.2
_AROUND = 32
"""Cells of a small ring."""
_WIDEST = math.radians(12.0)
_WITHIN = 3
"""Points a cell is integrated at, along each side."""
_ROWS = 65
"""Angles between N and V, 0 to 90°, closer towards 90°, where a lobe changes fast."""
_GRAZING = math.pi / 2 - 1e-3


@dataclass(frozen=True)
class Ring:
    """Cells between two angles from R.

    Attributes:
        inner, outer: radians from R.
        cells: how many, evenly around.
    """

    inner: float
    outer: float
    cells: int

    @property
    def size(self) -> float:
        """How wide a cell is, radians."""
        area = 2 * math.pi * (math.cos(self.inner) - math.cos(self.outer)) / self.cells
        return math.sqrt(area)

    def directions(self) -> Tensor:
        """`[cells, 3]` float64 to the cells' middles, along R, and t and p around it."""
        middle = 0.0 if self.inner == 0 else (self.inner + self.outer) / 2
        turn = (torch.arange(self.cells, dtype=torch.float64) + 0.5) * (2 * math.pi / self.cells)
        return _around(torch.tensor(middle, dtype=torch.float64), turn)


def rings() -> list[Ring]:
    """From R to −R."""
    found = [Ring(0.0, _SMALLEST, 1)]
    while found[-1].outer < math.pi:
        inner = found[-1].outer
        outer = inner + min(inner * (_GROWTH - 1), _WIDEST)
        if outer > math.pi - _WIDEST / 2:
            outer = math.pi
        middle, step = (inner + outer) / 2, outer - inner
        around = 2 * math.pi * math.sin(middle) / step
        found.append(Ring(inner, outer, max(_AROUND, math.ceil(around))))
    return found


def ring_weights(material: Reflection) -> list[Tensor]:
    """`[3, rows, cells]` float32 for each ring: ∫ f_r cos θi over each cell.

    Rows are angles between N and V from 0 to (nearly) 90°, see `row_of`.
    """
    share = torch.linspace(0, 1, _ROWS, dtype=torch.float64).view(-1, 1)
    theta = _GRAZING * (1 - (1 - share) ** 2)
    zero, one = torch.zeros_like(theta), torch.ones_like(theta)
    normal = torch.stack([zero, zero, one])
    view = torch.stack([theta.sin(), zero, theta.cos()])
    axes = mirror_axes(normal[None], view[None])[0]  # [3 axes, 3, rows, 1]
    return [_integrated(material, ring, axes, normal, view) for ring in rings()]


def _integrated(
    material: Reflection, ring: Ring, axes: Tensor, normal: Tensor, view: Tensor
) -> Tensor:
    share = (torch.arange(_WITHIN, dtype=torch.float64) + 0.5) / _WITHIN
    # points of equal solid angle: even in the cosine, and around
    cosine = math.cos(ring.inner) + share * (math.cos(ring.outer) - math.cos(ring.inner))
    around = _WITHIN if ring.cells > 1 else 2 * _WITHIN
    turn = (torch.arange(ring.cells * around, dtype=torch.float64) + 0.5) * (
        2 * math.pi / (ring.cells * around)
    )
    local = _around(_angle(cosine)[:, None], turn[None])  # [within, cells · around, 3]
    light = torch.einsum("wka,acr->crwk", local, axes[..., 0])
    light = light.flatten(2)[None].float()
    n, v = normal[None].float(), view[None].float()
    f = reflected(material, Surface(n, v), light)
    weighted = f * (light * n).sum(1, keepdim=True).clamp(min=0)
    cells = weighted[0].view(3, _ROWS, _WITHIN, ring.cells, around).double().mean((2, 4))
    area = 2 * math.pi * (math.cos(ring.inner) - math.cos(ring.outer)) / ring.cells
    return (cells * area).float()


def _angle(cosine: Tensor) -> Tensor:
    """In radians, of a cosine −1…1."""
    return torch.atan2(torch.sqrt((1 - cosine) * (1 + cosine)), cosine)


def row_of(cosine: Tensor) -> Tensor:
    """Where N·V lies among the rows of `ring_weights`."""
    share = (_angle(cosine.clamp(0, 1)) / _GRAZING).clamp(max=1)
    return (1 - torch.sqrt(1 - share)) * (_ROWS - 1)


def mirror_axes(normal: Tensor, view: Tensor) -> Tensor:
    """`[..., 3, 3, H, W]` of unit `[..., 3, H, W]`: R; t across it towards N; p = R × t."""
    cosine = (normal * view).sum(-3, keepdim=True)
    mirror = 2 * cosine * normal - view
    mirror = torch.nn.functional.normalize(mirror, dim=-3)
    across = normal - (normal * mirror).sum(-3, keepdim=True) * mirror
    # V on N leaves the plane free
    least = torch.zeros_like(mirror).scatter(-3, mirror.abs().argmin(-3, keepdim=True), 1.0)
    free = torch.linalg.cross(mirror, least, dim=-3)
    on_axis = (across * across).sum(-3, keepdim=True) < 1e-10
    across = torch.nn.functional.normalize(torch.where(on_axis, free, across), dim=-3)
    return torch.stack([mirror, across, torch.linalg.cross(mirror, across, dim=-3)], dim=-4)


def _around(angle: Tensor, turn: Tensor) -> Tensor:
    sine = torch.sin(angle)
    return torch.stack(
        [torch.cos(angle).expand_as(sine * turn), sine * torch.cos(turn), sine * torch.sin(turn)],
        dim=-1,
    )
