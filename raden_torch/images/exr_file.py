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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.images.exr_header import (
    MAX_PIXELS,
    MAX_VALUES,
    Part,
    check_magic,
    check_part,
    damaged,
    parts_of,
)
from raden_torch.images.openimageio import error_of, opened, openimageio

_STRIP = 1 << 19
"""Values that are decoded in one call, which fit a processor's cache."""

Key = tuple[str, str]
"""Part and channel."""
Maps = dict[Key, NDArray[np.float32]]


class ExrFile:
    """An OpenEXR file whose rows are read when they are asked for; the last ones are kept.

    Attributes:
        parts: by their names.
        size: height and width of the display window, which all parts share.
        keys: (key, part, channel) of all channels: the key is the channel's name, in a multi-part
            file "part.name" for each channel of a part that shares a name with another part.

    Args:
        at_once: all channels will be read whole: a file beyond `MAX_PIXELS` or `MAX_VALUES` is
            refused. Otherwise its sides may be `exr_header.MAX_SIDE`.

    Raises:
        InputError: not an OpenEXR file, or damaged; deep or subsampled; parts of one name, or with
            different display windows; windows that are too large or too empty. Nothing but the
            header has been read.
    """

    def __init__(self, path: str | os.PathLike[str], *, at_once: bool = False) -> None:
        self.path = path
        check_magic(path)
        self.parts: dict[str, Part] = {}
        with _opened(path) as file:
            for part in parts_of(path, file):
                if part.name in self.parts:
                    raise InputError(
                        f"{path}: expected a different name for each part, got {part.name!r} twice"
                    )
                check_part(path, part, at_once)
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
            raise damaged(self.path, error_of(file))
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
    return opened(path, lambda reason: damaged(path, reason))


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
