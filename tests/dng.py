"""Digital Negatives with known values, for the tests: an uncompressed mosaic, or linear colours."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.tiff import Tag, directory

EOS_5D = (6347, -479, -972, -8297, 15954, 2480, -1968, 2131, 7649)
"""ColorMatrix2 of a camera that many know, in ten thousandths: XYZ under D65 → its RGB."""


def write_dng(
    path: Path,
    values: np.ndarray,
    *,
    pattern: str = "RGGB",
    black: Sequence[float] | float = 0,
    white: int = 65535,
    matrix: Sequence[int] | None = EOS_5D,
    neutral: Sequence[float] | None = (0.5, 1.0, 0.625),
    orientation: int = 1,
    exif: Mapping[int, Tag] | None = None,
    tags: Mapping[int, Tag] | None = None,
    order: str = "<",
) -> Path:
    """Write `[H, W]` of a mosaic or `[H, W, 3]` of linear colours, 16 bits.

    Args:
        pattern: of the pixel (0, 0) of the active area.
        black: one, or four, row by row.
        neutral: camera RGB of what is grey; None leaves the tag out.
        tags: more of the main directory, or others in place of those here; None in place of one
            leaves it out.
    """
    is_mosaic = values.ndim == 2
    height, width = values.shape[:2]
    found: dict[int, Tag | None] = {
        254: (4, 0),
        256: (4, width),
        257: (4, height),
        258: (3, [16] * (1 if is_mosaic else 3)),
        259: (3, 1),
        262: (3, 32803 if is_mosaic else 34892),
        271: (2, b"Nobody\0"),
        272: (2, b"Box 1\0"),
        274: (3, orientation),
        277: (3, 1 if is_mosaic else 3),
        278: (4, height),
        279: (4, values.size * 2),
        50706: (1, bytes((1, 4, 0, 0))),
        50707: (1, bytes((1, 1, 0, 0))),
        50708: (2, b"Nobody Box 1\0"),
        50717: (4, white if is_mosaic else [white] * 3),
    }
    if is_mosaic:
        found[33421] = (3, (2, 2))
        found[33422] = (1, bytes("RGB".index(c) for c in pattern))
    blacks = [black] if isinstance(black, (int, float)) else list(black)
    found[50713] = (3, (2, 2) if len(blacks) == 4 else (1, 1))
    found[50714] = (5, blacks)
    if matrix is not None:
        found[50721] = (10, [v / 10000 for v in matrix])
        found[50778] = (3, 21)
    if neutral is not None:
        found[50728] = (5, neutral)
    found.update(tags or {})
    path.write_bytes(_tiff(order, {k: v for k, v in found.items() if v}, exif or {}, values))
    return path


def mosaic_of(rgb: np.ndarray, pattern: str) -> np.ndarray:
    """`[H, W]` of `[H, W, 3]` seen through the filters of a Bayer pattern."""
    height, width = rgb.shape[:2]
    rows, columns = np.indices((height, width))
    cells = np.array(["RGB".index(c) for c in pattern]).reshape(2, 2)
    return rgb[rows, columns, cells[rows % 2, columns % 2]]


def opcodes(*numbers: int, optional: bool = True) -> Tag:
    """An opcode list of these, with no parameters (they are big-endian in every file)."""
    body = b"".join(struct.pack(">IIII", n, 0x01030000, int(optional), 0) for n in numbers)
    return 7, struct.pack(">I", len(numbers)) + body


def _tiff(
    order: str, tags: Mapping[int, Tag], exif: Mapping[int, Tag], values: np.ndarray
) -> bytes:
    head = struct.pack(order + "2sHI", b"II" if order == "<" else b"MM", 42, 8)
    own = dict(tags) | {273: (4, 0)} | ({34665: (4, 0)} if exif else {})
    length = len(directory(order, own, 8))
    after = directory(order, exif, 8 + length) if exif else b""
    own[273] = (4, 8 + length + len(after))
    if exif:
        own[34665] = (4, 8 + length)
    return head + directory(order, own, 8) + after + values.astype(order + "u2").tobytes()
