"""A photograph as a PNG file that says its exposure time and that it is linear."""

from __future__ import annotations

import struct
import zlib
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.files import written_beside

_EXPOSURE_TIME, _EXIF_IFD = 33434, 0x8769
_HEADER = 8 + 25  # the signature and IHDR, which come first


def write_photograph(path: Path, stored: NDArray[Any], seconds: float) -> None:
    """Write `[H, W, 3]` RGB of 8 or 16 bits with gAMA = 1 and the exposure time in EXIF.

    Pillow writes no RGB of 16 bits and OpenCV no EXIF, so the two chunks are put in here (PNG
    specification, 3rd edition, 11.3.2.2 and 11.3.4.4).
    """
    import cv2

    ok, data = cv2.imencode(".png", np.ascontiguousarray(stored[..., ::-1]))
    if not ok:
        raise RuntimeError(f"{path}: OpenCV could not encode the picture")
    png = data.tobytes()
    more = _chunk(b"gAMA", struct.pack(">I", 100_000)) + _chunk(b"eXIf", _exif(seconds))
    with written_beside(path) as temporary:
        temporary.write_bytes(png[:_HEADER] + more + png[_HEADER:])


def _exif(seconds: float) -> bytes:
    """TIFF: a directory that points to EXIF's, whose one entry is the exposure time."""
    time = Fraction(seconds).limit_denominator(1_000_000)
    first = struct.pack("<HHHIII", 1, _EXIF_IFD, 4, 1, 26, 0)
    inner = struct.pack("<HHHIII", 1, _EXPOSURE_TIME, 5, 1, 44, 0)
    numbers = struct.pack("<II", time.numerator, time.denominator)
    return struct.pack("<2sHI", b"II", 42, 8) + first + inner + numbers


def _chunk(kind: bytes, body: bytes) -> bytes:
    checked = kind + body
    return struct.pack(">I", len(body)) + checked + struct.pack(">I", zlib.crc32(checked))
