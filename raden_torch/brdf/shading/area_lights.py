"""Lamps with a shape: rectangles, discs and spheres of even radiance, as stratified samples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.shading.triples import Colour, Triple, as_map, checked, inverse_square
from raden_torch.errors import InputError
from raden_torch.geometry import dot, normalised

_MOST = 24
"""Samples along each side."""
_PARALLEL = 1e-9


@dataclass(frozen=True, eq=False)
class RectangleLight:
    """A window or a soft box; it shines to the side that `across` × `up` points to.

    Attributes:
        position: its middle.
        across, up: its whole sides, at right angles or not.
        radiance: linear RGB; the irradiance facing it, far away, is radiance · area / d².
        tolerance: about how far the irradiance may be off, relatively: samples are as dense as the
            nearest pixel needs, at most 24 x 24.
        visibility: `[B, 1, H, W]`, how much of it each pixel of the image sees, 0…1.

    Raises:
        InputError: a lamp without area.

    Examples:
        >>> from raden_torch.brdf.shading.area_lights import RectangleLight
        >>> RectangleLight((0, 0, 1), across=(1, 0, 0), up=(0, -1, 0), radiance=2.0).radiance
        2.0
    """

    position: Triple
    across: Triple
    up: Triple
    radiance: Colour = 1.0
    tolerance: float = 0.005
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        checked("RectangleLight: position", self.position)
        checked("RectangleLight: radiance", self.radiance, may_be_one=True)
        sides = [checked(f"RectangleLight: {k}", getattr(self, k)) for k in ("across", "up")]
        area = float(torch.linalg.cross(*sides).norm(dim=-1).min())
        _check(self, area, "across and up that span an area")

    def lamps(self, position: Tensor, like: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Direction to each sample, and the irradiance facing it."""
        middle, across, up = (as_map(x, like) for x in (self.position, self.across, self.up))
        normal = torch.linalg.cross(across, up, dim=1)
        size = float(torch.maximum(across.norm(dim=1), up.norm(dim=1)).max())
        count = _count(position, middle, size, self.tolerance)
        share = normal / count**2
        for i in range(count):
            for j in range(count):
                x, y = (i + 0.5) / count - 0.5, (j + 0.5) / count - 0.5
                yield _sample(middle + x * across + y * up, share, position, self.radiance)


