"""Photographs of a board → the camera, the board's poses: what `raden capture calibrate` does."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.board import Board, BoardView, draw_board, find_board
from raden_torch.capture.photo.board_not_found import BoardNotFound
from raden_torch.capture.photo.board_pose import board_pose
from raden_torch.capture.photo.calibration import calibrate
from raden_torch.capture.photo.camera import Calibration, Pose, read_camera, write_camera
from raden_torch.capture.photo.checking_picture import (
    captioned,
    picture_path,
    side_by_side,
    small,
)
from raden_torch.capture.photo.photograph import read_turned
from raden_torch.capture.photo.result_file import check_result_path
from raden_torch.errors import InputError
from raden_torch.images.pixels import turned_to, write_pixels

PathLike = str | os.PathLike[str]


def capture_camera(
    paths: Sequence[PathLike],
    board: Board,
    output: PathLike,
    *,
    camera: PathLike | None = None,
    picture: PathLike | None = None,
) -> str:
    """Find the board in photographs, calibrate the camera or take a known one, write both.

    Photographs without a board are named in a warning and left out. Those whose EXIF says another
    orientation than the first's (or the known camera's) are read as one sensor has them.

    Args:
        camera: a camera file: only the board's poses are looked for then.
        picture: PNG of what was found; beside `output` unless given.

    Returns:
        A few lines for a person.

    Raises:
        InputError: too few photographs with a board, and whatever the steps raise.
    """
    check_result_path(output)
    sheet_path = picture_path(picture, output)
    known = None if camera is None else read_camera(camera)
    least = 3 if known is None else 1
    way = None if known is None else known.orientation
    views, frames, way, others = _views(paths, board, enough=least, orientation=way)
    calibration: Calibration | None = None
    poses: Sequence[Pose]
    if known is None:
        calibration = calibrate(views)
        known, poses = calibration.camera, calibration.poses
    else:
        poses = [board_pose(view, known) for view in views]
    if others:
        way = way or 1
        poses = [replace(pose, orientation=way) for pose in poses]
    known = replace(known, orientation=way)
    frames = [
        captioned(frame, f"{Path(view.name).name}: {pose.corners} corners, {pose.rms_px:.2f} px")
        for frame, view, pose in zip(frames, views, poses, strict=True)
    ]
    write_camera(output, known, views, poses, calibration=calibration, made_from=paths)
    write_pixels(side_by_side(frames), sheet_path)
    lines = [
        f"{Path(view.name).name}: {pose.corners} corners, re-projection rms {pose.rms_px:.3f} px, "
        f"board at {np.linalg.norm(pose.translation_m):.3f} m"
        for view, pose in zip(views, poses, strict=True)
    ]
    if others:
        lines.append(
            f"{others[0]}: EXIF says another orientation ({len(others)} photographs); all are read "
            f"as one sensor has them, turned by orientation {way}"
        )
    if calibration is not None:
        focal = np.diag(known.matrix)[:2]
        lines += [
            f"camera: focal lengths {focal[0]:.1f} ± {calibration.focal_std_px[0]:.1f} and "
            f"{focal[1]:.1f} ± {calibration.focal_std_px[1]:.1f} px, "
            f"re-projection rms {calibration.rms_px:.3f} px",
            *(f"note: {note}" for note in calibration.notes),
        ]
    return "\n".join([*lines, f"wrote {output}", f"wrote {sheet_path}"])


def _views(
    paths: Sequence[PathLike], board: Board, *, enough: int, orientation: int | None
) -> tuple[list[BoardView], list[NDArray[np.uint8]], int | None, list[str]]:
    """The boards found, and a small picture of each; what is missing is warned of.

    Args:
        orientation: EXIF's, by which all are turned; None, or where the first one says none: the
            first one's.

    Returns:
        Beside these the orientation (None where the first one says none), and the names of
        files that say another.
    """
    views: list[BoardView] = []
    frames: list[NDArray[np.uint8]] = []
    wrong: list[InputError] = []
    others: list[str] = []
    for path in _progress(paths, "looking for the board"):
        picture, own = read_turned(path)
        if path == paths[0] and (orientation is None or own is None):
            orientation = own
        picture = turned_to(picture, own or 1, orientation or 1)
        if (own or 1) != (orientation or 1):
            others.append(Path(path).name)
        try:
            view = find_board(picture, board, str(path))
        except InputError as error:
            wrong.append(error)
            continue
        if view.board.legacy is not None:
            board = view.board  # one board in all
        views.append(view)
        frames.append(small(draw_board(picture, view)))
    if len(views) < enough:
        raise InputError(
            f"photographs that show the board: expected at least {enough}, got {len(views)} of "
            f"{len(paths)}. {wrong[0] if wrong else ''}".strip()
        )
    for each in wrong:
        message = each.beside_others if isinstance(each, BoardNotFound) else str(each)
        warnings.warn(f"left out: {message}", stacklevel=3)
    return views, frames, orientation, others


def _progress(paths: Sequence[PathLike], what: str) -> Iterable[PathLike]:
    from rich.console import Console
    from rich.progress import track

    return track(paths, what, console=Console(stderr=True), transient=True)
