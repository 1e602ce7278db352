"""The picture of what a step found: where it goes, its caption, many in one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import check_writable
from raden_torch.images.pixels import draw_caption

PathLike = str | os.PathLike[str]
_SHEET_PX = 640


def picture_path(picture: PathLike | None, output: PathLike) -> Path:
    """The path given, or that of the result with .png; raises InputError where none can be."""
    path = Path(output).with_suffix(".png") if picture is None else Path(picture)
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(
            f"{path}: expected a file name that ends in .png or .jpg, got "
            f"{Path(path).suffix or '(none)'}"
        )
    return check_writable(path)


def small(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """At most 640 pixels wide and high."""
    import cv2

    scale = _SHEET_PX / max(picture.shape[:2])
    if scale >= 1:
        return picture
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def captioned(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """With a line of text below it."""
    strip = np.zeros((20, picture.shape[1], 3), np.uint8)
    draw_caption(strip, text.encode("ascii", "replace").decode())
    return np.concatenate([picture, strip])


def side_by_side(frames: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures side by side, in rows."""
    columns = int(np.ceil(np.sqrt(len(frames))))
    height, width = (max(frame.shape[i] for frame in frames) for i in (0, 1))
    rows = -(-len(frames) // columns)
    sheet = np.full((rows * height, columns * width, 3), 40, np.uint8)
    for i, frame in enumerate(frames):
        y, x = (i // columns) * height, (i % columns) * width
        sheet[y : y + frame.shape[0], x : x + frame.shape[1]] = frame
    return sheet
