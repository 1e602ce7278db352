"""Is the card flat, and the lens as it was calibrated, in every picture?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board import BoardView
from raden_torch.capture.photo.board_pose import corner_pixels, reprojected
from raden_torch.capture.photo.camera import Camera, Pose

MOST_RMS_PX = 1.5
"""Re-projection error beyond which a picture's pose is not believed."""
_BENT_M, _BENT_SQUARES = 5e-4, 0.03
_OF_CORNERS = 0.9
"""So many lie nearer: a few beside something that lies on the card do not make it bent."""
_FEWEST_SIGHTS = 5
_ZOOMED, _SURE = 0.02, 5.0
_LEANS_DEG = 20.0
"""A board that faces the camera more than this does not tell its distance from the zoom."""


def heights_m(views: Sequence[BoardView], camera: Camera, poses: Sequence[Pose]) -> Floats:
    """`[n]` how far each corner of the board lies off its plane, metres, into the board; NaN where
    it was seen too seldom. A tilt and a shift of the whole are in the poses, and left out here.

    Linear: a corner's residual in the pictures over what a height moves it by.
    """
    board = views[0].board
    count = len(board.corners_m)
    with_height, square, seen = np.zeros(count), np.zeros(count), np.zeros(count, int)
    step = board.square_m / 10
    for view, pose in zip(views, poses, strict=True):
        there = reprojected(view, camera, pose)
        shift = pose.translation_m + step * pose.rotation[:, 2]
        moved = (reprojected(view, camera, replace(pose, translation_m=shift)) - there) / step
        off = view.pixels - there
        with_height[view.ids] += (moved * off).sum(1)
        square[view.ids] += (moved**2).sum(1)
        seen[view.ids] += 1
    known = (seen >= _FEWEST_SIGHTS) & (square > 0)
    height = np.where(known, with_height / np.where(known, square, 1.0), np.nan)
    if known.sum() >= 4:
        plane = np.c_[board.corners_m[:, :2], np.ones(count)]
        fitted = np.linalg.lstsq(plane[known], height[known], rcond=None)[0]
        height = height - plane @ fitted
    return np.asarray(height)


def bent(heights: Floats, square_m: float) -> str | None:
    """What to say of a card that is not flat."""
    known = np.abs(heights[np.isfinite(heights)])
    most = float(np.quantile(known, _OF_CORNERS)) if len(known) else 0.0
    if most < max(_BENT_M, _BENT_SQUARES * square_m):
        return None
    return (
        f"the card is not flat: a tenth of its corners lie {1000 * most:.1f} mm or more off their "
        "plane; glue it on a stiff board"
    )


def zoom_of(view: BoardView, camera: Camera, pose: Pose) -> tuple[float, float]:
    """By what factor the focal length differs from the camera's in one picture, and the standard
    deviation of that; (1, ∞) where the board faces the camera too much to tell."""
    import cv2
    from scipy.optimize import least_squares

    if np.hypot(*pose.rotation[:2, 2]) < np.sin(np.radians(_LEANS_DEG)):
        return 1.0, np.inf
    scale = np.linalg.norm(pose.translation_m)

    def residual(p: Floats) -> Floats:
        matrix = camera.matrix.copy()
        matrix[:2, :2] *= 1 + p[6]
        zoomed = replace(camera, matrix=matrix)
        return np.ravel(corner_pixels(view, zoomed, p[:3], p[3:6] * scale) - view.pixels)

    start = np.r_[np.ravel(cv2.Rodrigues(pose.rotation)[0]), pose.translation_m / scale, 0.0]
    found = least_squares(residual, start, method="lm")
    freedom = max(len(found.fun) - 7, 1)
    # a corner is found to 0.1 px at best, whatever the residuals of few say
    variance = max(2 * found.cost / freedom, 0.1**2)
    covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)
    return 1 + float(found.x[6]), float(np.sqrt(max(covariance[6, 6], 0.0)))


def zoomed(factor: float, std: float) -> str | None:
    """What to say of a picture whose focal length is another."""
    if abs(factor - 1) < max(_ZOOMED, _SURE * std):
        return None
    return (
        f"the zoom or focus changed: its focal length is {100 * (factor - 1):+.1f} % of the others'"
    )
