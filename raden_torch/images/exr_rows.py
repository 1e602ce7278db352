"""OpenEXR files that are read and written some rows at a time, since they may exceed the memory.

Uncompressed scan lines are mapped from the file. Of other files the chunks with the rows wanted are
copied to a small temporary file, which OpenEXR decodes; writing is the same the other way round.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside
from raden_torch.images.exr import (
    MAX_PIXELS,
    MAX_VALUES,
    channel_keys,
    headers_of,
    placed,
    read_parts,
    write_arrays,
)
from raden_torch.images.exr_chunks import LINES, Chunks, chunks_of

WRITTEN_LINES = LINES[3]
"""Rows are written in multiples of these, the chunks of ZIP compression."""

Channels = dict[str, NDArray[np.float32]]


class ExrRows:
    """An OpenEXR file whose rows are read when they are asked for; the last ones are kept.

    Attributes:
        size: height and width of the display window.
        keys: (key, part, channel) of all channels, as of `exr.channel_keys`.
        pixel_aspect: width over height of a pixel, as the header says; 1 where it does not.

    Raises:
        InputError: as for `exr.read_parts`, where the limits hold for the rows read at once.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path
        self._headers = headers_of(path, by_rows=True)
        first = next(iter(self._headers.values()))
        (left, top), (right, bottom) = first["displayWindow"]
        self.size = (int(bottom - top + 1), int(right - left + 1))
        self.pixel_aspect = float(first.get("pixelAspectRatio", 1.0))
        self._top = int(top)
        names = {
            part: {channel.name: None for channel in header["channels"]}
            for part, header in self._headers.items()
        }
        self.keys = channel_keys(names)
        self._held = (0, 0)
        self._decoded: dict[str, Channels] = {}

    @property
    def may_be_whole(self) -> bool:
        """Whether all rows may be read at once."""
        height, _ = self.size
        return self.most_rows >= height

    @property
    def most_rows(self) -> int:
        """The most rows that may be read at once."""
        return min(MAX_PIXELS, MAX_VALUES // len(self.keys)) // self.size[1]

    @property
    def chunk_rows(self) -> int:
        """No fewer rows than these are decoded at once."""
        return max(part.lines for part in self._chunks.values())

    @cached_property
    def _chunks(self) -> dict[str, Chunks]:
        return dict(zip(self._headers, chunks_of(self.path), strict=True))

    def read(self, part: str, channel: str, top: int, bottom: int) -> NDArray[np.float32]:
        """`[bottom - top, W]` of the display window, whose rows count from 0; without `bottom`.

        Raises:
            InputError: truncated or damaged.
        """
        if (top, bottom) != self._held:
            self._held, self._decoded = (top, bottom), {}
        if (top, bottom) == (0, self.size[0]) and self.may_be_whole:
            self._decoded = self._decoded or read_parts(self.path)
        elif part not in self._decoded:
            mapped = self._mapped(part, channel, top + self._top, bottom + self._top - 1)
            if mapped is not None:
                return mapped
            self._decoded[part] = self._copied(part, top + self._top, bottom + self._top - 1)
        return self._decoded[part][channel]

    def _mapped(self, part: str, channel: str, top: int, bottom: int) -> NDArray[np.float32] | None:
        chunks, header = self._chunks[part], self._headers[part]
        left, first, right, last = chunks.window
        first, last = max(first, top), min(last, bottom)
        rows = chunks.mapped(first, last) if first <= last else None
        if rows is None:
            return None
        start = 0
        for name, kind in chunks.channels.items():
            size = (right - left + 1) * kind.itemsize
            if name == channel:
                pixels = rows[:, start : start + size].view(kind)
                data = ((left, first), (right, last))
                (display_left, _), (display_right, _) = header["displayWindow"]
                display = ((display_left, top), (display_right, bottom))
                return placed(pixels, {"dataWindow": data, "displayWindow": display})
            start += size
        return None

    def _copied(self, part: str, top: int, bottom: int) -> Channels:
        chunks = self._chunks[part]
        _, first, _, last = chunks.window
        if bottom < first or top > last:
            empty = np.zeros((bottom - top + 1, self.size[1]), np.float32)
            return dict.fromkeys(chunks.channels, empty)
        with _temporary_file() as copy:
            with copy.open("wb") as file:
                chunks.copied(file, top, bottom, (max(first, top), min(last, bottom)))
            try:
                ((_, decoded),) = read_parts(copy).items()
            except InputError as error:
                raise InputError(str(error).replace(str(copy), str(self.path))) from None
        return decoded


@contextmanager
def rows_written(
    path: str | os.PathLike[str], size: tuple[int, int]
) -> Iterator[Callable[[Mapping[str, NDArray[np.float16]]], None]]:
    """Yield a function that adds rows to a file of this height and width, from the top down.

    It takes `{channel: [rows, W]}`; all but the last rows in multiples of `WRITTEN_LINES`. The file
    appears when the block ends, with all its rows; it is the one that `exr.write_channels` makes.

    Raises:
        InputError: the folder does not exist, or ``path`` is a folder.
    """
    height, width = size
    display = (0, 0, width - 1, height - 1)
    starts: list[NDArray[np.uint64]] = []
    top = 0
    target = check_output(path, (".exr",))
    with written_beside(target) as temporary, temporary.open("wb") as file:

        def add(channels: Mapping[str, NDArray[np.float16]]) -> None:
            nonlocal top
            rows = len(next(iter(channels.values())))
            windows = {
                "dataWindow": ((0, top), (width - 1, top + rows - 1)),
                "displayWindow": ((0, 0), (width - 1, height - 1)),
            }
            with _temporary_file() as band:
                write_arrays(band, {"": channels}, windows, path)
                (chunks,) = chunks_of(band)
                if top == 0:
                    file.write(chunks.with_windows(display, display))
                    table = file.tell()
                    file.write(bytes(8 * -(-height // WRITTEN_LINES)))
                    starts.append(np.array([table], np.uint64))
                begin = chunks.offsets.min()
                starts.append(chunks.offsets - begin + np.uint64(file.tell()))
                with band.open("rb") as written:
                    written.seek(int(begin))
                    shutil.copyfileobj(written, file, 2**20)
            top += rows

        yield add
        if top != height:
            raise InputError(f"{path}: expected {height} rows, got {top}")
        file.seek(int(starts[0][0]))
        file.write(np.concatenate(starts[1:]).astype("<u8").tobytes())


@contextmanager
def _temporary_file() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="raden-") as folder:
        yield Path(folder) / "rows.exr"
