"""Stored pixels of an image file: no curve undone, no scaling, colours not multiplied by alpha.

8 bits go through Pillow, which knows palettes, transparency and all ways of packing them; deeper
values through OpenCV, since Pillow cuts them to 8 bits; what only compositors write, OpenImageIO.
"""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import written_beside
from raden_torch.images.header import Header, check_size, read_header
from raden_torch.images.named_space import with_space
from raden_torch.images.other_formats import other_format, read_other
from raden_torch.packages import require

OPAQUE_ENOUGH = 2.0**-16
"""Of floats: colours under less alpha than this are taken as they are, not divided by it."""


@dataclass(frozen=True, eq=False)
class StoredImage:
    """An image file's values in the file's own type, turned as its EXIF orientation says.

    Attributes:
        pixels: grey `[H, W]` or RGB `[H, W, 3]`, not multiplied by alpha.
        alpha: `[H, W]`, of the same type, or None.
        header: what the file says of itself.
    """

    pixels: NDArray[Any]
    alpha: NDArray[Any] | None
    header: Header

    @property
    def rgb(self) -> NDArray[Any]:
        """`[H, W, 3]`; grey three times."""
        return self.pixels if self.pixels.ndim == 3 else np.repeat(self.pixels[..., None], 3, 2)


def read_image(path: str | os.PathLike[str]) -> StoredImage:
    """The stored values of a PNG, JPEG, TIFF, BMP, GIF, WebP, PPM or Radiance HDR file, or of one
    in `other_formats.py`.

    A palette comes as the colours that it stands for; bits fewer than 8 as 8.

    Raises:
        InputError: as for `read_header` and `read_other`, or damaged.
    """
    other = other_format(path)
    by_pillow = False
    if other is None:
        header = read_header(path)
        by_pillow = header.bits == 8 or (header.format, header.kind) == ("PPM", "f")
        values = _by_pillow(path, header) if by_pillow else _by_opencv(path)
    else:
        header, values = read_other(path, other)
    if header.format != "TIFF":  # both decoders turn a TIFF themselves
        values = oriented(values, header.orientation)
    check_size(path, values.shape[1], values.shape[0])
    alpha = None
    if values.ndim == 3 and values.shape[2] in (2, 4):
        alpha = None if header.alpha == "none" else np.ascontiguousarray(values[..., -1])
        values = values[..., 0] if values.shape[2] == 2 else values[..., :3]
    if header.zero_is_white and not by_pillow:
        values = np.iinfo(values.dtype).max - values
    if header.alpha == "associated" and not by_pillow and alpha is not None:
        values = divided(values, alpha)
    return StoredImage(np.ascontiguousarray(values), alpha, header)


def read_pixels(path: str | os.PathLike[str], *, colour: bool) -> NDArray[Any]:
    """The values of `read_image`, in one array.

    Args:
        colour: `[H, W, 3]` RGB whatever the file holds; else grey `[H, W]`, grey and alpha
            `[H, W, 2]`, RGB or RGBA `[H, W, C]`.
    """
    image = read_image(path)
    if colour:
        return image.rgb
    return image.pixels if image.alpha is None else np.dstack([image.pixels, image.alpha])


def oriented(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """`[H, W, …]` as it is to be seen, after EXIF's orientation 1…8."""
    if orientation >= 5:
        values = values.swapaxes(0, 1)
    upside_down, mirrored = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    return values[:: -1 if upside_down else 1, :: -1 if mirrored else 1]


def turned_to(values: NDArray[Any], own: int, wanted: int) -> NDArray[Any]:
    """`[H, W, …]` that was turned by EXIF's orientation `own`, turned by `wanted` instead."""
    if own == wanted:
        return values
    back = {6: 8, 8: 6}.get(own, own)  # the others are their own inverse
    return np.ascontiguousarray(oriented(oriented(values, back), wanted))


def divided(colours: NDArray[Any], alpha: NDArray[Any]) -> NDArray[Any]:
    """Colours without the alpha that they were multiplied by, in their own type."""
    if colours.dtype.kind == "f":
        return colours / np.where(alpha > OPAQUE_ENOUGH, alpha, 1)[..., None]
    top = np.iinfo(colours.dtype).max
    share = np.where(alpha > 0, alpha, top)[..., None] / top
    return np.rint(np.minimum(colours / share, top)).astype(colours.dtype)


def _by_pillow(path: str | os.PathLike[str], header: Header) -> NDArray[Any]:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # large images, damaged tags
            # by name, Pillow would map an uncompressed TIFF into memory and scramble a turned one
            with open(path, "rb") as file, Image.open(file) as image:
                image.load()
                if header.kind == "f":
                    return np.array(image, np.float32)
                is_grey = image.mode in ("1", "L", "LA")
                wanted = "L" if is_grey else "RGB"
                if header.alpha != "none":
                    wanted = "LA" if is_grey else "RGBA"
                return np.array(image if image.mode == wanted else image.convert(wanted))
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, struct.error) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: damaged or of an unknown kind ({reason})") from None


