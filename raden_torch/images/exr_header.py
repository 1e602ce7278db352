"""The header of an OpenEXR file, as OpenImageIO read it, checked before any pixel is decoded."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from raden_torch.errors import InputError, why
from raden_torch.files import check_seekable
from raden_torch.images.openimageio import error_of

MAX_PIXELS = 2**26
"""The largest window that is read or written at once, in pixels (8192 x 8192)."""
MAX_VALUES = 2**29
"""The most values that are read at once, pixels times channels (2 GiB as float32)."""
MAX_SIDE = 2**20
"""The most rows or columns of a file that is read or written by rows."""
_LARGE, _SPARSE = 1 << 24, 4096  # a larger display window may not be emptier than this
_MAGIC = b"\x76\x2f\x31\x01"


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels; right and bottom are the first column and row behind it."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.bottom - self.top, self.right - self.left

    @property
    def area(self) -> int:
        height, width = self.size
        return height * width

    def overlaps(self, other: Window) -> bool:
        return max(self.left, other.left) < min(self.right, other.right) and max(
            self.top, other.top
        ) < min(self.bottom, other.bottom)

    def __str__(self) -> str:
        return f"{self.left}, {self.top} to {self.right - 1}, {self.bottom - 1}"


@dataclass(frozen=True)
class Part:
    """The header of one part.

    Attributes:
        name: "" where a single part has none.
        number: its place in the file.
        channels: name → "half", "float" or "uint", in the order of the file, which is sorted.
        order: the names as OpenImageIO counts them.
        data, display: the windows.
        tile: width and height of the tiles, or None for scan lines.
        rows: that are compressed together.
        compression: its name in lower case.
        pixel_aspect: width over height of a pixel.
        chromaticities: x, y of red, green, blue and white; None where the file does not say.
        world_to_camera, world_to_ndc: the camera's matrices, 16 numbers for row vectors; None where
            the file does not say.
    """

    name: str
    number: int
    channels: Mapping[str, str]
    order: tuple[str, ...]
    data: Window
    display: Window
    tile: tuple[int, int] | None
    rows: int
    compression: str
    pixel_aspect: float
    chromaticities: tuple[float, ...] | None
    world_to_camera: tuple[float, ...] | None = None
    world_to_ndc: tuple[float, ...] | None = None


def damaged(path: str | os.PathLike[str], reason: str) -> InputError:
    return InputError(
        f"{path}: truncated or damaged, or of an unknown kind; expected a whole OpenEXR file "
        f"({reason})"
    )


def check_magic(path: str | os.PathLike[str]) -> None:
    try:
        check_seekable(path)
        with open(path, "rb") as file:
            start = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: expected an OpenEXR file, got {why(error)}") from None
    if start != _MAGIC:
        raise InputError(f"{path}: expected an OpenEXR file, got one that starts with {start!r}")


def parts_of(path: str | os.PathLike[str], file: Any) -> Iterator[Part]:
    for number in range(max(1, file.spec().get_int_attribute("oiio:subimages", 1))):
        if not file.seek_subimage(number, 0):
            raise damaged(path, error_of(file))
        spec = file.spec()
        name, order = spec.get_string_attribute("oiio:subimagename"), spec.channelnames
        try:
            for text in (name, *order):
                text.encode()
        except UnicodeEncodeError:
            raise InputError(
                f"{path}: expected names of channels and parts in UTF-8, got other bytes: is it "
                "damaged?"
            ) from None
        if spec.deep:
            where = f"{path}: part {name!r}" if name else f"{path}"
            raise InputError(f"{where}: expected one value a pixel, got deep pixels; flatten them")
        kinds = [str(kind) for kind in spec.channelformats] or [str(spec.format)] * len(order)
        tile = (spec.tile_width, spec.tile_height) if spec.tile_width else None
        place = spec.getattribute("chromaticities")
        yield Part(
            name,
            number,
            dict(sorted(zip(order, kinds, strict=True))),
            tuple(order),
            Window(spec.x, spec.y, spec.x + spec.width, spec.y + spec.height),
            Window(
                *(spec.full_x, spec.full_y),
                *(spec.full_x + spec.full_width, spec.full_y + spec.full_height),
            ),
            tile,
            tile[1] if tile else spec.get_int_attribute("oiio:RowsPerChunk", 1),
            spec.get_string_attribute("compression") or "unknown",
            spec.get_float_attribute("PixelAspectRatio", 1.0),
            None if place is None else tuple(float(v) for v in place),
            _matrix(spec, "worldToCamera"),
            _matrix(spec, "worldToNDC"),
        )


def _matrix(spec: Any, name: str) -> tuple[float, ...] | None:
    """The 16 numbers of an attribute, None where there are none that are finite."""
    held = spec.getattribute(name)
    if not isinstance(held, tuple) or len(held) != 16:
        return None
    numbers = tuple(float(value) for value in held)
    return numbers if all(map(isfinite, numbers)) else None


def check_part(path: str | os.PathLike[str], part: Part, at_once: bool) -> None:
    where = f"{path}: part {part.name!r}" if part.name else f"{path}"
    if part.tile is not None and not 0 < part.tile[0] * part.tile[1] <= MAX_PIXELS:
        width, height = part.tile
        raise InputError(f"{where}: tiles: expected 1…{MAX_PIXELS} pixels, got {width} x {height}")
    for window, name in ((part.data, "dataWindow"), (part.display, "displayWindow")):
        height, width = window.size
        claims = f"{width} x {height} by its {name}"
        if not at_once and not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
            raise InputError(f"{where}: expected 1…{MAX_SIDE} on each side, got {claims}")
        if at_once and (height < 1 or width < 1 or window.area > MAX_PIXELS):
            raise InputError(f"{where}: expected 1…{MAX_PIXELS} pixels, got {claims}")
    height, width = part.data.size
    rows = min(height, part.rows)
    if not at_once and rows * width > min(MAX_PIXELS, MAX_VALUES // len(part.channels)):
        raise InputError(
            f"{where}: expected rows that are compressed together to have at most {MAX_PIXELS} "
            f"pixels and {MAX_VALUES} values, got {rows} rows of {width} pixels"
        )
    if not part.data.overlaps(part.display):
        raise InputError(
            f"{where}: expected a data window that overlaps the display window, got one outside it"
        )
    if part.display.area > _LARGE and part.display.area > _SPARSE * part.data.area:
        height, width = part.display.size
        raise InputError(
            f"{where}: expected a data window of at least 1/{_SPARSE} of the display window, got "
            f"{part.data.area} pixels in {width} x {height}"
        )
