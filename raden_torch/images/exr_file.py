"""An OpenEXR file and its rows, decoded by OpenImageIO when they are asked for.

Pixels come as float32, `[rows, W]` of the *display* window: where the data window is smaller, the
rest is 0; what lies outside the display window is cut off. So all parts of a file have one size.
Whole numbers above 2²⁴ (object ids) lose their last digits. Of a tiled file the largest level is
read.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import check_seekable
from raden_torch.images.openimageio import error_of, opened, openimageio

MAX_PIXELS = 2**26
"""The largest window that is read or written at once, in pixels (8192 x 8192)."""
MAX_VALUES = 2**29
"""The most values that are read at once, pixels times channels (2 GiB as float32)."""
MAX_SIDE = 2**20
"""The most rows or columns of a file that is read or written by rows."""
_LARGE, _SPARSE = 1 << 24, 4096  # a larger display window may not be emptier than this
_STRIP = 1 << 19
"""Values that are decoded in one call, which fit a processor's cache."""
_MAGIC = b"\x76\x2f\x31\x01"

Key = tuple[str, str]
"""Part and channel."""
Maps = dict[Key, NDArray[np.float32]]


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


class ExrFile:
    """An OpenEXR file whose rows are read when they are asked for; the last ones are kept.

    Attributes:
        parts: by their names.
        size: height and width of the display window, which all parts share.
        keys: (key, part, channel) of all channels: the key is the channel's name, in a multi-part
            file "part.name" for each channel of a part that shares a name with another part.

    Args:
        at_once: all channels will be read whole: a file beyond `MAX_PIXELS` or `MAX_VALUES` is
            refused. Otherwise its sides may be `MAX_SIDE`.

    Raises:
        InputError: not an OpenEXR file, or damaged; deep or subsampled; parts of one name, or with
            different display windows; windows that are too large or too empty. Nothing but the
            header has been read.
    """

    def __init__(self, path: str | os.PathLike[str], *, at_once: bool = False) -> None:
        self.path = path
        _check_magic(path)
        self.parts: dict[str, Part] = {}
        with _opened(path) as file:
            for part in _parts_of(path, file):
                if part.name in self.parts:
                    raise InputError(
                        f"{path}: expected a different name for each part, got {part.name!r} twice"
                    )
                _check_part(path, part, at_once)
                self.parts[part.name] = part
        self.size = self.first.display.size
        self.keys = channel_keys({name: part.channels for name, part in self.parts.items()})
        values = sum(
            max(part.data.area, part.display.area) * len(part.channels)
            for part in self.parts.values()
        )
        if at_once and values > MAX_VALUES:
            raise InputError(
                f"{path}: expected at most {MAX_VALUES} values in all channels, got {values}: "
                "write the channels that are needed to a file of their own"
            )
        self._held, self._maps = (0, 0), Maps()

    @property
    def first(self) -> Part:
        """The part whose pixel aspect and chromaticities stand for all."""
        return next(iter(self.parts.values()))

    @property
    def may_be_whole(self) -> bool:
        """Whether all rows may be read at once."""
        return self.most_rows >= self.size[0]

    @property
    def most_rows(self) -> int:
        """The most rows that may be read at once."""
        return min(MAX_PIXELS, MAX_VALUES // len(self.keys)) // self.size[1]

    @property
    def chunk_rows(self) -> int:
        """No fewer rows than these are decoded at once."""
        return max(part.rows for part in self.parts.values())

    def read(self, keys: Iterable[Key], top: int, bottom: int) -> Maps:
        """`[bottom - top, W]` of each channel: rows of the display window, which count from 0.

        Channels that are asked for together are decoded together.

        Raises:
            InputError: truncated or damaged.
        """
        if (top, bottom) != self._held:
            self._held, self._maps = (top, bottom), {}
        wanted = dict.fromkeys(keys)
        missing = [key for key in wanted if key not in self._maps]
        if missing:
            with _opened(self.path) as file:
                for name, part in self.parts.items():
                    names = {channel for owner, channel in missing if owner == name}
                    if names:
                        self._maps |= self._decoded(file, part, names, top, bottom)
        return {key: self._maps[key] for key in wanted}

    def check_whole(self) -> None:
        """Raise InputError where the first or the last row of a part is missing or damaged."""
        with _opened(self.path) as file:
            for part in self.parts.values():
                for row in (part.data.top, part.data.bottom - 1):
                    self._pixels(file, part, 0, 1, row, row + 1)

    def _decoded(self, file: Any, part: Part, names: set[str], top: int, bottom: int) -> Maps:
        """Rows of one part, strip by strip, so that little is taken beside what is returned."""
        data, display = part.data, part.display
        maps = {
            (part.name, name): np.zeros((bottom - top, self.size[1]), np.float32) for name in names
        }
        start, end = max(data.top, display.top + top), min(data.bottom, display.top + bottom)
        if start >= end:
            return maps
        left, right = max(data.left, display.left), min(data.right, display.right)
        source = slice(left - data.left, right - data.left)
        target = slice(left - display.left, right - display.left)
        for together, first, last in _spans(part, names):
            is_whole = part.channels[part.order[first]] == "uint"
            lines = _STRIP // ((last - first) * data.size[1])
            step = max(lines // part.rows, 1) * part.rows
            begin = data.top + (start - data.top) // step * step
            for strip in range(begin, end, step):
                upper, lower = max(strip, start), min(strip + step, end)
                pixels = self._pixels(file, part, first, last, upper, lower, is_whole=is_whole)
                rows = slice(upper - display.top - top, lower - display.top - top)
                for channel in range(first, last):
                    if part.order[channel] in together:
                        found = maps[part.name, part.order[channel]]
                        found[rows, target] = pixels[:, source, channel - first]
        return maps

    def _pixels(
        self,
        file: Any,
        part: Part,
        first: int,
        last: int,
        top: int,
        bottom: int,
        *,
        is_whole: bool = False,
    ) -> NDArray[Any]:
        """`[bottom - top, W, last - first]` of the data window."""
        oiio = openimageio()
        kind = oiio.UINT32 if is_whole else oiio.FLOAT
        data, above = part.data, 0
        if part.tile is None:
            pixels = file.read_scanlines(part.number, 0, top, bottom, 0, first, last, kind)
        else:
            above = (top - data.top) % part.tile[1]
            end = min(data.bottom, data.top + -(-(bottom - data.top) // part.rows) * part.rows)
            pixels = file.read_tiles(
                *(part.number, 0, data.left, data.right, top - above, end, 0, 1),
                *(first, last, kind),
            )
        if pixels is None:
            raise _damaged(self.path, error_of(file))
        return pixels[above : above + bottom - top]


def channel_keys(parts: Mapping[str, Iterable[str]]) -> list[tuple[str, str, str]]:
    """(key, part, channel) of all channels of the parts; see `ExrFile`."""
    owners = Counter(channel for channels in parts.values() for channel in channels)
    keys = []
    for part, channels in parts.items():
        shared = any(owners[channel] > 1 for channel in channels)
        keys += [(f"{part}.{c}" if shared else c, part, c) for c in channels]
    return keys


def _opened(path: str | os.PathLike[str]) -> AbstractContextManager[Any]:
    return opened(path, lambda reason: _damaged(path, reason))


def _damaged(path: str | os.PathLike[str], reason: str) -> InputError:
    return InputError(
        f"{path}: truncated or damaged, or of an unknown kind; expected a whole OpenEXR file "
        f"({reason})"
    )


def _check_magic(path: str | os.PathLike[str]) -> None:
    try:
        check_seekable(path)
        with open(path, "rb") as file:
            start = file.read(4)
    except OSError as error:
        raise InputError(
            f"{path}: expected an OpenEXR file, got an error: {error.strerror}"
        ) from None
    if start != _MAGIC:
        raise InputError(f"{path}: expected an OpenEXR file, got one that starts with {start!r}")


def _parts_of(path: str | os.PathLike[str], file: Any) -> Iterator[Part]:
    for number in range(max(1, file.spec().get_int_attribute("oiio:subimages", 1))):
        if not file.seek_subimage(number, 0):
            raise _damaged(path, error_of(file))
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
        )


def _check_part(path: str | os.PathLike[str], part: Part, at_once: bool) -> None:
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


def _spans(part: Part, names: set[str]) -> Iterator[tuple[set[str], int, int]]:
    """Channels of `names` that are decoded in one call, the first and the one after the last by
    OpenImageIO's count. What lies between is decoded, too: every call decompresses all channels.

    Whole numbers come by themselves: as floats they would be shares of 2³² − 1.
    """
    whole = {name for name in names if part.channels[name] == "uint"}
    for together in (names - whole, whole):
        places = [number for number, name in enumerate(part.order) if name in together]
        if places:
            yield together, places[0], places[-1] + 1
