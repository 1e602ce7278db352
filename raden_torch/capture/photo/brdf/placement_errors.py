"""What an error of where the sample is does to its shape: the shape, moved by it.

A ball's centre and radius, a rod's axis and radius follow from the edge of a mask. A rod on the
board lies where a person says, and has the radius that a person measured. The errors of the board's
pose are in `pose_errors`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.ball import outline_moves
from raden_torch.capture.photo.brdf.capture_settings import SampleSpec
from raden_torch.capture.photo.brdf.rays import board_direction, projected
from raden_torch.capture.photo.brdf.sample_shapes import Cylinder, Shape, Sphere
from raden_torch.capture.photo.camera import Camera, Pose


@dataclass(frozen=True)
class PlacementErrors:
    """How well it is known where the sample is.

    Attributes:
        on_board: it lies there; else it was found by its outline.
        outline_px: standard deviation of that outline.
        axis_mm: of each of two points of a rod's axis on the board, across it.
        radius_mm: of a ball's or rod's radius, where a camera makes it count.
    """

    on_board: bool
    outline_px: float
    axis_mm: float = 0.0
    radius_mm: float = 0.0

    @classmethod
    def of(cls, sample: SampleSpec, outline_px: float) -> PlacementErrors:
        """Those that are stated of a sample."""
        return cls(sample.lies_on_board, outline_px, sample.axis_std_mm, sample.radius_std_mm)

    def moved(self, shape: Shape, camera: Camera | None, pose: Pose | None) -> list[Shape]:
        """The shape, moved by one standard deviation of each error: of a flat piece none; of a rod
        on the board its axis across and turned, and its radius; else as the outline's errors move
        it, and with a camera by its radius."""
        if not isinstance(shape, Sphere | Cylinder):
            return []
        if isinstance(shape, Cylinder) and self.on_board and pose is not None:
            return _misplaced(shape, pose, self.axis_mm, self.radius_mm)
        found = moved_shapes(shape, camera, self.outline_px)
        if camera is not None and self.radius_mm > 0:
            found.append(_scaled(shape, 1 + self.radius_mm / shape.radius))
        return found


def moved_shapes(shape: Sphere | Cylinder, camera: Camera | None, std_px: float) -> list[Shape]:
    """The shape, moved by one standard deviation of each error that its outline may have: a sphere
    across the line of sight, in two directions, and in size (with a camera, whose sphere has a
    known radius: nearer); a cylinder across its axis and in size, and its ends the one or the other
    way.

    Args:
        std_px: of each; 0: nothing moves.
    """
    if std_px == 0:
        return []
    if isinstance(shape, Sphere):
        radius_px = _radius_px(shape.centre, shape.radius, camera)
        is_near = camera is not None
        moves = outline_moves(shape.centre, shape.radius, radius_px, std_px, is_near=is_near)
        return [replace(shape, centre=centre, radius=radius) for centre, radius in moves]
    return _moved_rods(shape, camera, std_px)


def _misplaced(rod: Cylinder, pose: Pose, axis_mm: float, radius_mm: float) -> list[Shape]:
    """A rod on the board: its axis elsewhere, and thicker, whose axis lies higher."""
    up = board_direction(pose, np.array([0.0, 0.0, -1.0]))
    across = np.cross(rod.axis, up)
    middle = _middle(rod)
    # two points, each off by itself: their mean and half their difference by 1/√2
    shift = axis_mm / np.sqrt(2) * across
    thicker = replace(rod, point=rod.point + radius_mm * up, radius=rod.radius + radius_mm)
    moved: list[Shape] = [replace(rod, point=rod.point + shift)] if axis_mm else []
    moved += [_turned(rod, middle, 2 * shift / _length(rod))] if axis_mm else []
    return [*moved, thicker] if radius_mm else moved


def _scaled(shape: Sphere | Cylinder, by: float) -> Shape:
    """The same outline of a larger one, farther away."""
    if isinstance(shape, Sphere):
        return Sphere(by * shape.centre, by * shape.radius)
    low, high = shape.reach
    return Cylinder(by * shape.point, shape.axis, by * shape.radius, (by * low, by * high))


def _moved_rods(rod: Cylinder, camera: Camera | None, std_px: float) -> list[Shape]:
    middle = _middle(rod)
    sight = np.array([0.0, 0.0, -1.0]) if camera is None else middle / np.linalg.norm(middle)
    across = np.cross(rod.axis, sight)
    across /= np.linalg.norm(across)
    radius_px = _radius_px(middle, rod.radius, camera)
    # two edges, each wrong by itself: their mean and half their distance by 1/√2
    shift = std_px * rod.radius / radius_px / np.sqrt(2)
    moved: list[Shape] = [
        replace(rod, point=rod.point + shift * across),
        _turned(rod, middle, 2 * shift / _length(rod) * across),
    ]
    if camera is None:
        return [*moved, replace(rod, radius=rod.radius + std_px / np.sqrt(2))]
    depth = std_px / np.sqrt(2) / radius_px * float(np.linalg.norm(middle))
    along = sight - (sight @ rod.axis) * rod.axis
    return [
        *moved,
        replace(rod, point=rod.point - depth * sight),
        _turned(rod, middle, 2 * depth / _length(rod) * along),
    ]


def _middle(rod: Cylinder) -> Floats:
    """Of its axis."""
    return np.asarray(rod.point + (rod.reach[0] + rod.reach[1]) / 2 * rod.axis)


def _length(rod: Cylinder) -> float:
    return rod.reach[1] - rod.reach[0]


def _turned(rod: Cylinder, middle: Floats, lean: Floats) -> Cylinder:
    """Turned about its middle, by a small lean `[3]` of its axis."""
    axis = rod.axis + lean
    axis /= np.linalg.norm(axis)
    half = (rod.reach[0] + rod.reach[1]) / 2
    return replace(rod, point=middle - half * axis, axis=axis)


def _radius_px(middle: Floats, radius: float, camera: Camera | None) -> float:
    """The sample's radius in the picture."""
    if camera is None:
        return radius
    there = projected(camera, np.stack([middle, middle + radius * np.eye(3)[0]]))
    return float(np.linalg.norm(there[1] - there[0]))
