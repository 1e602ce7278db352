"""Views of a board → the camera that took them, and how well it is known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board import BoardView
from raden_torch.capture.photo.board_pose import pose_of
from raden_torch.capture.photo.camera import Calibration, Camera, Pose
from raden_torch.errors import InputError

_FEWEST_VIEWS = 3
_GOOD_RMS_PX = 1.0
_UNCERTAIN_FOCAL = 0.02
"""Relative standard deviation of the focal length from which a note says what would help."""
_LEAST_COVERED = 0.4
"""Share of the frame."""
_SIGNIFICANT = 2.0
"""Standard deviations below which a distortion term is left at 0."""


def calibrate(views: Sequence[BoardView]) -> Calibration:
    """Calibrate a camera on three or more views of a board from different directions.

    Zhang's method through OpenCV, with k1, k2, p1, p2; k3 stays 0, as it mostly fits noise. So do
    k2, and p1 and p2, where they are less than twice their standard deviation: behind a long lens
    they bend the picture's corners by pixels to gain a thousandth of a pixel on the boards.

    Raises:
        InputError: too few views, or of different sizes.
    """
    import cv2

    if len(views) < _FEWEST_VIEWS:
        raise InputError(
            f"calibration: expected at least {_FEWEST_VIEWS} photographs with a board from "
            f"different directions, better ten, got {len(views)}"
        )
    size = _one_size(views)
    points = [view.points_m.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]

    def fitted(flags: int) -> Any:
        return cv2.calibrateCameraExtended(points, pixels, size[::-1], None, None, flags=flags)

    found = fitted(cv2.CALIB_FIX_K3)
    needless = _needless_terms(np.ravel(found[2]), np.ravel(found[5])[4:])
    if needless:
        found = fitted(cv2.CALIB_FIX_K3 | needless)
    rms, matrix, distortion, turns, shifts, spread, _, _ = found
    camera = Camera(np.asarray(matrix), np.ravel(distortion)[:5], size)
    poses = tuple(
        pose_of(view, camera, turn, shift)
        for view, turn, shift in zip(views, turns, shifts, strict=True)
    )
    focal_std = np.ravel(spread)[:2].astype(np.float64)
    return Calibration(
        camera, float(rms), focal_std, poses, _notes(views, poses, camera, focal_std)
    )


def _needless_terms(distortion: Floats, std: Floats) -> int:
    """OpenCV's flags for the terms that cannot be told from 0."""
    import cv2

    weak = np.abs(distortion[:4]) < _SIGNIFICANT * std[:4]
    flags = cv2.CALIB_FIX_K2 if weak[1] else 0
    return int(flags | (cv2.CALIB_ZERO_TANGENT_DIST if weak[2:].all() else 0))


def _one_size(views: Sequence[BoardView]) -> tuple[int, int]:
    for view in views[1:]:
        if view.size != views[0].size:
            (h, w), (height, width) = views[0].size, view.size
            raise InputError(
                f"{view.name}: expected photographs of one size from one camera, got {width} x "
                f"{height} pixels, but {views[0].name} has {w} x {h}"
            )
    return views[0].size


def _notes(
    views: Sequence[BoardView], poses: Sequence[Pose], camera: Camera, focal_std: Floats
) -> tuple[str, ...]:
    notes = []
    share = float((focal_std / np.diag(camera.matrix)[:2]).max())
    if share > _UNCERTAIN_FOCAL:
        notes.append(
            f"the focal length is known to {100 * share:.0f} % only; add views with the board "
            "tilted by 30 to 45 degrees, filling the frame"
        )
    typical = float(np.median([pose.rms_px for pose in poses]))
    for view, pose in zip(views, poses, strict=True):
        if pose.rms_px > max(3 * typical, _GOOD_RMS_PX):
            notes.append(
                f"{Path(view.name).name}: re-projection rms {pose.rms_px:.2f} px against "
                f"{typical:.2f} px in the others; blurred or bent? Leave it out"
            )
    seen = np.concatenate([view.pixels for view in views])
    low, high = seen.min(axis=0), seen.max(axis=0)
    covered = float(np.prod((high - low) / np.array(camera.size[::-1])))
    if covered < _LEAST_COVERED:
        notes.append(
            f"the boards cover {100 * covered:.0f} % of the frame; distortion outside is a guess"
        )
    return tuple(notes)
