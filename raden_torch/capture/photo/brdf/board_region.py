"""A place on the board, by its corners in metres → the pixels that show it, and its plane."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.brdf.pixel_regions import polygon_pixels
from raden_torch.capture.photo.brdf.rays import board_direction, board_to_scene, projected
from raden_torch.capture.photo.brdf.sample_shapes import Plane
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.errors import InputError

_TOWARDS = np.array([0.0, 0.0, -1.0])
"""Out of the board, in its own frame."""
_PER_EDGE = 32
"""Points that each edge is drawn with: a lens bends it."""


def board_pixels(
    corners_m: Floats, camera: Camera | None, pose: Pose | None, size: tuple[int, int], name: str
) -> Bools:
    """`[H, W]`: the pixels inside corners `[n, 2]` on the board.

    Raises:
        InputError: no camera or pose; a place behind the camera.
    """
    if camera is None or pose is None:
        raise InputError(
            f"{name}: a place on the board needs a camera file with the board's pose in this "
            "photograph"
        )
    edges = zip(corners_m, np.roll(corners_m, -1, 0), strict=True)
    outline = np.concatenate([np.linspace(a, b, _PER_EDGE, endpoint=False) for a, b in edges])
    scene = board_to_scene(pose, np.c_[outline, np.zeros(len(outline))])
    pixels = projected(camera, scene)
    if not (scene[:, 2] < 0).all() or abs(pixels).max() > 1e6:
        raise InputError(f"{name}: the place on the board lies behind the camera")
    return polygon_pixels(pixels, size)


def board_plane(corners_m: Floats, pose: Pose) -> Plane:
    """The part of the board inside corners `[n, 2]`, as the camera sees it."""
    corners = board_to_scene(pose, np.c_[corners_m, np.zeros(len(corners_m))])
    return Plane(corners, board_direction(pose, _TOWARDS))


def whole_board(pose: Pose) -> Plane:
    """The board's plane, where its edges do not matter."""
    return board_plane(np.array([[0.0, 0.0], [1, 0], [1, 1]]), pose)
