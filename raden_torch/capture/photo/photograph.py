"""Photograph files → linear light, what is saturated, and what the file says of the exposure."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.mosaic import (
    BAYER_PATTERNS,
    demosaiced,
    looks_like_mosaic,
    possible_patterns,
)
from raden_torch.errors import InputError
from raden_torch.images.colour_space import (
    SRGB_SPACE,
    ColourSpace,
    colour_space_of,
    exr_matrix,
    float_matrix,
    in_srgb,
)
from raden_torch.images.pixels import StoredImage, oriented, read_image

Coding = Literal["auto", "srgb", "linear"] | NDArray[np.floating[Any]]

_JPEG_SUFFIXES = (".jpg", ".jpeg")
_JUMPS = 0.15
"""Share of neighbours half the range apart from which an 8-bit file is taken for the low bytes of
16-bit values; ordinary photographs stay below 0.02, low bytes lie near 0.25."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph in linear light.

    Attributes:
        linear: `[H, W, 3]` RGB, or `[H, W, 1]` for a mosaic that was kept; 1 is the white level of
            whole-number files, float files keep their own unit.
        saturated: `[H, W]`, true where a stored value reached the white level, so that `linear`
            means only "at least"; after demosaicing also the pixels that were made of such values.
        rounding: `[H, W, C]`, the standard deviation of `linear` that comes of whole numbers alone.
        path: the file, for messages.
        bits: of one stored value; None for floats.
        exposure_s: as stated, or as the file's EXIF says; None where nobody does.
        iso, f_number: as EXIF says, else None.
        pattern: the Bayer pattern of a raw mosaic, row by row from the upper left corner ("RGGB").
    """

    linear: Floats32
    saturated: NDArray[np.bool_]
    rounding: Floats32
    path: Path
    bits: int | None = None
    exposure_s: float | None = None
    iso: float | None = None
    f_number: float | None = None
    pattern: str | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.saturated.shape
        return height, width


def read_linear(
    path: str | os.PathLike[str],
    *,
    coded: Coding = "auto",
    pattern: str | None = None,
    keep_mosaic: bool = False,
    white_level: float | None = None,
    exposure_s: float | None = None,
) -> Photograph:
    """Read a photograph: 8- or 16-bit PNG, JPEG or TIFF, float TIFF, EXR, Radiance HDR, or a raw
    Bayer mosaic as a TIFF or PNG of one channel.

    A colour profile (or PNG's colour chunks, or OpenEXR's chromaticities) is followed to linear RGB
    of sRGB's primaries, except in mosaics and with a response. Alpha is left out.

    Args:
        coded: what the stored values mean. "linear": light of the profile's primaries; "srgb": sRGB
            whatever the profile's curve is; a response as `recover_response` gives it, `[levels]`
            or `[levels, 3]`; "auto": linear for mosaics and floats, the profile's curve for the
            rest, sRGB where there is none.
        pattern: "RGGB", "BGGR", "GRBG" or "GBRG" for a mosaic; without it the file's CFA tag is
            taken. "none" says that the one channel is grey.
        keep_mosaic: leave the mosaic `[H, W, 1]` as it is.
        white_level: the stored value at which the sensor saturates, where that is not the largest
            that fits (4095 for 12-bit values in a 16-bit file).
        exposure_s: exposure time in seconds, before what EXIF says.

    Raises:
        InputError: not readable; a JPEG that is said to be linear; a mosaic whose pattern is not
            known; whole numbers of which only the low bytes are left.

    Warns:
        UserWarning: a 16-bit file that holds 8-bit values.
    """
    path = Path(path)
    if path.suffix.lower() == ".exr":
        stored: NDArray[Any] = _exr_colour(path)
        said: dict[str, Any] = {}
        space, matrix = None, exr_matrix(path)
    else:
        image = read_image(path)
        stored, said = image.pixels, _metadata(image)
        space, matrix = _colours(path, image, coded)
    _check_whole(path, stored)
    mosaic = _pattern(path, stored, pattern, said.get("pattern"))
    linear, rounding, top = _decoded(
        path, stored, coded, white_level or said.get("white"), mosaic, space
    )
    if matrix is not None and linear.shape[2] == 3:
        linear = in_srgb(linear, matrix)
        rounding = np.sqrt(in_srgb(rounding**2, matrix**2))
    full = stored.reshape(*stored.shape[:2], -1) >= (np.inf if top is None else top)
    saturated: NDArray[np.bool_] = np.asarray(full.any(axis=2))
    if mosaic is not None and not keep_mosaic:
        linear, rounding = demosaiced(linear[..., 0], mosaic), demosaiced(rounding[..., 0], mosaic)
        saturated = _spread(saturated)
    elif mosaic is None and linear.shape[2] == 1:
        linear, rounding = np.repeat(linear, 3, 2), np.repeat(rounding, 3, 2)
    seconds = said.get("exposure_s") if exposure_s is None else exposure_s
    if seconds is not None and not 0 < seconds < np.inf:
        raise InputError(f"{path}: exposure: expected a positive time, got {seconds} s")
    return Photograph(
        linear,
        saturated,
        rounding,
        path,
        stored.dtype.itemsize * 8 if stored.dtype.kind == "u" else None,
        seconds,
        said.get("iso"),
        said.get("f_number"),
        mosaic,
    )


def read_stored(path: str | os.PathLike[str]) -> NDArray[Any]:
    """`[H, W, 3]` RGB as stored, for what looks at a picture rather than measures it.

    Float files come as 8-bit sRGB with their brightest hundredth clipped; 16-bit ones as 8-bit.

    Raises:
        InputError: as for `read_linear`.
    """
    path = Path(path)
    is_exr = path.suffix.lower() == ".exr"
    pixels: NDArray[Any] = _exr_colour(path) if is_exr else read_image(path).rgb
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype.kind == "u":
        return (pixels >> 8).astype(np.uint8)
    return shown(pixels)


def shown(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Linear `[H, W, 3]` → 8-bit sRGB for a person or a detector, the brightest 1 % clipped."""
    top = float(np.quantile(linear.max(axis=-1), 0.99))
    scaled = np.clip(linear / top if top > 0 else linear, 0, 1)
    return (
        np.searchsorted(SRGB_SPACE.table(255)[:, 0], scaled.ravel())
        .reshape(linear.shape)
        .astype(np.uint8)
    )


