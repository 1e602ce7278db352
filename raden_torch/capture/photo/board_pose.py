"""Where a board lies before a calibrated camera, in one photograph."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board import BoardView
from raden_torch.capture.photo.board_not_found import FEWEST_CORNERS
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.errors import InputError

_STRAY_PX = 1.0
"""A corner so far off, and three times the median, is left out."""
_TURN = 1e-4
"""Radians by which a pose is turned, and over its distance shifted, to see what that does."""


def board_pose(view: BoardView, camera: Camera) -> Pose:
    """Where the board lies in one photograph of a calibrated camera.

    A corner that lies more than a pixel off, and three times the median, is left out, once: it sits
    on the edge of something that covers the board.

    Raises:
        InputError: the photograph has another size than the camera's.
    """
    if view.size != camera.size:
        (height, width), (h, w) = view.size, camera.size
        raise InputError(
            f"{view.name}: expected {w} x {h} pixels, the size at which the camera was "
            f"calibrated, got {width} x {height}; do not resize or crop photographs"
        )
    pose = _solved(view, camera)
    off = np.linalg.norm(reprojected(view, camera, pose) - view.pixels, axis=1)
    near = off <= max(_STRAY_PX, 3 * float(np.median(off)))
    if near.all() or near.sum() < FEWEST_CORNERS:
        return pose
    return _solved(replace(view, ids=view.ids[near], pixels=view.pixels[near]), camera)


def reprojected(view: BoardView, camera: Camera, pose: Pose) -> Floats:
    """`[n, 2]` pixels at which the view's corners should be."""
    import cv2

    return corner_pixels(view, camera, cv2.Rodrigues(pose.rotation)[0], pose.translation_m)


def corner_pixels(view: BoardView, camera: Camera, turn: Any, shift: Any) -> Floats:
    """The same of OpenCV's rotation vector and shift."""
    import cv2

    pixels, _ = cv2.projectPoints(view.points_m, turn, shift, camera.matrix, camera.distortion)
    # [n, 1, 2] in some versions of OpenCV: subtracting [n, 2] from it would broadcast to [n, n, 2]
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def pose_of(view: BoardView, camera: Camera, turn: NDArray[Any], shift: NDArray[Any]) -> Pose:
    """The pose of OpenCV's rotation vector and shift, and how well it fits the view."""
    import cv2

    rotation, _ = cv2.Rodrigues(turn)
    pose = Pose(
        np.asarray(rotation, np.float64), np.ravel(shift).astype(np.float64), 0.0, len(view.ids)
    )
    off = reprojected(view, camera, pose) - view.pixels
    rms = float(np.sqrt((off**2).sum(axis=1).mean()))
    return replace(pose, rms_px=rms, covariance=_covariance(view, camera, pose, off))


def _covariance(view: BoardView, camera: Camera, pose: Pose, off: Floats) -> Floats:
    """`[6, 6]`, if each corner is off by itself and by as much as the others (least squares)."""
    steps = np.repeat([_TURN, _TURN * float(np.linalg.norm(pose.translation_m))], 3)
    slopes = np.stack(
        [
            np.ravel(
                reprojected(view, camera, pose.moved(step))
                - reprojected(view, camera, pose.moved(-step))
            )
            for step in np.diag(steps)
        ],
        axis=1,
    )  # of two steps
    freedom = max(off.size - len(steps), 1)
    inverse = np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    return np.asarray((off**2).sum() / freedom * inverse * 4 * np.outer(steps, steps))


def _solved(view: BoardView, camera: Camera) -> Pose:
    import cv2

    points, pixels = view.points_m, view.pixels
    lens = camera.matrix, camera.distortion
    found, turn, shift = cv2.solvePnP(points, pixels, *lens, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        raise InputError(f"{view.name}: no pose fits its {len(view.ids)} corners")
    turn, shift = cv2.solvePnPRefineLM(points, pixels, *lens, turn, shift)
    return pose_of(view, camera, turn, shift)
