"""What an error of a sample's outline does to its shape: the shape, moved by it.

A ball's centre and radius, a rod's axis and radius follow from the edge of a mask; where the sample
lies on the board, nothing hangs on an outline.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.ball import outline_moves
from raden_torch.capture.photo.brdf.rays import projected
from raden_torch.capture.photo.brdf.sample_shapes import Cylinder, Shape, Sphere
from raden_torch.capture.photo.camera import Camera


def moved_shapes(shape: Shape, camera: Camera | None, std_px: float) -> list[Shape]:
    """The shape, moved by one standard deviation of each error that its outline may have: a sphere
    across the line of sight, in two directions, and in size (with a camera, whose sphere has a
    known radius: nearer); a cylinder across its axis and in size, and its ends the one or the other
    way.

    Args:
        std_px: of each; 0: nothing moves.
    """
    if std_px == 0 or not isinstance(shape, Sphere | Cylinder):
        return []
    if isinstance(shape, Sphere):
        radius_px = _radius_px(shape.centre, shape.radius, camera)
        is_near = camera is not None
        moves = outline_moves(shape.centre, shape.radius, radius_px, std_px, is_near=is_near)
        return [replace(shape, centre=centre, radius=radius) for centre, radius in moves]
    return _moved_rods(shape, camera, std_px)


def _moved_rods(rod: Cylinder, camera: Camera | None, std_px: float) -> list[Shape]:
    length = rod.reach[1] - rod.reach[0]
    middle = rod.point + (rod.reach[0] + rod.reach[1]) / 2 * rod.axis
    sight = np.array([0.0, 0.0, -1.0]) if camera is None else middle / np.linalg.norm(middle)
    across = np.cross(rod.axis, sight)
    across /= np.linalg.norm(across)
    radius_px = _radius_px(middle, rod.radius, camera)
    # two edges, each wrong by itself: their mean and half their distance by 1/√2
    shift = std_px * rod.radius / radius_px / np.sqrt(2)
    moved: list[Shape] = [
        replace(rod, point=rod.point + shift * across),
        _turned(rod, middle, 2 * shift / length * across),
    ]
    if camera is None:
        return [*moved, replace(rod, radius=rod.radius + std_px / np.sqrt(2))]
    depth = std_px / np.sqrt(2) / radius_px * float(np.linalg.norm(middle))
    along = sight - (sight @ rod.axis) * rod.axis
    return [
        *moved,
        replace(rod, point=rod.point - depth * sight),
        _turned(rod, middle, 2 * depth / length * along),
    ]


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
