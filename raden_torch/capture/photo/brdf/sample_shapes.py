"""Shapes a sample may have: what do a camera's rays see of it?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.brdf.rays import Rays
from raden_torch.capture.photo.directions import directions_across


@dataclass(frozen=True, eq=False)
class Surface:
    """Points and unit normals `[P, 3]`; NaN where a ray misses the sample."""

    point: Floats
    normal: Floats

    def __len__(self) -> int:
        return len(self.point)


class Shape(Protocol):
    """A sample's shape at one place."""

    @property
    def middle(self) -> Floats:
        """`[3]` a point amid the visible surface."""

    def seen(self, rays: Rays) -> Surface:
        """Where rays meet it first."""

    def spread(self, count: int) -> tuple[Surface, Floats]:
        """About `count` points all over the part that a camera may see, and each one's area."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball: its centre `[3]` and radius."""

    centre: Floats
    radius: float

    @property
    def middle(self) -> Floats:
        return self.centre + self.radius * np.array([0.0, 0.0, 1.0])

    def seen(self, rays: Rays) -> Surface:
        to_centre = self.centre - rays.start
        along = (to_centre * rays.direction).sum(1)
        # (|c|² − along²) loses digits where the camera is far: take the miss itself
        miss = to_centre - along[:, None] * rays.direction
        with np.errstate(invalid="ignore"):
            depth = np.sqrt(self.radius**2 - (miss**2).sum(1))
        normal = -(miss + depth[:, None] * rays.direction) / self.radius
        return Surface(self.centre + self.radius * normal, normal)

    def spread(self, count: int) -> tuple[Surface, Floats]:
        normal = fibonacci_sphere(count)
        area = np.full(count, 4 * np.pi * self.radius**2 / count)
        return Surface(self.centre + self.radius * normal, normal), area


@dataclass(frozen=True, eq=False)
class Plane:
    """A flat sample: its corners `[n, 3]` in one plane, and the normal on its visible side."""

    corners: Floats
    normal: Floats

    @property
    def middle(self) -> Floats:
        return np.asarray(self.corners.mean(axis=0))

    def seen(self, rays: Rays) -> Surface:
        """Where rays meet the plane, inside the corners or not."""
        facing = rays.direction @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = ((self.corners[0] - rays.start) @ self.normal) / facing
            depth = np.where(facing < 0, depth, np.nan)
        point = rays.start + depth[:, None] * rays.direction
        return Surface(point, np.broadcast_to(self.normal, point.shape))

    def holds(self, points: Floats) -> Bools:
        """`[P]`: points of its plane that lie inside the corners."""
        from matplotlib.path import Path

        across = self._across()
        return np.asarray(
            Path((self.corners - self.middle) @ across.T).contains_points(
                np.nan_to_num(points - self.middle, nan=np.inf) @ across.T
            )
        )

    def _across(self) -> Floats:
        """`[2, 3]` unit vectors along it."""
        return np.asarray(np.linalg.svd(self.corners - self.middle)[2][:2])

    def spread(self, count: int) -> tuple[Surface, Floats]:
        from matplotlib.path import Path

        across = self._across()
        flat = (self.corners - self.middle) @ across.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        step = float(np.sqrt(np.prod(high - low) / count))
        u, v = np.meshgrid(
            *(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True))
        )
        uv = np.stack([u.ravel(), v.ravel()], 1)
        uv = uv[Path(flat).contains_points(uv)]
        point = self.middle + uv @ across
        surface = Surface(point, np.broadcast_to(self.normal, point.shape))
        return surface, np.full(len(point), step**2)


@dataclass(frozen=True, eq=False)
class Planes:
    """Several flat pieces of one sample, each in its own plane."""

    parts: tuple[Plane, ...]

    @property
    def middle(self) -> Floats:
        return np.asarray(np.mean([part.middle for part in self.parts], axis=0))

    def seen(self, rays: Rays) -> Surface:
        """The first piece that a ray meets inside its corners."""
        point = np.full(rays.direction.shape, np.nan)
        normal, nearest = point.copy(), np.full(len(point), np.inf)
        for part in self.parts:
            met = part.seen(rays)
            depth = ((met.point - rays.start) * rays.direction).sum(1)
            first = np.isfinite(depth) & (depth < nearest) & part.holds(met.point)
            point[first], normal[first] = met.point[first], met.normal[first]
            nearest[first] = depth[first]
        return Surface(point, normal)

    def spread(self, count: int) -> tuple[Surface, Floats]:
        each = [part.spread(max(count // len(self.parts), 1)) for part in self.parts]
        point, normal = (
            np.concatenate([getattr(surface, name) for surface, _ in each])
            for name in ("point", "normal")
        )
        return Surface(point, normal), np.concatenate([area for _, area in each])


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A rod: a point of its axis, the axis' unit direction, the radius, and from where to where
    along the axis it reaches."""

    point: Floats
    axis: Floats
    radius: float
    reach: tuple[float, float]

    @property
    def middle(self) -> Floats:
        towards = np.array([0.0, 0.0, 1.0]) - self.axis[2] * self.axis
        centre = self.point + (self.reach[0] + self.reach[1]) / 2 * self.axis
        return np.asarray(centre + self.radius * towards / np.linalg.norm(towards))

    def seen(self, rays: Rays) -> Surface:
        flat = rays.direction - (rays.direction @ self.axis)[:, None] * self.axis
        to_axis = self.point - rays.start
        to_axis = to_axis - (to_axis @ self.axis)[:, None] * self.axis
        length = np.linalg.norm(flat, axis=1)
        unit = flat / length[:, None]
        along = (to_axis * unit).sum(1)
        miss = to_axis - along[:, None] * unit
        with np.errstate(invalid="ignore"):
            depth = np.sqrt(self.radius**2 - (miss**2).sum(1))
        normal = -(miss + depth[:, None] * unit) / self.radius
        point = rays.start + ((along - depth) / length)[:, None] * rays.direction
        return Surface(point, normal)

    def spread(self, count: int) -> tuple[Surface, Floats]:
        length = self.reach[1] - self.reach[0]
        around = max(8, round(np.sqrt(count * 2 * np.pi * self.radius / length)))
        along = max(2, round(count / around))
        turn = 2 * np.pi * (np.arange(around) + 0.5) / around
        first, second = directions_across(self.axis)
        ring = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
        place = self.reach[0] + length * (np.arange(along) + 0.5) / along
        normal = np.repeat(ring, along, axis=0)
        point = self.point + np.tile(place, around)[:, None] * self.axis + self.radius * normal
        area = 2 * np.pi * self.radius * length / (around * along)
        return Surface(point, normal), np.full(len(point), area)


def fibonacci_sphere(count: int) -> Floats:
    """`[count, 3]` unit vectors, evenly spread, the first one near +z."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)
