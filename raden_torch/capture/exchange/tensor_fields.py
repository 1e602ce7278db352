"""Tensor files: named arrays in one file, as Mitsuba 3 and pbrt-v4 read them.

Little-endian. `tensor_file` and a zero byte, version (1, 0), the number of fields (uint32); for
each field its name's length (uint16), its name, the number of its dimensions (uint16), its type
(uint8), where its data begin in the file (uint64), and its shape (uint64 each). Then the data, in C
order.
Source: the readers, Mitsuba's src/core/tensor.cpp and pbrt-v4's src/pbrt/bxdfs.cpp.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError, why
from raden_torch.files import written_beside

MAGIC = b"tensor_file\0"
TYPES = ("", "u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8")
MOST_BYTES = 2**30
_MOST_FIELDS, _MOST_SIDES = 64, 16
_ALIGNED = 8


def write_fields(path: Path, fields: Mapping[str, NDArray[Any]]) -> int:
    """Write arrays of the types in `TYPES`; returns the file's size in bytes.

    Raises:
        InputError: they are more than `MOST_BYTES`, or the file cannot be written.
    """
    arrays = {name: np.ascontiguousarray(a) for name, a in fields.items()}
    heads = [(name.encode(), a, TYPES.index(a.dtype.str.lstrip("|"))) for name, a in arrays.items()]
    end = 18 + sum(13 + len(name) + 8 * a.ndim for name, a, _ in heads)
    total = end + sum(a.nbytes + _ALIGNED for a in arrays.values())
    if total > MOST_BYTES:
        raise InputError(f"{path}: expected at most {MOST_BYTES} bytes, got {total}")
    table, data = [MAGIC, bytes((1, 0)), struct.pack("<I", len(heads))], []
    for name, a, kind in heads:
        padding = -end % _ALIGNED
        end += padding
        table += [struct.pack("<H", len(name)), name, struct.pack("<HBQ", a.ndim, kind, end)]
        table.append(struct.pack(f"<{a.ndim}Q", *a.shape))
        data += [bytes(padding), a.tobytes()]
        end += a.nbytes
    with written_beside(path) as temporary:
        temporary.write_bytes(b"".join(table + data))
    return end


def read_fields(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a tensor file, by their names.

    Raises:
        InputError: not such a file, cut, written in the other byte order, or larger than it can be.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise InputError(f"{path}: expected at most {MOST_BYTES} bytes, got {size}")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: expected a tensor file, got {why(error)}") from None
    try:
        return fields_in(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def fields_in(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of a tensor file, by their names.

    Raises:
        InputError: as of `read_fields`, without the file's name.
    """
    if data[: len(MAGIC)] != MAGIC:
        raise InputError("expected a tensor file, which begins with 'tensor_file'")
    try:
        return dict(_fields(data))
    except struct.error:
        raise InputError("expected a whole tensor file, got one truncated in its header") from None


def _fields(data: bytes) -> list[tuple[str, NDArray[Any]]]:
    major, minor, count = struct.unpack_from("<BBI", data, len(MAGIC))
    if (major, minor) != (1, 0):
        raise InputError(f"expected a tensor file of version 1.0, got version {major}.{minor}")
    if count > _MOST_FIELDS:
        turned = int.from_bytes(count.to_bytes(4, "little"), "big")
        if turned <= _MOST_FIELDS:
            raise InputError(
                "byte order: expected little-endian, got a count of fields that is big-endian"
            )
        raise InputError(f"fields: expected at most {_MOST_FIELDS}, got {count}")
    at, found = len(MAGIC) + 6, []
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, at)
        name = data[at + 2 : at + 2 + length].decode("utf-8", "replace")
        at += 2 + length
        sides, kind, start = struct.unpack_from("<HBQ", data, at)
        if sides > _MOST_SIDES or not 0 < kind < len(TYPES):
            raise InputError(f"field {name[:40]!r}: expected a type and a shape, got damage")
        shape = struct.unpack_from(f"<{sides}Q", data, at + 11)
        at += 11 + 8 * sides
        found.append((name, _array(data, name, TYPES[kind], start, shape)))
    return found


def _array(data: bytes, name: str, kind: str, start: int, shape: tuple[int, ...]) -> NDArray[Any]:
    count = 1
    for side in shape:  # Python's own numbers: no product wraps around
        count *= side
    needed = start + count * np.dtype(kind).itemsize
    if needed > len(data):
        raise InputError(
            f"field {name[:40]!r}: expected {' x '.join(map(str, shape))} numbers, got a file of "
            f"{len(data)} bytes: it is truncated"
        )
    return np.frombuffer(data, kind, count, start).reshape(shape)