def _by_opencv(path: str | os.PathLike[str]) -> NDArray[Any]:
    import cv2

    try:
        with _quiet():
            pixels = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise InputError(f"{path}: damaged, or compressed in a way that OpenCV does not know")
    return pixels if pixels.ndim == 2 else pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV tells its errors on stderr, too."""
    from cv2.utils import logging

    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def write_pixels(
    pixels: NDArray[Any],
    path: str | os.PathLike[str],
    alpha: NDArray[Any] | None = None,
    *,
    profile: str | None = None,
) -> None:
    """Write `[H, W, 3]` RGB or `[H, W]` grey pixels as they are, encoded by the path's suffix.

    Args:
        alpha: `[H, W]`, of the pixels' type; it does not multiply them.
        profile: the name of the pixels' colour space, for a PNG or JPEG; None says nothing.

    Raises:
        InputError: OpenCV cannot encode them so, or the folder does not exist.
    """
    suffix = Path(path).suffix.lower()
    try:
        data = encoded(pixels, suffix, alpha)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if alpha is not None and suffix in (".tif", ".tiff"):
        data = _with_straight_alpha(data)
    if profile is not None:
        data = with_space(data, profile)
    with written_beside(path) as temporary:
        temporary.write_bytes(data)


def encoded(pixels: NDArray[Any], suffix: str, alpha: NDArray[Any] | None = None) -> bytes:
    """`[H, W, 3]` RGB or `[H, W]` grey pixels as an image file's bytes; `suffix` as ".png".

    Raises:
        InputError: OpenCV cannot encode them so.
    """
    require("images", "images")
    import cv2

    bgr = np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels
    if alpha is not None:
        bgr = np.dstack([*(bgr,) * (1 if bgr.ndim == 3 else 3), alpha])
    try:
        with _quiet():
            ok, data = cv2.imencode(suffix, bgr)
    except cv2.error:
        ok = False
    if not ok:
        raise InputError("OpenCV could not encode the picture")
    return bytes(data.tobytes())


def _with_straight_alpha(tiff: bytes) -> bytes:
    """Tag the fourth channel of OpenCV's TIFF (ExtraSamples: 2, unassociated alpha): a copy of its
    directory with one more entry, at the end of the file."""
    (start,) = struct.unpack_from("<I", tiff, 4)
    (count,) = struct.unpack_from("<H", tiff, start)
    entries = [tiff[start + 2 + 12 * k :][:12] for k in range(count)]
    entries.append(struct.pack("<HHIHH", 338, 3, 1, 2, 0))
    entries.sort(key=lambda entry: struct.unpack_from("<H", entry)[0])
    body = tiff + b"\0" * (len(tiff) % 2)
    directory = struct.pack("<H", count + 1) + b"".join(entries) + struct.pack("<I", 0)
    return body[:4] + struct.pack("<I", len(body)) + body[8:] + directory


def draw_caption(pixels: NDArray[Any], caption: str, alpha: NDArray[Any] | None = None) -> None:
    """Draw a small line into the lower left corner of 8- or 16-bit `[H, W, 3]` pixels, in place.

    Args:
        alpha: `[H, W]`, of the pixels' type: made opaque under the strokes.

    OpenCV draws on 8 bits; the strokes are laid over the pixels in their own depth.
    """
    require("images", "images")
    import cv2

    top = np.iinfo(pixels.dtype).max
    height, width = pixels.shape[:2]
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    (text_width, _), _ = cv2.getTextSize(caption, font, scale, 1)
    scale *= min(1.0, max(width - 8, 1) / max(text_width, 1))
    thin = np.zeros((height, width), np.uint8)
    cv2.putText(thin, caption, (4, height - 6), font, scale, 255, 1, cv2.LINE_AA)
    # dilated, since a thicker stroke's letters may be wider, too (OpenCV 5)
    halo = cv2.dilate(thin, np.ones((3, 3), np.uint8))
    for grey, stroke in ((0.0, halo), (190 / 255, thin)):
        touched = stroke > 0
        cover = stroke[touched].astype(np.float64)[:, None] / 255
        mixed = (1 - cover) * pixels[touched] + cover * grey * top
        pixels[touched] = np.rint(mixed).astype(pixels.dtype)
        if alpha is not None:
            under = alpha[touched] + cover[:, 0] * (top - alpha[touched].astype(np.float64))
            alpha[touched] = np.rint(under).astype(alpha.dtype)
