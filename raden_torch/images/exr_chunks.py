"""Which bytes of an OpenEXR file hold which rows.

OpenEXR stores pixels in independent chunks: some scan lines, or a tile. So some
rows of a large file, copied with a header that claims no more than them, are a small OpenEXR file;
and such files, one below the other, are a large one. Nothing is compressed or decompressed here.

Source: "OpenEXR File Layout" in the documentation of OpenEXR.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError

LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1)
"""Scan lines of a chunk by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44,
B44A, DWAA, DWAB, HTJ2K256, HTJ2K32, LJ2K, ZSTD."""

_MAGIC = b"\x76\x2f\x31\x01"
_TILED, _LONG_NAMES, _MULTI_PART = 0x200, 0x400, 0x1000
_TYPES = ("<u4", "<f2", "<f4")

Window = tuple[int, int, int, int]
"""left, top, right, bottom; the last two belong to it."""
Attribute = tuple[bytes, bytes, bytes]
"""name, type, value."""


@dataclass(frozen=True)
class Chunks:
    """The chunks of one part, from the top down.

    Attributes:
        version: of the file, with its flags.
        number: of the part; None in a single-part file.
        attributes: the header.
        offsets: where each chunk begins; of a tiled part the largest level's, row by row.
    """

    path: str | os.PathLike[str]
    version: int
    number: int | None
    attributes: dict[bytes, Attribute]
    offsets: NDArray[np.uint64]

    @property
    def window(self) -> Window:
        """The data window."""
        return self._window(b"dataWindow")

    @property
    def display(self) -> Window:
        """The display window."""
        return self._window(b"displayWindow")

    @property
    def tile(self) -> tuple[int, int] | None:
        """Width and height of the tiles, or None for scan lines."""
        if not self._is_tiled():
            return None
        width, height, _ = struct.unpack("<IIB", self.attributes[b"tiles"][2])
        return width, height

    @property
    def compression(self) -> int:
        return self.attributes[b"compression"][2][0]

    @property
    def lines(self) -> int:
        """Rows of a chunk."""
        return self.tile[1] if self.tile else LINES[self.compression]

    @property
    def across(self) -> int:
        """Chunks beside each other."""
        left, _, right, _ = self.window
        return -(-(right - left + 1) // self.tile[0]) if self.tile else 1

    @property
    def channels(self) -> dict[str, np.dtype[np.generic]]:
        """The type of each channel, in the order of the file."""
        data, found = self.attributes[b"channels"][2], {}
        while data[:1] not in (b"", b"\0"):
            name, _, rest = data.partition(b"\0")
            found[name.decode()] = np.dtype(_TYPES[struct.unpack_from("<i", rest)[0]])
            data = rest[16:]
        return found

    def check_whole(self) -> None:
        """Raise InputError where the table leads beyond the file, or not to the last chunk."""
        _, top, _, bottom = self.window
        end = os.stat(self.path).st_size
        if len(self.offsets) and not 0 < self.offsets.min() <= self.offsets.max() < end:
            raise self._damaged("pixels are missing")
        last = top + (int(self.offsets.argmax()) // self.across) * self.lines
        with open(self.path, "rb") as file:
            for _ in self._chunks(file, last, min(bottom, last + self.lines - 1)):
                pass

    def copied(self, to: BinaryIO, top: int, bottom: int, held: tuple[int, int]) -> None:
        """Write a file whose display window is the rows top…bottom, with the chunks that hold the
        rows `held` of them.

        Raises:
            InputError: a chunk that is missing, or is not where the table says.
        """
        left, start, right, end = self.window
        first = start + (held[0] - start) // self.lines * self.lines
        last = min(end, start + ((held[1] - start) // self.lines + 1) * self.lines - 1)
        display = self._window(b"displayWindow")
        with open(self.path, "rb") as file:
            chunks = list(self._chunks(file, first, last))
        header = self.with_windows(
            (left, first, right, last), (display[0], top, display[2], bottom)
        )
        ends = np.cumsum([len(header) + 8 * len(chunks), *(len(chunk) for chunk in chunks)])
        to.write(header)
        to.write(ends[:-1].astype("<u8").tobytes())
        to.writelines(chunks)

    def with_windows(self, data: Window, display: Window) -> bytes:
        """The magic number, the version and the header of a single part with these windows."""
        changed = dict(self.attributes)
        changed.pop(b"chunkCount", None)
        for name, window in ((b"dataWindow", data), (b"displayWindow", display)):
            changed[name] = (name, b"box2i", struct.pack("<4i", *window))
        changed[b"lineOrder"] = (b"lineOrder", b"lineOrder", b"\0")
        if self.tile:
            changed[b"tiles"] = (b"tiles", b"tiledesc", struct.pack("<IIB", *self.tile, 0))
        version = self.version & ~_MULTI_PART & ~_TILED | (_TILED if self.tile else 0)
        packed = (
            b"%s\0%s\0%s%s" % (name, kind, struct.pack("<i", len(value)), value)
            for name, kind, value in changed.values()
        )
        return _MAGIC + struct.pack("<I", version) + b"".join(packed) + b"\0"

    def mapped(self, top: int, bottom: int) -> NDArray[np.uint8] | None:
        """`[rows, bytes of a row]` of uncompressed scan lines in the file itself, if they lie in it
        one after the other; else None."""
        if self.compression != 0 or self.tile:
            return None
        offsets, before = self._between(top, bottom), self._head(0)
        left, _, right, _ = self.window
        size = (right - left + 1) * sum(kind.itemsize for kind in self.channels.values())
        steps = np.diff(offsets.astype(np.int64))
        start, stride = int(offsets[0]), before + size
        if (steps != stride).any() or start + len(offsets) * stride > os.stat(self.path).st_size:
            return None
        rows = np.memmap(self.path, np.uint8, "r", start, (len(offsets), stride))
        heads = np.ascontiguousarray(rows[:, before - 8 : before]).view("<i4")
        whole = np.array_equal(heads[:, 0], np.arange(top, bottom + 1)) and (heads[:, 1] == size)
        return rows[:, before:] if np.all(whole) else None

    def _between(self, first: int, last: int) -> NDArray[np.uint64]:
        start = self.window[1]
        return self.offsets[
            (first - start) // self.lines * self.across : ((last - start) // self.lines + 1)
            * self.across
        ]

    def _head(self, fields: int) -> int:
        """Bytes before a chunk's pixels: its part, `fields` more numbers, its row, its size."""
        return 4 * (fields + 2 + (self.number is not None))

    def _chunks(self, file: BinaryIO, first: int, last: int) -> Iterator[bytes]:
        """The chunks as those of a single part; a tile's row counted from the first one's."""
        end = os.fstat(file.fileno()).st_size
        skipped = self._head(0) - 8
        first_tile = (first - self.window[1]) // self.lines
        for index, offset in enumerate(self._between(first, last).tolist()):
            if not 0 < offset < end:
                raise self._damaged("pixels are missing")
            file.seek(offset + skipped)
            if self.tile:
                head = file.read(20)
                x, y, *level, size = struct.unpack("<5i", head) if len(head) == 20 else (-1,) * 5
                row, column = divmod(index, self.across)
                right = [x, y, *level] == [column, first_tile + row, 0, 0]
                head = struct.pack("<5i", x, row, 0, 0, size)
            else:
                head = file.read(8)
                y, size = struct.unpack("<2i", head) if len(head) == 8 else (-1, -1)
                right = y == first + index * self.lines
            if not right or not 0 <= size <= end - offset:
                raise self._damaged("a block of pixels is not where the file's table says")
            yield head + file.read(size)

    def _window(self, name: bytes) -> Window:
        left, top, right, bottom = struct.unpack("<4i", self.attributes[name][2])
        return left, top, right, bottom

    def _is_tiled(self) -> bool:
        kind = self.attributes.get(b"type", (b"", b"", b""))[2]
        return kind == b"tiledimage" if kind else bool(self.version & _TILED)

    def _damaged(self, why: str) -> InputError:
        return InputError(f"{self.path}: truncated or damaged ({why})")


