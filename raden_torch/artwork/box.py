"""The shape of a lacquer box on a table: where rays meet it, its normals, and its charts.

A block with rounded edges whose lid is a little domed, and a seam around it where the lid ends. The
dome is in the normals alone. y is up, the table is y = 0, the front faces +z.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.errors import InputError
from raden_torch.geometry import unit_columns

TABLE, LID, FRONT, RIGHT, BACK, LEFT = 0, 1, 2, 3, 4, 5
"""Parts that a ray may meet; the last five are charts of the box."""
NOTHING = -1

_STEPS = 120
_NEAR = 2e-5
_AXES = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))
"""Outward, of the sides from FRONT on."""


@dataclass(frozen=True)
class Hits:
    """Where rays end.

    Attributes:
        part: `[N]`, one of the parts, or NOTHING.
        position: `[3, N]`; 0 where nothing is met.
        normal: `[3, N]`, of the rounded block or the table.
    """

    part: Tensor
    position: Tensor
    normal: Tensor


@dataclass(frozen=True)
class Box:
    """A box that stands on the table about the origin.

    Attributes:
        half: half its width (x) and depth (z), and its whole height between them (y).
        rounding: radius of its edges.
        dome: slope of the lid at its border.
        seam: height of the seam, over the whole height.
    """

    half: tuple[float, float, float] = (1.4, 0.78, 1.0)
    rounding: float = 0.075
    dome: float = 0.055
    seam: float = 0.64

    def __post_init__(self) -> None:
        least = min(self.half[0], self.half[1] / 2, self.half[2])
        if not 0 < self.rounding < least:
            raise InputError(
                f"box: rounding: expected more than 0 and less than {least:g}, half its smallest "
                f"side, got {self.rounding:g}"
            )

    @property
    def height(self) -> float:
        return self.half[1]

    def cast(self, eye: Tensor, rays: Tensor) -> Hits:
        """Where rays `[3, N]` from an eye `[3]`, outside of the box and above the table, end."""
        reach, normal, met = self._block(eye, rays)
        down = rays[1] < -1e-9
        to_table = torch.where(down, -eye[1] / rays[1].clamp(max=-1e-9), torch.inf)
        table = down & ~met
        reach = torch.where(met, reach, torch.where(table, to_table, 0.0))
        normal = torch.where(met, normal, normal.new_tensor([0.0, 1.0, 0.0])[:, None])
        found = met | table
        position = torch.where(found, eye[:, None] + reach * rays, 0.0)
        part = torch.where(met, self._part(normal), torch.where(table, TABLE, NOTHING))
        return Hits(part, position, torch.where(found, normal, 0.0))

    def covers(self, points: Tensor, towards: Tensor, soft: float = 0.0) -> Tensor:
        """How much the box hides a light: points and unit directions `[3, N]` → `[N]`, 0…1.

        By the block without its rounding.

        Args:
            soft: a way through the box shorter than this hides only in part, which makes a shadow's
                edge wide enough to be sampled.
        """
        near, far, _ = self._slabs(points, towards)
        way = torch.where(far > 1e-6, far - near.clamp(min=0), 0.0)
        return (way / soft).clamp(0, 1) if soft > 0 else (way > 0).to(points)

    def domed(self, normal: Tensor, position: Tensor) -> Tensor:
        """`[3, N]` unit normals with the lid's dome, most on top and none on the sides."""
        x, _, z = self.half
        lean = self.dome * normal[1].clamp(min=0) ** 2
        tilt = torch.stack([lean * position[0] / x, torch.zeros_like(lean), lean * position[2] / z])
        return unit_columns(normal + tilt)

    def chart(self, part: Tensor, position: Tensor) -> Tensor:
        """`[2, N]` places on each part's own plane: right and up as one faces it, from its middle
        (of the lid) or the middle of its lower edge (of a side)."""
        x, y, z = position
        right = torch.stack([x, x, -z, -x, z])
        place = (part - LID).clamp(min=0)[None]
        up = torch.where(part == LID, -z, y)
        return torch.stack([right.gather(0, place)[0], up])

    def chart_size(self, part: int) -> tuple[float, float, float]:
        """Half the width, and the lower and the upper end, of a part's chart."""
        x, y, z = self.half
        if part == LID:
            return x, -z, z
        return (x if part in (FRONT, BACK) else z), 0.0, y

    def _part(self, normal: Tensor) -> Tensor:
        sides = normal.new_tensor(_AXES) @ normal
        best, which = sides.max(0)
        return torch.where(normal[1] >= best, LID, FRONT + which)

    def _slabs(self, eye: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Reach to the outer block and beyond it, and the axis of the face that is met."""
        x, y, z = self.half
        low, high = (eye.new_tensor(c).view(3, 1) for c in ((-x, 0.0, -z), (x, y, z)))
        origin = eye.view(3, -1)
        inverse = 1 / torch.where(rays.abs() < 1e-12, 1e-12, rays)
        first, second = (low - origin) * inverse, (high - origin) * inverse
        near, axis = torch.minimum(first, second).max(0)
        return near, torch.maximum(first, second).amin(0), axis

    def _block(self, eye: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Reach, normal, and whether the rounded block is met."""
        near, far, axis = self._slabs(eye, rays)
        met = (far > near) & (near > 0)
        axes = torch.eye(3, dtype=rays.dtype)
        normal = torch.where(met, -axes[:, axis] * rays.sign(), 0.0)
        if not bool(met.any()):
            return near, normal, met
        where = met.nonzero()[:, 0]
        point = self._centred(eye[:, None] + near[where] * rays[:, where])
        inner = self._inner(rays)
        outside = (point.abs() > inner).sum(0)
        rim = where[outside > 1]  # on a face it is 1, its own axis; more at edges and corners
        if len(rim):
            reach, hit = self._march(eye, rays[:, rim], near[rim], far[rim])
            at = self._centred(eye[:, None] + reach * rays[:, rim])
            beyond = (at.abs() - inner).clamp(min=0) * at.sign()
            near, met, normal = near.clone(), met.clone(), normal.clone()
            near[rim], met[rim] = reach, hit
            normal[:, rim] = unit_columns(beyond)
        return near, normal * met, met

    def _march(self, eye: Tensor, rays: Tensor, near: Tensor, far: Tensor) -> tuple[Tensor, Tensor]:
        """Sphere tracing (Hart 1996) of the rounded block between two reaches."""
        reach, inner = near.clone(), self._inner(rays)
        length = rays.square().sum(0).sqrt()
        left = torch.arange(len(near))
        hit = torch.zeros_like(near, dtype=torch.bool)
        for _ in range(_STEPS):
            point = self._centred(eye[:, None] + reach[left] * rays[:, left])
            away = (point.abs() - inner).clamp(min=0).square().sum(0).sqrt() - self.rounding
            close = away < _NEAR
            hit[left[close]] = True
            reach[left] += (away / length[left]).clamp(min=0)
            left = left[~close & (reach[left] < far[left])]
            if not len(left):
                break
        return reach, hit

    def _centred(self, point: Tensor) -> Tensor:
        return point - point.new_tensor([0.0, self.half[1] / 2, 0.0])[:, None]

    def _inner(self, like: Tensor) -> Tensor:
        x, y, z = self.half
        return like.new_tensor([x, y / 2, z])[:, None] - self.rounding
