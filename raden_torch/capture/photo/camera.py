"""A camera, the board's poses before it, how well it is known, and the file that holds them.

Frames, as OpenCV has them. Camera: x right, y down, z forward, origin in the lens's centre of
projection. Board: x along its rows, y down its columns, z into it, origin at its upper left corner.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board import Board, BoardView
from raden_torch.capture.photo.opencv_calibration import is_opencv_file, read_opencv_camera
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.errors import InputError
from raden_torch.schema import Count, Finite, Matrix, NotNegative, Orientation, Triple

KIND = "camera"
_Six = tuple[Finite, Finite, Finite, Finite, Finite, Finite]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole with Brown–Conrady distortion, in OpenCV's order of coefficients.

    Attributes:
        matrix: `[3, 3]` pixels.
        distortion: `[5]` k1, k2, p1, p2, k3 (or as many as the file has).
        size: height and width of its photographs.
        orientation: EXIF's, 1…8, by which they were turned; None where nobody says.
    """

    matrix: Floats
    distortion: Floats
    size: tuple[int, int]
    orientation: int | None = None

    @property
    def fov_deg(self) -> float:
        """Horizontal angle of view, without distortion."""
        return float(np.rad2deg(2 * np.arctan(self.size[1] / (2 * self.matrix[0, 0]))))


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a board lies: p_camera = rotation @ p_board + translation_m.

    Attributes:
        rotation: `[3, 3]`.
        translation_m: `[3]`.
        rms_px: re-projection error, √(mean of the squared distances).
        corners: that the pose was fitted to.
        covariance: `[6, 6]` of a small turn of the board about the camera's axes (radians) and of
            `translation_m`; None where nothing is known.
        orientation: EXIF's, 1…8, by which the photograph is to be turned for it; None: as its own
            file says.
    """

    rotation: Floats
    translation_m: Floats
    rms_px: float
    corners: int
    covariance: Floats | None = None
    orientation: int | None = None

    def moved(self, by: Floats) -> Pose:
        """With the board turned about the camera's axes, by small angles in radians, and shifted:
        `[6]` as for `covariance`."""
        import cv2

        turn = cv2.Rodrigues(np.asarray(by[:3], np.float64))[0]
        return replace(
            self, rotation=turn @ self.rotation, translation_m=self.translation_m + by[3:]
        )

    def errors(self) -> list[Floats]:
        """`[6]` each: one standard deviation of each of six independent errors that `moved` takes;
        none where nothing is known."""
        if self.covariance is None:
            return []
        variance, axes = np.linalg.eigh(self.covariance)
        return list((axes * np.sqrt(variance.clip(min=0))).T)


def check_camera_size(
    path: str | os.PathLike[str] | None, of_camera: tuple[int, int], size: tuple[int, int]
) -> None:
    """Raise InputError where photographs have another size than those of the camera of `path`."""
    if of_camera != size:
        (h, w), (height, width) = of_camera, size
        raise InputError(
            f"{path}: expected the camera that took the photographs, at their size of {width} x "
            f"{height} pixels, got one of {w} x {h}"
        )


class PoseEntry(Struct):
    """One photograph of a camera file."""

    file: str
    corners: Count
    reprojection_rms_px: NotNegative
    rotation_board_to_camera: Matrix
    translation_board_to_camera_m: Triple
    turn_and_translation_covariance: tuple[_Six, _Six, _Six, _Six, _Six, _Six] | None = None
    orientation: Orientation | None = None


class CameraFile(Struct):
    """A camera file; `board` and `poses` are not in every one."""

    camera_matrix_px: Matrix
    distortion: tuple[Finite, ...]
    image_width_px: Count
    image_height_px: Count
    orientation: Orientation | None = None
    board: Board | None = None
    poses: tuple[PoseEntry, ...] | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera and how well it is known.

    Attributes:
        rms_px: re-projection error over all corners.
        focal_std_px: `[2]` standard deviations of the focal lengths.
        poses: one for each view, in order.
        notes: what the person should know.
    """

    camera: Camera
    rms_px: float
    focal_std_px: Floats
    poses: tuple[Pose, ...]
    notes: tuple[str, ...]


