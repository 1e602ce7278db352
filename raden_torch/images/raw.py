"""Camera raw files, read by LibRaw; `raw_image.py` is what they are then."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.colorimetry import SRGB, primary_matrix
from raden_torch.errors import InputError
from raden_torch.files import check_seekable, first_bytes
from raden_torch.images.header import check_size
from raden_torch.images.mosaic import BAYER_PATTERNS, turned_cells, turned_pattern
from raden_torch.images.openimageio import readable_name
from raden_torch.images.pixels import oriented
from raden_torch.images.raw_image import RawColour, RawImage
from raden_torch.images.raw_tags import RawTags, has_dng_version, read_raw_tags
from raden_torch.packages import quiet_stderr, require

_SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".k25"),
    *(".kdc", ".mdc", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw"),
    *(".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
_STARTS = (
    b"II*\0\x10\0\0\0CR",  # CR2
    b"FUJIFILMCCD-RAW",
    b"IIRO",
    b"IIRS",
    b"MMOR",
    b"IIU\0",
    b"FOVb",
    b"\0MRM",
    b"II\x1a\0\0\0HEAPCCDR",
)
_CR3 = b"ftypcrx "
_ORIENTATIONS = {0: 1, 1: 2, 3: 3, 2: 4, 4: 5, 6: 6, 7: 7, 5: 8}
"""LibRaw's flip → EXIF's orientation."""


def is_raw(path: str | os.PathLike[str]) -> bool:
    """Whether a file is one of a camera's raw files, by its first bytes or its name.

    Raises:
        InputError: a pipe or a device.
    """
    start = first_bytes(path, 65536)
    if start is None:
        return False
    return Path(path).suffix.lower() in _SUFFIXES or begins_as_raw(start)


def begins_as_raw(start: bytes) -> bool:
    """Whether first bytes are a raw file's; NEF, ARW and others begin as a TIFF, and are told by
    their names."""
    return start.startswith(_STARTS) or start[4:12] == _CR3 or has_dng_version(start)


def read_raw(path: str | os.PathLike[str]) -> RawImage:
    """Read a raw file of a Bayer or a grey camera, or a linear DNG.

    Raises:
        InputError: missing, damaged, or unknown to LibRaw; too large, found before the memory is
            taken; another mosaic (X-Trans), or colours that are not linear light of the camera
            (sRAW, Foveon, floats); levels that LibRaw does not follow.
    """
    try:
        check_seekable(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; expected a camera raw file") from None
    tags = read_raw_tags(path)
    tags.check(path)
    with _opened(path) as raw:
        values, window = _values(path, raw, tags)
        cells, pattern = _cells(path, raw, window)
        levels = np.array(raw.black_level_per_channel, np.float64)
        black = levels[: 3 if values.ndim == 3 else 1]
        if pattern is not None:
            own = tags.black(*window)
            black = levels[cells] if own is None else own
        white = float(min((raw.white_level, *_positive(raw.camera_white_level_per_channel))))
        colour = _colour(raw, tags)
        turned = _ORIENTATIONS.get(raw.sizes.flip, 1)
        said = tags.with_defaults(_exif_of(raw))
    if not white > black.max() + 1:
        raise InputError(
            f"{path}: expected a white level above the black level of {black.max():g}, got "
            f"{white:g}"
        )
    if pattern is not None:
        size = (values.shape[0], values.shape[1])
        black = turned_cells(black, turned, size)
        pattern = turned_pattern(pattern, turned, size)
    image = np.ascontiguousarray(oriented(values, turned))
    return RawImage(image, pattern, black, white, colour, {**said, 274: turned}, tags.notes)


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """LibRaw's file, unpacked; its errors here and in the block are ours."""
    require("camera raw files", "raw")
    import rawpy

    with readable_name(path) as name, rawpy.RawPy() as raw:
        try:
            with quiet_stderr():
                raw.open_file(name)
                size = raw.sizes
                check_size(path, size.raw_width, size.raw_height)
                raw.unpack()
            yield raw
        except (rawpy.LibRawError, RuntimeError, OSError, MemoryError) as error:
            raise _damaged(path, error) from None


def _damaged(path: str | os.PathLike[str], error: Exception) -> InputError:
    said = error.args[0] if error.args else type(error).__name__
    reason = said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
    return InputError(
        f"{path}: expected a whole raw file of a camera that LibRaw knows, got an error of it: "
        f"{' '.join(reason.split())}"
    )