def check_same_size(photos: Sequence[Photograph]) -> None:
    """Raise InputError, naming the file, where a photograph differs in size from the first."""
    for photo in photos[1:]:
        if photo.size != photos[0].size:
            (h, w), (height, width) = photos[0].size, photo.size
            raise InputError(
                f"{photo.path}: expected photographs of one size, got {width} x {height} pixels, "
                f"but {photos[0].path} has {w} x {h} (was the camera turned?)"
            )


def _decoded(
    path: Path,
    stored: NDArray[Any],
    coded: Coding,
    white: float | None,
    mosaic: str | None,
    space: ColourSpace | None,
) -> tuple[Floats32, Floats32, float | None]:
    """Linear and its rounding, `[H, W, C]`, and the stored value that is saturated."""
    values = stored if stored.ndim == 3 else stored[..., None]
    if stored.dtype.kind == "f":
        linear = np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0)
        return linear, np.zeros_like(linear), white
    levels = int(np.iinfo(stored.dtype).max)
    top = float(levels if white is None else white)
    if not 1 < top <= levels:
        raise InputError(f"{path}: white level: expected 2…{levels}, got {top:g}")
    table = _table(path, coded, levels, top, mosaic, space)
    slope = np.gradient(table, axis=0)
    grain = (slope / np.sqrt(12)).astype(np.float32)
    linear, rounding = np.empty(values.shape, np.float32), np.empty(values.shape, np.float32)
    for c in range(values.shape[2]):
        column = min(c, table.shape[1] - 1)
        linear[..., c] = table[:, column].take(values[..., c])
        rounding[..., c] = grain[:, column].take(values[..., c])
    return linear, rounding, top


def _table(
    path: Path,
    coded: Coding,
    levels: int,
    top: float,
    mosaic: str | None,
    space: ColourSpace | None,
) -> Floats32:
    """Stored value → linear, `[levels + 1, 1 or 3]`."""
    if not isinstance(coded, str):
        table = np.asarray(coded, np.float32).reshape(len(coded), -1)
        if table.shape not in ((levels + 1, 1), (levels + 1, 3)):
            raise InputError(
                f"{path}: response: expected {levels + 1} x 1 or 3 values, got {list(table.shape)}"
            )
        return table
    if coded not in ("auto", "srgb", "linear"):
        raise InputError(f"coded: expected auto, srgb or linear, got {coded!r}")
    if coded == "linear" and path.suffix.lower() in _JPEG_SUFFIXES:
        raise InputError(
            f"{path}: a JPEG is never linear; give the raw file or a linear TIFF, take it as sRGB, "
            "or recover its response from an exposure stack"
        )
    ramp = np.arange(levels + 1, dtype=np.float32)[:, None] / top
    if coded == "linear" or (coded == "auto" and mosaic is not None):
        return ramp
    return (SRGB_SPACE if space is None or coded == "srgb" else space).table(levels, top)