@dataclass(frozen=True, eq=False)
class DiscLight:
    """A round lamp that shines to one side.

    Attributes:
        position: its middle.
        facing: the direction that it shines in.
        radius: in the G-buffer's unit of length.
        radiance, tolerance, visibility: as for `RectangleLight`.
    """

    position: Triple
    facing: Triple
    radius: float
    radiance: Colour = 1.0
    tolerance: float = 0.005
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        checked("DiscLight: position", self.position)
        checked("DiscLight: radiance", self.radiance, may_be_one=True)
        length = float(checked("DiscLight: facing", self.facing).norm(dim=-1).min())
        _check(self, self.radius if length > 0 else 0.0, "a direction and a radius above 0")

    def lamps(self, position: Tensor, like: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Direction to each sample, and the irradiance facing it."""
        middle, facing = as_map(self.position, like), normalised(as_map(self.facing, like))
        count = _count(position, middle, 2 * self.radius, self.tolerance)
        yield from _disc(middle, facing, self.radius, count, position, self.radiance)


@dataclass(frozen=True, eq=False)
class SphereLight:
    """A ball that shines evenly: a paper lantern.

    A pixel sees it as a disc that faces the pixel and has the ball's solid angle.

    Attributes:
        position: its middle.
        radius: in the G-buffer's unit of length; within it nothing is lit.
        radiance, tolerance, visibility: as for `RectangleLight`.
    """

    position: Triple
    radius: float
    radiance: Colour = 1.0
    tolerance: float = 0.005
    visibility: Tensor | None = None

    def __post_init__(self) -> None:
        checked("SphereLight: position", self.position)
        checked("SphereLight: radiance", self.radiance, may_be_one=True)
        _check(self, self.radius, "a radius above 0")

    def lamps(self, position: Tensor, like: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Direction to each sample, and the irradiance facing it."""
        middle = as_map(self.position, like)
        count = _count(position, middle, 2 * self.radius, self.tolerance)
        towards = position - middle
        square = dot(towards, towards)
        outside = square > self.radius**2
        safe = torch.where(outside, square, torch.full_like(square, 2 * self.radius**2))
        # the circle where rays from the pixel touch the ball
        radius = self.radius * torch.sqrt(1 - self.radius**2 / safe)
        centre = middle + towards * (self.radius**2 / safe)
        lit = outside.to(like.dtype)
        for to, e in _disc(centre, normalised(towards), radius, count, position, self.radiance):
            yield to, e * lit


AreaLight = RectangleLight | DiscLight | SphereLight


def on_rectangle(
    start: Tensor, towards: Tensor, middle: Tensor, across: Tensor, up: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Where rays meet the plane of a rectangle.

    Args:
        start, towards: `[3, 1 or N]` and `[3, N]`, of the rays.
        middle, across, up: `[3]` each; the two sides need not be at right angles.

    Returns:
        `[2, N]` the place from the middle, in sides; `[N]` the reach, in lengths of `towards`, not
        above 0 behind the start; `[N]` below 0 where the front, to which `across` × `up` points, is
        met.
    """
    normal = torch.linalg.cross(across, up)
    facing = normal @ towards
    apart = torch.where(facing.abs() > _PARALLEL, facing, _PARALLEL)
    reach = normal @ (middle[:, None] - start) / apart
    offset = start + reach * towards - middle[:, None]
    sides = torch.stack([across, up])
    return torch.linalg.solve(sides @ sides.T, sides @ offset), reach, facing


def _disc(
    middle: Tensor,
    facing: Tensor,
    radius: float | Tensor,
    count: int,
    position: Tensor,
    radiance: Colour,
) -> Iterator[tuple[Tensor, Tensor]]:
    """Cells of equal area in `count` rings."""
    least = torch.zeros_like(facing).scatter(1, facing.abs().argmin(1, keepdim=True), 1.0)
    x = normalised(torch.linalg.cross(facing, least, dim=1))
    y = torch.linalg.cross(facing, x, dim=1)
    share = facing * (math.pi * radius**2 / count**2)
    for ring in range(count):
        cells = 2 * ring + 1
        # the root mean square of the ring's radii; one cell in the middle
        r = math.sqrt((ring**2 + (ring + 1) ** 2) / 2) / count if ring else 0.0
        for k in range(cells):
            turn = 2 * math.pi * (k + 0.5) / cells
            offset = (math.cos(turn) * x + math.sin(turn) * y) * (r * radius)
            yield _sample(middle + offset, share, position, radiance)


def _sample(at: Tensor, area: Tensor, position: Tensor, radiance: Colour) -> tuple[Tensor, Tensor]:
    """One patch of a lamp: its area vector, seen from everywhere."""
    to_light = at - position
    falling = inverse_square(to_light)
    seen = (-dot(to_light, area) * falling.sqrt()).clamp(min=0)
    return to_light, as_map(radiance, position) * (seen * falling)


def _count(position: Tensor, middle: Tensor, size: float, tolerance: float) -> int:
    """Samples along a side: a cell c at distance d is off by some (c/d)²/4."""
    away = (position - middle).norm(dim=1)
    away = away[torch.isfinite(away)]
    nearest = float(away.min()) if away.numel() else math.inf
    if nearest <= 0:
        return _MOST
    return min(_MOST, max(2, math.ceil(size / (nearest * math.sqrt(4 * tolerance)))))


def _check(light: AreaLight, size: float, expected: str) -> None:
    name = type(light).__name__
    if not 0 < size < math.inf:
        raise InputError(f"{name}: expected {expected}, got {size:g}")
    if not light.tolerance > 0:
        raise InputError(f"{name}: tolerance: expected more than 0, got {light.tolerance}")
