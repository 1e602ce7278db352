"""The colour space of a picture, written into an encoded PNG or JPEG."""

from __future__ import annotations

import struct
import zlib

from raden_torch.colorimetry import DISPLAY_P3
from raden_torch.images.icc import srgb_curved_profile

_SPACES = {"Display P3": (DISPLAY_P3, 12)}
"""Name → chromaticities, and the number of the primaries in ITU-T H.273."""
_SRGB_CURVE = 13
_AFTER_IHDR = 8 + 25


def with_space(encoded: bytes, name: str) -> bytes:
    """A PNG with cICP and iCCP (PNG, third edition), or a JPEG with an ICC profile in APP2.

    Readers that know cICP take it; the others take the profile, which says the same.
    """
    chromaticities, primaries = _SPACES[name]
    profile = srgb_curved_profile(name, chromaticities)
    if encoded[:2] == b"\xff\xd8":
        data = b"ICC_PROFILE\0\x01\x01" + profile
        segment = b"\xff\xe2" + struct.pack(">H", len(data) + 2) + data
        place = _after_app0(encoded)
        return encoded[:place] + segment + encoded[place:]
    chunks = _chunk(b"cICP", bytes((primaries, _SRGB_CURVE, 0, 1)))
    chunks += _chunk(b"iCCP", name.encode("latin-1") + b"\0\0" + zlib.compress(profile))
    return encoded[:_AFTER_IHDR] + chunks + encoded[_AFTER_IHDR:]


def _after_app0(jpeg: bytes) -> int:
    if jpeg[2:4] != b"\xff\xe0":
        return 2
    (length,) = struct.unpack_from(">H", jpeg, 4)
    return 4 + int(length)


def _chunk(kind: bytes, data: bytes) -> bytes:
    checked = kind + data
    return struct.pack(">I", len(data)) + checked + struct.pack(">I", zlib.crc32(checked))
