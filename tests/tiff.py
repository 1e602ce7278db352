"""TIFF files (TIFF 6.0) of known values for the tests, written out so that nothing is shared."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 10: 8, 11: 4}
_CODES = {1: "B", 2: "B", 3: "H", 4: "I", 7: "B", 11: "f"}

Tag = tuple[int, Any]
"""A TIFF type, and a value or values of it; or bytes, for the types 1, 2 and 7."""


def tiff(
    pixels: np.ndarray,
    *,
    photometric: int | None = None,
    extra: Sequence[int] = (),
    planar: bool = False,
    pages: int = 1,
    **tags: Tag,
) -> bytes:
    """An uncompressed little-endian TIFF.

    Args:
        tags: `_274=(3, [6])` and the like: type and values.
    """
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if photometric is None:
        photometric = 2 if channels - len(extra) >= 3 else 1
    stored = np.moveaxis(pixels, -1, 0) if planar else pixels
    data = stored.astype(stored.dtype.newbyteorder("<")).tobytes()
    strips = channels if planar else 1
    entries: dict[int, Tag] = {
        256: (4, [width]),
        257: (4, [height]),
        258: (3, [8 * pixels.dtype.itemsize] * channels),
        259: (3, [1]),
        262: (3, [photometric]),
        273: (4, [8 + k * len(data) // strips for k in range(strips)]),
        277: (3, [channels]),
        278: (4, [height]),
        279: (4, [len(data) // strips] * strips),
        284: (3, [2 if planar else 1]),
        339: (3, [{"u": 1, "i": 2, "f": 3}[pixels.dtype.kind]] * channels),
    }
    if extra:
        entries[338] = (3, list(extra))
    entries |= {int(name[1:]): entry for name, entry in tags.items()}
    out = b"II*\0" + struct.pack("<I", 8 + len(data)) + data
    for page in range(pages):
        out += directory("<", entries, len(out), is_last=page == pages - 1)
    return out


def directory(order: str, tags: Mapping[int, Tag], place: int, *, is_last: bool = True) -> bytes:
    """The tags and what they point to, at a place in the file; the next directory is behind it."""
    entries, body = b"", b""
    behind = place + 2 + 12 * len(tags) + 4
    for number, (kind, value) in sorted(tags.items()):
        data = _packed(order, kind, value)
        entries += struct.pack(order + "HHI", number, kind, len(data) // _SIZES[kind])
        if len(data) <= 4:
            entries += data.ljust(4, b"\0")
        else:
            entries += struct.pack(order + "I", behind + len(body))
            body += data + bytes(len(data) % 2)
    following = struct.pack(order + "I", 0 if is_last else behind + len(body))
    return struct.pack(order + "H", len(tags)) + entries + following + body


def _packed(order: str, kind: int, value: Any) -> bytes:
    if isinstance(value, bytes):
        return value
    numbers = list(np.atleast_1d(value).tolist())
    if kind in (5, 10):
        ratios = [Fraction(float(v)).limit_denominator(100_000) for v in numbers]
        pairs = [n for r in ratios for n in (r.numerator, r.denominator)]
        return struct.pack(f"{order}{len(pairs)}{'I' if kind == 5 else 'i'}", *pairs)
    return struct.pack(f"{order}{len(numbers)}{_CODES[kind]}", *numbers)