def _colours(
    path: Path, image: StoredImage, coded: Coding
) -> tuple[ColourSpace | None, NDArray[np.float64] | None]:
    """What the file says of its colours, and the matrix to sRGB's primaries."""
    if not isinstance(coded, str):
        return None, None
    tags = image.header.colour
    if image.pixels.dtype.kind == "f":
        return None, float_matrix(tags, path, is_linear=coded == "linear")
    space = colour_space_of(tags, path)
    return space, None if space is None else space.matrix


def _check_whole(path: Path, stored: NDArray[Any]) -> None:
    """Whole numbers that lost half of themselves."""
    if stored.dtype.kind == "f":
        return
    if stored.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: expected 8 or 16 bits or floats, got {stored.dtype} values")
    stored = stored[:: max(1, len(stored) // 512)]  # some rows tell
    if stored.dtype == np.uint16:
        if stored.max() and (not (stored % 257).any() or not (stored % 256).any()):
            warnings.warn(
                f"{path}: a 16-bit file with 8-bit values (256 levels); export it from the raw "
                "file with 16 bits",
                stacklevel=3,
            )
        return
    # two pixels apart, so that a Bayer mosaic's neighbours are of one colour
    apart = np.abs(stored[:, 2:].astype(np.int16) - stored[:, :-2]) > 127
    if apart.size and apart.mean() > _JUMPS:
        raise InputError(
            f"{path}: {100 * apart.mean():.0f} % of its neighbouring pixels differ by more than "
            "half the range: the low bytes of 16-bit data saved as 8-bit? Save it as 16-bit"
        )


def _pattern(
    path: Path, stored: NDArray[Any], stated: str | None, tagged: str | None
) -> str | None:
    if stated is not None and stated.upper() not in (*BAYER_PATTERNS, "NONE"):
        raise InputError(
            f"Bayer pattern: expected {', '.join(BAYER_PATTERNS)} or none, got {stated!r}"
        )
    if stored.ndim == 3:
        if stated is not None and stated.upper() != "NONE":
            raise InputError(
                f"{path}: expected a Bayer mosaic of one channel, got an image with colours"
            )
        return None
    if stated is not None:
        return None if stated.upper() == "NONE" else stated.upper()
    is_jpeg = path.suffix.lower() in _JPEG_SUFFIXES
    if tagged is None and not is_jpeg and looks_like_mosaic(stored):
        raise InputError(
            f"{path}: a raw Bayer mosaic without a CFA tag; give its pattern, which is "
            f"{' or '.join(possible_patterns(stored))} (red and blue cannot be told apart), or "
            '"none" if it is grey'
        )
    return tagged


def _metadata(image: StoredImage) -> dict[str, Any]:
    """The values of EXIF and TIFF tags; empty where there are none."""
    said: dict[str, Any] = {}
    inner = image.header.tags
    for name, tag in (("exposure_s", 33434), ("f_number", 33437), ("iso", 34855), ("white", 50717)):
        value: Any = inner.get(tag)
        try:
            number = float(value[0] if isinstance(value, tuple) else value)
        except (TypeError, ValueError, ZeroDivisionError, IndexError):
            continue
        if 0 < number < np.inf:
            said[name] = number
    cells = inner.get(33422)  # TIFF/EP CFAPattern: 0 red, 1 green, 2 blue
    if isinstance(cells, (bytes, tuple)) and len(cells) == 4 and set(cells) <= {0, 1, 2}:
        word = "".join("RGB"[int(c)] for c in cells)
        if word in BAYER_PATTERNS:
            said["pattern"] = _turned(word, image)
    return said


def _turned(pattern: str, image: StoredImage) -> str:
    """The pattern of the picture as it is read, turned as EXIF says; the tag is of it as stored."""
    way, (height, width) = image.header.orientation, image.pixels.shape[:2]
    if way >= 5:
        height, width = width, height
    rows, columns = np.ogrid[: 2 + height % 2, : 2 + width % 2]
    corner = oriented(np.array(list(pattern))[2 * (rows % 2) + columns % 2], way)[:2, :2]
    return "".join(corner.ravel())


def _exr_colour(path: Path) -> Floats32:
    from raden_torch.images.exr import read_channels

    channels = read_channels(path)
    names = ["R", "G", "B"] if {"R", "G", "B"} <= set(channels) else ["Y"] * 3
    if not set(names) <= set(channels):
        raise InputError(
            f"{path}: expected a photograph with channels R, G, B, got {', '.join(channels)}"
        )
    return np.stack([channels[name] for name in names], -1)


def _spread(saturated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    import cv2

    return cv2.dilate(saturated.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
