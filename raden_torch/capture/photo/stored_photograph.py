"""A photograph's stored values and what its file says of them, before they become light."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.errors import InputError
from raden_torch.images.colour_space import (
    ColourSpace,
    colour_space_of,
    exr_matrix,
    float_matrix,
    no_primaries,
)
from raden_torch.images.lookup_profile import LookupProfile
from raden_torch.images.mosaic import (
    BAYER_PATTERNS,
    looks_like_mosaic,
    possible_patterns,
    turned_pattern,
)
from raden_torch.images.pixels import StoredImage, read_image
from raden_torch.images.raw import is_raw, read_raw
from raden_torch.images.raw_image import RawImage
from raden_torch.images.shot_settings import UNKNOWN, ShotSettings, positive, settings_of

Coding = Literal["auto", "srgb", "linear"] | NDArray[np.floating[Any]]

JPEG_SUFFIXES = (".jpg", ".jpeg")
_JUMPS = 0.15
"""Share of neighbours half the range apart from which an 8-bit file is taken for the low bytes of
16-bit values; ordinary photographs stay below 0.02, low bytes lie near 0.25."""


@dataclass(frozen=True, eq=False)
class StoredPhotograph:
    """A file as it was read.

    Attributes:
        path: the file, for messages.
        values: `[H, W]` or `[H, W, 3]` whole numbers of 8 or 16 bits, or floats.
        space: what the file says of its colours; None where it says nothing, or is not asked.
        matrix: `[3, 3]` from its linear RGB to that of sRGB's primaries; None where they are these.
        pattern: the Bayer pattern by its CFA tag, or of a raw file, turned as the picture is.
        white_level: the stored value at which the sensor saturates, by its tags; a raw file has its
            own.
        settings: of the camera, by EXIF.
        raw: a camera's raw file, whose `values` these are.
    """

    path: Path
    values: NDArray[Any]
    space: ColourSpace | LookupProfile | None = None
    matrix: NDArray[np.float64] | None = None
    pattern: str | None = None
    white_level: float | None = None
    settings: ShotSettings = UNKNOWN
    raw: RawImage | None = None

    @property
    def bits(self) -> int | None:
        """Of one value; None for floats."""
        return self.values.dtype.itemsize * 8 if self.values.dtype.kind == "u" else None


def read_photograph(path: Path, coded: Coding = "auto") -> StoredPhotograph:
    """Read a file; with a response as `coded` its colour profile is not looked at.

    Raises:
        InputError: not readable, or whole numbers of which only the low bytes are left.

    Warns:
        UserWarning: a 16-bit file that holds 8-bit values; a raw file that asks for corrections
            which are not made.
    """
    if is_raw(path):
        return _raw_photograph(path, coded)
    if path.suffix.lower() == ".exr":
        found = StoredPhotograph(path, exr_colour(path), matrix=exr_matrix(path))
    else:
        image = read_image(path)
        space, matrix = _colours(path, image, coded)
        found = StoredPhotograph(path, image.pixels, space, matrix, **_metadata(image))
    _check_whole(path, found.values)
    return found


def bayer_pattern(photo: StoredPhotograph, stated: str | None) -> str | None:
    """The pattern of a mosaic, as stated ("none" for a grey picture) or by its CFA tag; else None.

    Raises:
        InputError: no such pattern; colours; a mosaic of which nobody says the pattern.
    """
    path, stored = photo.path, photo.values
    if stated is not None and stated.upper() not in (*BAYER_PATTERNS, "NONE"):
        raise InputError(
            f"Bayer pattern: expected {', '.join(BAYER_PATTERNS)} or none, got {stated!r}"
        )
    if photo.raw is not None:
        if stated is not None:
            raise InputError(
                f"{path}: expected no pattern for a raw file, which says its own, got {stated}"
            )
        return photo.pattern
    if stored.ndim == 3:
        if stated is not None and stated.upper() != "NONE":
            raise InputError(
                f"{path}: expected a Bayer mosaic of one channel, got an image with colours"
            )
        return None
    if stated is not None:
        return None if stated.upper() == "NONE" else stated.upper()
    is_jpeg = path.suffix.lower() in JPEG_SUFFIXES
    if photo.pattern is None and not is_jpeg and looks_like_mosaic(stored):
        raise InputError(
            f"{path}: a raw Bayer mosaic without a CFA tag; give its pattern, which is "
            f"{' or '.join(possible_patterns(stored))} (red and blue cannot be told apart), or "
            '"none" if it is grey'
        )
    return photo.pattern


def exr_colour(path: Path) -> Floats32:
    """`[H, W, 3]` of a photograph as OpenEXR."""
    from raden_torch.images.exr import read_channels

    channels = read_channels(path)
    names = ["R", "G", "B"] if {"R", "G", "B"} <= set(channels) else ["Y"] * 3
    if not set(names) <= set(channels):
        raise InputError(
            f"{path}: expected a photograph with channels R, G, B, got {', '.join(channels)}"
        )
    return np.stack([channels[name] for name in names], -1)


def _raw_photograph(path: Path, coded: Coding) -> StoredPhotograph:
    if not isinstance(coded, str) or coded == "srgb":
        raise InputError(
            f"{path}: expected a raw file to be linear, got "
            f"{'sRGB' if isinstance(coded, str) else 'a response'}; leave it out"
        )
    raw = read_raw(path)
    for note in raw.notes:
        warnings.warn(f"{path}: {note}", stacklevel=4)
    return StoredPhotograph(
        path,
        raw.values,
        pattern=raw.pattern,
        settings=settings_of(raw.tags, is_raw=True),
        raw=raw,
    )


def _colours(
    path: Path, image: StoredImage, coded: Coding
) -> tuple[ColourSpace | LookupProfile | None, NDArray[np.float64] | None]:
    """What the file says of its colours, and the matrix to sRGB's primaries."""
    if not isinstance(coded, str):
        return None, None
    tags = image.header.colour
    if image.pixels.dtype.kind == "f":
        return None, float_matrix(tags, path, is_linear=coded == "linear")
    space = colour_space_of(tags, path)
    if isinstance(space, LookupProfile):
        if coded != "auto":
            raise no_primaries(path)
        return space, None
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
                stacklevel=4,
            )
        return
    # two pixels apart, so that a Bayer mosaic's neighbours are of one colour
    apart = np.abs(stored[:, 2:].astype(np.int16) - stored[:, :-2]) > 127
    if apart.size and apart.mean() > _JUMPS:
        raise InputError(
            f"{path}: {100 * apart.mean():.0f} % of its neighbouring pixels differ by more than "
            "half the range: the low bytes of 16-bit data saved as 8-bit? Save it as 16-bit"
        )


def _metadata(image: StoredImage) -> dict[str, Any]:
    """The values of EXIF and TIFF tags; empty where there are none."""
    inner = image.header.tags
    said: dict[str, Any] = {"settings": settings_of(inner)}
    white = positive(inner.get(50717))
    if white is not None:
        said["white_level"] = white
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
    return turned_pattern(pattern, way, (height, width))
