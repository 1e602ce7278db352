"""The ray on which a pixel looks, through the lens as it is, or parallel to all others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.camera import Camera, Pose

Y_UP = np.array([1.0, -1.0, -1.0])
"""OpenCV's camera frame (x right, y down, z forward) ↔ x right, y up, z to the viewer."""
MM = 1000.0
_ROUNDS, _CLOSE_PX = 50, 1e-9


@dataclass(frozen=True, eq=False)
class Rays:
    """Lines of sight, away from the viewer: start and unit direction `[P, 3]`."""

    start: Floats
    direction: Floats


def rays_through(camera: Camera | None, x_px: Any, y_px: Any) -> Rays:
    """Rays through pixels `[P]` of a photograph as it was taken.

    Args:
        camera: its centre is 0 and lengths are in mm; None: every ray runs along −z and starts at
            (x, −y, 0) pixels.
    """
    x, y = np.asarray(x_px, np.float64), np.asarray(y_px, np.float64)
    if camera is None:
        start = np.stack([x, -y, np.zeros_like(x)], -1)
        return Rays(start, np.broadcast_to(np.array([0.0, 0.0, -1.0]), start.shape))
    straight = undistorted(camera, np.stack([x, y], -1))
    direction = np.stack([straight[:, 0], straight[:, 1], np.ones(len(x))], -1) * Y_UP
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(np.zeros_like(direction), direction)


def undistorted(camera: Camera, pixels: Floats) -> Floats:
    """Pixels `[P, 2]` → the plane z = 1 before an ideal lens, in OpenCV's camera frame."""
    import cv2

    if not len(pixels):
        return np.zeros((0, 2))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ROUNDS, _CLOSE_PX)
    found = cv2.undistortPoints(
        np.asarray(pixels, np.float64).reshape(-1, 1, 2),
        camera.matrix,
        camera.distortion,
        criteria=stop,
    )
    return np.asarray(found, np.float64).reshape(-1, 2)


def projected(camera: Camera | None, points: Floats) -> Floats:
    """Points `[P, 3]` → pixels `[P, 2]` of a photograph as it is taken."""
    import cv2

    if camera is None:
        return np.asarray(points[:, :2] * Y_UP[:2])
    zero = np.zeros(3)
    pixels, _ = cv2.projectPoints(points * Y_UP, zero, zero, camera.matrix, camera.distortion)
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def board_to_scene(pose: Pose, board_m: Any) -> Floats:
    """Points of the board `[…, 3]` in metres → the camera's frame in mm, y up."""
    p = np.asarray(board_m, np.float64) @ pose.rotation.T + pose.translation_m
    return np.asarray(MM * p * Y_UP)


def scene_to_board(pose: Pose, scene_mm: Any) -> Floats:
    """Points `[…, 3]` of the camera's frame → the board's, mm."""
    p = np.asarray(scene_mm, np.float64) * Y_UP - MM * pose.translation_m
    return np.asarray(p @ pose.rotation)


def carried(vector: Floats, before: Pose, after: Pose, *, point: bool = True) -> Floats:
    """What is fixed to the board, points `[…, 3]` in mm or directions: from the camera's frame at
    one pose of the board to that at another."""
    if point:
        return board_to_scene(after, scene_to_board(before, vector) / MM)
    return board_direction(after, (vector * Y_UP) @ before.rotation)


def board_direction(pose: Pose, direction: Any) -> Floats:
    """A direction in the board's frame → the camera's, y up."""
    return np.asarray((np.asarray(direction, np.float64) @ pose.rotation.T) * Y_UP)
