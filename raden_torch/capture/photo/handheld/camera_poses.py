"""The camera of the sharp pictures, and where the board lies in each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raden_torch.capture.photo.board import BoardView
from raden_torch.capture.photo.board_pose import board_pose
from raden_torch.capture.photo.calibration import calibrate
from raden_torch.capture.photo.camera import Calibration, Camera, Pose
from raden_torch.capture.photo.handheld.card_checks import (
    MOST_RMS_PX,
    bent,
    heights_m,
    zoom_of,
    zoomed,
)
from raden_torch.capture.photo.handheld.handheld_setup import FEWEST, HandheldSetup
from raden_torch.capture.photo.handheld.judging import Judged, reasons
from raden_torch.errors import InputError

_CALIBRATED_ON = 40
_TWICE, _MORE_PX = 2.0, 0.2
"""A camera file's corners lie farther off than this many times, and pixels, those of a camera that
is calibrated on the pictures themselves: it is another."""


def camera_and_poses(
    looked: list[Judged], setup: HandheldSetup, known: Camera | None
) -> tuple[Camera, Calibration | None, list[Judged], dict[int, Pose]]:
    """The camera; the pictures again, some of them refused; and the poses of the others.

    Args:
        known: what the setup's camera file holds; None: calibrated on the pictures.
    """
    sharp = [k for k, each in enumerate(looked) if each.view is not None and not each.refused]
    if len(sharp) < FEWEST:
        raise InputError(too_few(looked, len(sharp)))
    best = sorted(sharp, key=lambda k: -len(_view(looked[k]).ids))
    some = [_view(looked[k]) for k in best[:: max(1, len(best) // _CALIBRATED_ON)]]
    calibration = calibrate(some[:_CALIBRATED_ON])
    camera = calibration.camera if known is None else known
    poses = {k: board_pose(_view(looked[k]), camera) for k in sharp}
    rms = float(np.median([pose.rms_px for pose in poses.values()]))
    own = float(np.median([pose.rms_px for pose in calibration.poses]))
    if known is not None and rms > max(_TWICE * own, own + _MORE_PX):
        raise InputError(
            f"{setup.camera}: expected the camera that took these pictures, got one by which the "
            f"board's corners lie {rms:.1f} px off ({own:.1f} px by the pictures themselves): "
            "another lens, zoom or focus; leave it out"
        )
    looked = list(looked)
    for k, pose in list(poses.items()):
        why = zoomed(*zoom_of(_view(looked[k]), camera, pose))
        if pose.rms_px > max(MOST_RMS_PX, 4 * rms):
            why = why or f"its corners lie off the board's pose: by {pose.rms_px:.1f} px"
        if why is not None:
            looked[k] = looked[k].because(why)
            del poses[k]
    views = [_view(looked[k]) for k in poses]
    wrong = bent(heights_m(views, camera, list(poses.values())), setup.board.square_m)
    if wrong is not None:
        raise InputError(f"{looked[0].name} …: {wrong}")
    return camera, calibration if known is None else None, looked, poses


def too_few(looked: Sequence[Judged], count: int) -> str:
    most = reasons(looked)[:3]
    said = "; ".join(f"{number} of {len(looked)}: {reason}" for reason, number in most)
    return (
        f"{looked[0].name} …: expected {FEWEST} pictures or more that are sharp and show board "
        f"and white, got {count}" + (f" ({said})" if said else "")
    )


def _view(each: Judged) -> BoardView:
    assert each.view is not None
    return each.view
