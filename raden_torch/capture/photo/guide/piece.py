"""What is photographed: points all over it, their normals, and what they see of lamp and camera.

Lengths are in mm. The piece's frame: z is its normal at the middle, x a direction on it that the
person marks (along the board's rows), y to the left of x; the origin is the middle of its surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.brdf.sample_shapes import Cylinder, Plane, Shape, Sphere
from raden_torch.capture.photo.brdf.seen_surface import LEAST_COSINE
from raden_torch.errors import InputError

_POINTS = 150
_CELL_DEG = 5.0
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Piece:
    """A sample before it is photographed.

    Attributes:
        shape: "plane", "cylinder" or "sphere", as `raden capture brdf` calls it.
        size_mm: width and height of a plane; length and radius of a cylinder; radius of a sphere,
            twice.
        tilts_deg: of equal flat pieces side by side, each leaning towards x; (0,) for one that
            lies flat.
        points, normals: `[P, 3]`.
    """

    shape: str
    size_mm: tuple[float, float]
    tilts_deg: tuple[float, ...]
    points: Floats
    normals: Floats

    @classmethod
    def flat(cls, width_mm: float, height_mm: float, tilts_deg: Sequence[float] = (0.0,)) -> Piece:
        """One piece, or equal ones on wedges.

        Raises:
            InputError: a size that is not above 0, a tilt beyond 60 degrees.
        """
        _check(width_mm, "width")
        _check(height_mm, "height")
        if any(abs(tilt) > 60 for tilt in tilts_deg):
            raise InputError(
                f"piece: tilt: expected at most 60 deg, got {max(tilts_deg, key=abs):g} deg"
            )
        half = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        half *= np.array([width_mm, height_mm, 0]) / 2
        planes = []
        for tilt in np.radians(tilts_deg):
            turn = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0],
                             [-np.sin(tilt), 0, np.cos(tilt)]])  # fmt: skip
            planes.append(Plane(half @ turn.T, turn @ _UP))
        return cls._of("plane", (width_mm, height_mm), tuple(tilts_deg), planes)

    @classmethod
    def rod(cls, length_mm: float, radius_mm: float) -> Piece:
        """A strip bent round a rod that lies along x; its upper half.

        Raises:
            InputError: a size that is not above 0.
        """
        _check(length_mm, "length")
        _check(radius_mm, "radius")
        axis, along = np.array([0.0, 0.0, -radius_mm]), np.array([1.0, 0.0, 0.0])
        shape = Cylinder(axis, along, radius_mm, (-length_mm / 2, length_mm / 2))
        return cls._of("cylinder", (length_mm, radius_mm), (0.0,), [shape])

    @classmethod
    def button(cls, radius_mm: float) -> Piece:
        """A convex piece, half of a ball.

        Raises:
            InputError: a radius that is not above 0.
        """
        _check(radius_mm, "radius")
        shape = Sphere(np.array([0.0, 0.0, -radius_mm]), radius_mm)
        return cls._of("sphere", (radius_mm, radius_mm), (0.0,), [shape])

    @classmethod
    def _of(
        cls,
        shape: str,
        size_mm: tuple[float, float],
        tilts_deg: tuple[float, ...],
        parts: Sequence[Shape],
    ) -> Piece:
        spread = [part.spread(_POINTS)[0] for part in parts]
        points = np.concatenate([surface.point for surface in spread])
        normals = np.concatenate([surface.normal for surface in spread])
        up = normals[:, 2] > LEAST_COSINE
        return cls(shape, size_mm, tilts_deg, points[up], normals[up])

    @property
    def reach_mm(self) -> float:
        """From the origin to its farthest point."""
        return float(np.linalg.norm(self.points, axis=1).max())

    def angles_deg(self, lamp_mm: Floats, camera_mm: Floats) -> Floats:
        """`[K, 3]` incidence, receiving and tilt that a photograph of it holds: one geometry, the
        mean, of each 5 degree cell, for a lamp and a camera at `[3]`; none where nothing is lit and
        seen."""
        light, view = (_towards(place, self.points) for place in (lamp_mm, camera_mm))
        lit = (light * self.normals).sum(1) > LEAST_COSINE
        good = lit & ((view * self.normals).sum(1) > LEAST_COSINE)
        if not good.any():
            return np.zeros((0, 3))
        angles = angles_deg(self.normals[good], light[good], view[good]).astype(np.float64)
        _, index = np.unique(np.rint(angles / _CELL_DEG), axis=0, return_inverse=True)
        index = index.ravel()
        sums = np.stack([np.bincount(index, column) for column in angles.T], 1)
        return sums / np.bincount(index)[:, None]

    def described(self) -> str:
        first, second = self.size_mm
        if self.shape == "cylinder":
            return f"a strip bent round a rod of {second:g} mm radius, {first:g} mm long"
        if self.shape == "sphere":
            return f"a convex piece of {first:g} mm radius"
        leaning = ", ".join(f"{tilt:g}" for tilt in self.tilts_deg)
        flat = f"a flat piece of {first:g} x {second:g} mm"
        return flat if self.tilts_deg == (0.0,) else f"{flat}, once each on wedges of {leaning} deg"


def _towards(place: Floats, points: Floats) -> Floats:
    way = place - points
    return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))


def _check(length_mm: float, name: str) -> None:
    if not 0 < length_mm < 2000:
        raise InputError(f"piece: {name}: expected above 0 and below 2000 mm, got {length_mm:g} mm")