def chunks_of(path: str | os.PathLike[str]) -> list[Chunks]:
    """The chunks of each part of a file whose headers OpenEXR has accepted.

    Raises:
        InputError: truncated, or a compression that is not in `LINES`.
    """
    with open(path, "rb") as file:
        version = int.from_bytes(file.read(8)[4:], "little")
        multi = bool(version & _MULTI_PART)
        headers = []
        while header := {a[0]: a for a in _attributes(file)}:
            headers.append(header)
            if not multi:
                break
        parts = []
        for number, header in enumerate(headers):
            part = Chunks(path, version, number if multi else None, header, np.empty(0, np.uint64))
            count = _chunk_count(part)
            listed = int.from_bytes(header[b"chunkCount"][2], "little") if multi else count
            left = os.fstat(file.fileno()).st_size - file.tell()
            if 8 * listed > left or listed < count:
                raise InputError(
                    f"{path}: truncated or damaged (the table of its pixels is not whole)"
                )
            table = np.frombuffer(file.read(8 * listed), "<u8")
            parts.append(replace(part, offsets=table[:count]))
    return parts


def _chunk_count(part: Chunks) -> int:
    """Of the largest level, by the header, all of which is looked at here.

    Raises:
        InputError: damaged, or a compression that is not in `LINES`.
    """
    try:
        if not part.tile and part.compression >= len(LINES):
            raise InputError(
                f"{part.path}: compression number {part.compression}, which cannot be read by "
                "rows; write it with ZIP"
            )
        (_, top, _, bottom), _, channels = part.window, part.display, part.channels
        count = -(-(bottom - top + 1) // part.lines) * part.across
    except (struct.error, ZeroDivisionError, LookupError, UnicodeDecodeError):
        channels, count = {}, 0
    if not channels or count < 1:
        raise InputError(f"{part.path}: truncated or damaged (its header is not whole)")
    return count


def _attributes(file: BinaryIO) -> Iterable[Attribute]:
    while name := _text(file):
        kind = _text(file)
        size = int.from_bytes(file.read(4), "little")
        left = os.fstat(file.fileno()).st_size - file.tell()
        yield name, kind, file.read(min(size, left))


def _text(file: BinaryIO) -> bytes:
    text = b""
    while (letter := file.read(1)) not in (b"\0", b""):
        text += letter
    return text
