"""OpenCV's calibration files (.yml, .xml), checked before its parser sees them."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.errors import InputError

_MAX_OPENCV_BYTES = 10_000_000
_MOST_COEFFICIENTS = 100


def is_opencv_file(path: Path) -> bool:
    """By its name, or by how YAML and XML begin."""
    if path.suffix.lower() in (".yml", ".yaml", ".xml"):
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(5) in (b"%YAML", b"<?xml")


def read_opencv_camera(
    path: str | os.PathLike[str],
) -> tuple[Floats, Floats, tuple[int, int]]:
    """The camera's matrix `[3, 3]`, its distortion `[n]`, and the photographs' height and width.

    Raises:
        InputError: not such a file, or a damaged one.
    """
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
    return matrix, np.ravel(distortion), (int(height), int(width))


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
