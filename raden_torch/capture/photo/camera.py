"""The camera, calibrated on photographs of a board, and where the board lies before it.

Frames, as OpenCV has them. Camera: x right, y down, z forward, origin in the lens's centre of
projection. Board: x along its rows, y down its columns, z into it, origin at its upper left corner.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board import FEWEST_CORNERS, Board, BoardView
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.errors import InputError
from raden_torch.schema import Count, Finite, Matrix, NotNegative, Triple

KIND = "camera"
_MAX_OPENCV_BYTES = 10_000_000
_MOST_COEFFICIENTS = 100
_FEWEST_VIEWS = 3
_GOOD_RMS_PX = 1.0
_UNCERTAIN_FOCAL = 0.02
_STRAY_PX = 1.0
_SIGNIFICANT = 2.0


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole with Brown–Conrady distortion, in OpenCV's order of coefficients.

    Attributes:
        matrix: `[3, 3]` pixels.
        distortion: `[5]` k1, k2, p1, p2, k3 (or as many as the file has).
        size: height and width of its photographs.
    """

    matrix: Floats
    distortion: Floats
    size: tuple[int, int]

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
    """

    rotation: Floats
    translation_m: Floats
    rms_px: float
    corners: int

    @property
    def camera_in_board_m(self) -> Floats:
        """`[3]` the camera's centre in the board's frame; its z is negative."""
        return -self.rotation.T @ self.translation_m


class PoseEntry(Struct):
    """One photograph of a camera file."""

    file: str
    corners: Count
    reprojection_rms_px: NotNegative
    rotation_board_to_camera: Matrix
    translation_board_to_camera_m: Triple


class CameraFile(Struct):
    """A camera file; `board` and `poses` are not in every one."""

    camera_matrix_px: Matrix
    distortion: tuple[Finite, ...]
    image_width_px: Count
    image_height_px: Count
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
        _pose(view, camera, turn, shift)
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

    turn, _ = cv2.Rodrigues(pose.rotation)
    pixels, _ = cv2.projectPoints(
        view.points_m, turn, pose.translation_m, camera.matrix, camera.distortion
    )
    # [n, 1, 2] in some versions of OpenCV: subtracting [n, 2] from it would broadcast to [n, n, 2]
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def read_camera(path: str | os.PathLike[str]) -> Camera:
    """Read what `raden capture calibrate` wrote, or an OpenCV calibration file (.yml, .xml).

    Raises:
        InputError: not such a file, or numbers that are no camera's.
    """
    if _is_opencv(Path(path)):
        camera = _opencv_camera(path)
    else:
        found = read_result(path, KIND, CameraFile)
        camera = Camera(
            np.array(found.camera_matrix_px),
            np.array(found.distortion),
            (found.image_height_px, found.image_width_px),
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
        )
        for pose in found.poses
    }


def _is_opencv(path: Path) -> bool:
    """By its name, or by how YAML and XML begin."""
    if path.suffix.lower() in (".yml", ".yaml", ".xml"):
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(5) in (b"%YAML", b"<?xml")


def _opencv_camera(path: str | os.PathLike[str]) -> Camera:
    import cv2

    if not Path(path).is_file():
        raise InputError(f"{path}: expected a camera file, got no such file")
    text = _opencv_text(Path(path))
    try:
        file = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError):
        raise InputError(f"{path}: expected an OpenCV calibration, got another file") from None
    try:
        matrix, distortion = (
            _matrix(file.getNode(name)) for name in ("camera_matrix", "distortion_coefficients")
        )
        width, height = (file.getNode(f"image_{side}").real() for side in ("width", "height"))
    except cv2.error:
        raise InputError(
            f"{path}: expected a whole OpenCV calibration, got a damaged one"
        ) from None
    finally:
        file.release()
    if (
        matrix is None
        or matrix.shape != (3, 3)
        or distortion is None
        or not np.isfinite([width, height]).all()
    ):
        raise InputError(
            f"{path}: expected an OpenCV calibration, got no whole camera_matrix and "
            "distortion_coefficients"
        )
    return Camera(
        matrix,
        np.ravel(distortion),
        (int(height), int(width)),
    )


def _matrix(node: Any) -> Floats | None:
    """The array of a matrix in an OpenCV file (`rows` and `cols`, or `sizes`); None where it is not
    whole. OpenCV's own reader writes beyond its buffers where these are not what `data` has."""
    if node.empty() or not node.isMap():
        return None
    data, sizes = node.getNode("data"), node.getNode("sizes")
    if sizes.isSeq():
        lengths = _numbers(sizes)
    else:
        lengths = [_number(node.getNode(name)) for name in ("rows", "cols")]
    if not data.isSeq() or not 0 < data.size() <= _MOST_COEFFICIENTS:
        return None
    values = np.array(_numbers(data))
    shape = [int(n) for n in lengths if 1 <= n <= len(values)]
    if len(shape) != len(lengths) or math.prod(shape) != len(values):
        return None
    return values.reshape(shape) if np.isfinite(values).all() else None


def _numbers(node: Any) -> list[float]:
    return [_number(node.at(i)) for i in range(min(node.size(), _MOST_COEFFICIENTS))]


def _number(node: Any) -> float:
    """NaN for what is none."""
    return float(node.real()) if node.isReal() or node.isInt() else float("nan")


def _opencv_text(path: Path) -> str:
    """The file's text, without what makes OpenCV's parser write beyond its buffers."""
    if path.stat().st_size > _MAX_OPENCV_BYTES:
        raise InputError(f"{path}: expected a calibration of at most {_MAX_OPENCV_BYTES} bytes")
    text = path.read_bytes().decode("utf-8", "replace")
    if "\0" in text or re.search(r"[\d.]{100}", text):
        raise InputError(f"{path}: expected an OpenCV calibration, got another file")
    return text


def _solved(view: BoardView, camera: Camera) -> Pose:
    import cv2

    points, pixels = view.points_m, view.pixels
    lens = camera.matrix, camera.distortion
    found, turn, shift = cv2.solvePnP(points, pixels, *lens, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        raise InputError(f"{view.name}: no pose fits its {len(view.ids)} corners")
    turn, shift = cv2.solvePnPRefineLM(points, pixels, *lens, turn, shift)
    return _pose(view, camera, turn, shift)


def _pose(view: BoardView, camera: Camera, turn: NDArray[Any], shift: NDArray[Any]) -> Pose:
    import cv2

    rotation, _ = cv2.Rodrigues(turn)
    place = np.asarray(rotation, np.float64), np.ravel(shift).astype(np.float64)
    pose = Pose(*place, 0.0, len(view.ids))
    off = reprojected(view, camera, pose) - view.pixels
    rms = float(np.sqrt((off**2).sum(axis=1).mean()))
    return Pose(*place, rms, len(view.ids))


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
    if covered < 0.4:
        notes.append(
            f"the boards cover {100 * covered:.0f} % of the frame; distortion outside is a guess"
        )
    return tuple(notes)
