"""Stored pixels of an image file, through OpenCV: no curve undone, no scaling."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import written_beside

MAX_PIXELS = 500_000_000


def read_pixels(path: str | os.PathLike[str], *, colour: bool) -> NDArray[Any]:
    """The stored values of a PNG, JPEG, TIFF or Radiance HDR file, in the file's own type.

    Args:
        colour: `[H, W, 3]` RGB whatever the file holds, turned as its EXIF orientation says;
            else the file's channels as they are: grey `[H, W]`, RGB or RGBA `[H, W, C]`.

    Raises:
        InputError: missing, not an image, or more than `MAX_PIXELS` pixels.
    """
    import cv2

    _check_header(path)
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; an image was wanted") from None
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR if colour else cv2.IMREAD_UNCHANGED
    try:
        pixels = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise InputError(
            f"{path}: not an image that OpenCV reads; PNG, JPEG, TIFF or HDR was wanted"
        )
    _check_size(path, pixels.shape[1], pixels.shape[0])
    if pixels.ndim == 3:
        order = [2, 1, 0, 3][: pixels.shape[2]] if pixels.shape[2] > 2 else [0, 1]
        pixels = np.ascontiguousarray(pixels[..., order])
    return pixels


def write_pixels(rgb: NDArray[Any], path: str | os.PathLike[str]) -> None:
    """Write `[H, W, 3]` RGB or `[H, W]` grey pixels as they are, encoded by the path's suffix.

    Raises:
        InputError: OpenCV cannot encode them so, or the folder does not exist.
    """
    import cv2

    bgr = np.ascontiguousarray(rgb[..., ::-1]) if rgb.ndim == 3 else rgb
    try:
        ok, data = cv2.imencode(Path(path).suffix.lower(), bgr)
    except cv2.error:
        ok = False
    if not ok:
        raise InputError(f"{path}: OpenCV could not encode the picture")
    with written_beside(path) as temporary:
        temporary.write_bytes(data.tobytes())


def draw_caption(pixels: NDArray[Any], caption: str) -> None:
    """Draw a small line into the lower left corner of 8- or 16-bit pixels, in place.

    OpenCV draws on 8 bits; the strokes are laid over the pixels in their own depth.
    """
    import cv2

    top = np.iinfo(pixels.dtype).max
    height, width = pixels.shape[:2]
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    (text_width, _), _ = cv2.getTextSize(caption, font, scale, 1)
    scale *= min(1.0, (width - 8) / max(text_width, 1))
    for grey, thickness in ((0.0, 3), (190 / 255, 1)):
        stroke = np.zeros((height, width), np.uint8)
        cv2.putText(stroke, caption, (4, height - 6), font, scale, 255, thickness, cv2.LINE_AA)
        touched = stroke > 0
        cover = stroke[touched].astype(np.float64)[:, None] / 255
        mixed = (1 - cover) * pixels[touched] + cover * grey * top
        pixels[touched] = np.rint(mixed).astype(pixels.dtype)


def _check_header(path: str | os.PathLike[str]) -> None:
    """Refuse a file whose header claims too much, before it is decoded; not every format is known
    to Pillow, so the decoded size is checked too."""
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(path) as image:
                _check_size(path, *image.size)
        except Image.DecompressionBombError:
            raise InputError(f"{path}: too many pixels; at most {MAX_PIXELS} are read") from None
        except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
            if isinstance(error, InputError):
                raise


def _check_size(path: str | os.PathLike[str], width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{path}: {width} x {height} pixels are too many; at most {MAX_PIXELS} are read"
        )
