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
_BENT = 0.02
"""Of a piece's size: corners farther from their plane are of no flat piece."""
_PER_EDGE = 32
"""Points that each edge is drawn with: a lens bends it."""


def board_pixels(
    corners_m: Floats, camera: Camera | None, pose: Pose | None, size: tuple[int, int], name: str
) -> Bools:
    """`[H, W]`: the pixels inside corners on the board: `[n, 2]`, or `[n, 3]` with their heights
    over it.

    Raises:
        InputError: no camera or pose; a place behind the camera.
    """
    if camera is None or pose is None:
        raise InputError(
            f"{name}: a place on the board needs a camera file with the board's pose in this "
            "photograph"
        )
    corners = _in_board(corners_m)
    edges = zip(corners, np.roll(corners, -1, 0), strict=True)
    outline = np.concatenate([np.linspace(a, b, _PER_EDGE, endpoint=False) for a, b in edges])
    scene = board_to_scene(pose, outline)
    pixels = projected(camera, scene)
    if not (scene[:, 2] < 0).all() or abs(pixels).max() > 1e6:
        raise InputError(f"{name}: the place on the board lies behind the camera")
    return polygon_pixels(pixels, size)


def board_plane(corners_m: Floats, pose: Pose) -> Plane:
    """The flat piece inside corners `[n, 2]` on the board, or `[n, 3]` with their heights over it,
    as the camera sees it.

    Raises:
        InputError: corners that are not in one plane.
    """
    corners = _in_board(corners_m)
    off = corners - corners.mean(axis=0)
    size, axes = np.linalg.svd(off, full_matrices=False)[1:]
    bent = float(abs(off @ axes[2]).max()) if len(corners) > 2 else 0.0
    if bent > _BENT * size[0]:
        raise InputError(
            f"region: expected corners in one plane, got some {1000 * bent:.1f} mm off it; a bent "
            "card is a cylinder"
        )
    normal = axes[2] if corners_m.shape[1] == 3 else _TOWARDS
    normal = normal if normal @ _TOWARDS > 0 else -normal
    return Plane(board_to_scene(pose, corners), board_direction(pose, normal))


def _in_board(corners_m: Floats) -> Floats:
    """`[n, 3]` in its frame, whose z goes into it."""
    heights = corners_m[:, 2:] if corners_m.shape[1] == 3 else np.zeros((len(corners_m), 1))
    return np.concatenate([corners_m[:, :2], -heights], axis=1)


def whole_board(pose: Pose) -> Plane:
    """The board's plane, where its edges do not matter."""
    return board_plane(np.array([[0.0, 0.0], [1, 0], [1, 1]]), pose)