def _values(
    path: str | os.PathLike[str], raw: Any, tags: RawTags
) -> tuple[NDArray[np.uint16], tuple[int, int]]:
    """A copy of the pixels that the camera means to be seen, and where they begin."""
    import rawpy

    size = raw.sizes
    if abs(size.pixel_aspect - 1) > 0.005:
        raise InputError(
            f"{path}: expected square pixels, got some {size.pixel_aspect:g} times as high as wide"
        )
    is_colour = raw.raw_type == rawpy.RawType.Stack
    if is_colour and not (tags.is_dng and raw.num_colors == 3):
        raise InputError(
            f"{path}: expected a mosaic or a linear DNG, got colours that the camera mixed (sRAW, "
            "Foveon); convert it to a linear DNG or a linear 16-bit TIFF"
        )
    whole = raw.raw_image
    top, left, height, width = size.top_margin, size.left_margin, size.height, size.width
    inner = (size.crop_top_margin, size.crop_left_margin, size.crop_height, size.crop_width)
    if (
        min(inner[2:]) > 0
        and top <= inner[0] <= inner[0] + inner[2] <= top + height
        and left <= inner[1] <= inner[1] + inner[3] <= left + width
    ):
        top, left, height, width = inner
    values = whole[top : top + height, left : left + width]
    if values.shape[:2] != (height, width) or values.size == 0:
        raise _damaged(path, ValueError("its pixels do not fill its frame"))
    return np.array(values[..., :3] if is_colour else values), (top, left)


def _cells(
    path: str | os.PathLike[str], raw: Any, window: tuple[int, int]
) -> tuple[NDArray[np.intp], str | None]:
    """`[2, 2]` LibRaw's numbers of the colours at the upper left, and the Bayer pattern."""
    none = np.zeros((2, 2), np.intp)
    numbers = raw.raw_pattern
    if numbers is None or raw.num_colors == 1:
        return none, None
    names = raw.color_desc.decode("latin-1")
    if numbers.shape != (2, 2) or numbers.max() >= len(names):
        height, width = numbers.shape
        raise InputError(
            f"{path}: expected a Bayer mosaic of 2 x 2 cells, got one of {width} x {height}"
            f"{' (X-Trans)' if height == 6 else ''}; convert it to a linear DNG"
        )
    cells = np.roll(numbers, (-window[0] % 2, -window[1] % 2), (0, 1)).astype(np.intp)
    pattern = "".join(names[c] for c in cells.ravel())
    if pattern not in BAYER_PATTERNS:
        raise InputError(f"{path}: expected a Bayer mosaic of R, G and B, got {pattern}")
    return cells, pattern


def _colour(raw: Any, tags: RawTags) -> RawColour | None:
    """As LibRaw and dcraw have it: XYZ of sRGB's primaries → camera RGB, each row scaled so that
    white is white, inverted. The balance multiplies before."""
    if raw.num_colors == 1:
        return None
    own = np.array(raw.color_matrix, np.float64)[:, :3]
    known = np.array(raw.rgb_xyz_matrix, np.float64)[:3]
    if tags.is_dng and np.isfinite(own).all() and own.any():
        matrix, said = own, "the matrix of the file"
    elif np.isfinite(known).all() and abs(np.linalg.det(known)) > 1e-6:
        camera = known @ primary_matrix(SRGB)
        matrix, said = np.linalg.inv(camera / camera.sum(axis=1, keepdims=True)), "LibRaw's matrix"
    else:
        return None
    shot = np.array(raw.camera_whitebalance, np.float64)[:3]
    if (shot > 0).all():
        balance, of = shot, "as shot"
    else:
        balance, of = np.array(raw.daylight_whitebalance, np.float64)[:3], "of daylight"
    if not (balance > 0).all() or not np.isfinite(balance).all():
        return None
    return RawColour(matrix, balance / balance.min(), f"{said} and the white balance {of}")


def _positive(levels: Any) -> list[int]:
    return [level for level in levels or () if level > 0]


def _exif_of(raw: Any) -> dict[int, Any]:
    """What LibRaw found, by EXIF's numbers."""
    other, lens = raw.other, raw.lens
    found = {
        33434: other.shutter_speed,
        33437: other.aperture,
        34855: other.iso_speed,
        37386: other.focal_length,
        42036: lens.model,
    }
    return {tag: value for tag, value in found.items() if value}