def read_camera(path: str | os.PathLike[str]) -> Camera:
    """Read what `raden capture calibrate` wrote, or an OpenCV calibration file (.yml, .xml).

    Raises:
        InputError: not such a file, or numbers that are no camera's.
    """
    if is_opencv_file(Path(path)):
        camera = Camera(*read_opencv_camera(path))
    else:
        found = read_result(path, KIND, CameraFile)
        camera = Camera(
            np.array(found.camera_matrix_px),
            np.array(found.distortion),
            (found.image_height_px, found.image_width_px),
            found.orientation,
        )
    focal = np.diag(camera.matrix)[:2]
    if not ((focal > 0).all() and min(camera.size) > 0 and camera.matrix[2, 2] == 1):
        raise InputError(
            f"{path}: expected a camera matrix with focal lengths above 0 and a size, got none"
        )
    if len(camera.distortion) not in (4, 5, 8, 12, 14):
        raise InputError(
            f"{path}: expected 5 distortion coefficients, got {len(camera.distortion)}"
        )
    return camera


def write_camera(
    path: str | os.PathLike[str],
    camera: Camera,
    views: Sequence[BoardView],
    poses: Sequence[Pose],
    *,
    calibration: Calibration | None,
    made_from: Collection[str | os.PathLike[str]],
) -> None:
    """Write a camera and the board's poses for the next step (`read_camera`) and for a person.

    Args:
        calibration: None where the camera was given and only the poses were found.
    """
    board = views[0].board
    content: dict[str, Any] = {
        "camera_matrix_px": camera.matrix,
        "distortion": camera.distortion,
        "image_width_px": camera.size[1],
        "image_height_px": camera.size[0],
        "horizontal_field_of_view_deg": round(camera.fov_deg, 3),
    }
    if camera.orientation is not None:
        content["orientation"] = camera.orientation
    if calibration is not None:
        content["reprojection_rms_px"] = calibration.rms_px
        content["focal_std_px"] = calibration.focal_std_px
        content["notes"] = list(calibration.notes)
    content["board"] = {
        "columns": board.columns,
        "rows": board.rows,
        "square_m": board.square_m,
        "marker_m": board.marker_m,
        "dictionary": board.dictionary,
        "legacy": board.legacy,
    }
    content["poses"] = [
        {
            "file": Path(view.name).name,
            "corners": pose.corners,
            "reprojection_rms_px": pose.rms_px,
            "rotation_board_to_camera": pose.rotation,
            "translation_board_to_camera_m": pose.translation_m,
            **(
                {}
                if pose.covariance is None
                else {"turn_and_translation_covariance": pose.covariance}
            ),
            **({} if pose.orientation is None else {"orientation": pose.orientation}),
        }
        for view, pose in zip(views, poses, strict=True)
    ]
    write_result(path, KIND, content, made_from=made_from)


def read_poses(path: str | os.PathLike[str]) -> tuple[Board, dict[str, Pose]]:
    """The board of a camera file and its pose in each photograph, by file name.

    Raises:
        InputError: not such a file, or damaged.
    """
    found = read_result(path, KIND, CameraFile)
    if found.board is None or found.poses is None:
        raise InputError(f"{path}: expected a board and its poses, got a camera file without")
    return found.board, {
        pose.file: Pose(
            np.array(pose.rotation_board_to_camera),
            np.array(pose.translation_board_to_camera_m),
            pose.reprojection_rms_px,
            pose.corners,
            covariance=None
            if pose.turn_and_translation_covariance is None
            else np.array(pose.turn_and_translation_covariance),
            orientation=pose.orientation,
        )
        for pose in found.poses
    }
