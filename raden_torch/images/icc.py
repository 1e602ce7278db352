"""ICC profiles of matrix and curves (ICC.1:2022), at 16 bits; of tables: `lookup_profile.py`."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.colorimetry import bradford, primary_matrix, xyz_of_white

Curve = Callable[[Floats], Floats]

ICC_WHITE = (0.9642, 1.0, 0.8249)
"""XYZ of the white that profiles are adapted to (D50), as ICC.1 rounds it."""


@dataclass(frozen=True)
class IccProfile:
    """A profile's colours.

    Attributes:
        curves: stored 0…1 → linear 0…1, one for grey, or one each for red, green and blue.
        to_xyz: `[3, 3]`, linear RGB → XYZ under `ICC_WHITE`; None for grey.
    """

    curves: tuple[Curve, ...]
    to_xyz: Floats | None


class UnknownProfile(ValueError):
    """Says what a profile is, where it is neither grey nor RGB with matrix and curves."""


def has_lookup_tables(data: bytes) -> bool:
    """Whether an RGB profile has them: they come before its matrix (ICC.1:2022, 8.3 and 9.1)."""
    return data[16:20] == b"RGB " and bool(_tags(data).keys() & {b"A2B0", b"A2B1"})


def parse_icc(data: bytes) -> IccProfile:
    """The curves and the matrix of a grey or RGB profile.

    Raises:
        UnknownProfile: of another colour space, grey of lookup tables alone, or damaged.
    """
    try:
        space = data[16:20].decode("latin-1").strip()
        if data[36:40] != b"acsp":
            raise UnknownProfile("a damaged profile")
        tags = _tags(data)
        if space == "GRAY" and b"kTRC" in tags:
            return IccProfile((_curve(tags[b"kTRC"]),), None)
        wanted = [bytes([c]) + rest for rest in (b"XYZ", b"TRC") for c in b"rgb"]
        if space != "RGB" or not tags.keys() >= set(wanted):
            raise UnknownProfile(f"{space or 'an unnamed'} profile of lookup tables")
        columns = [_numbers(tags[name], 8, 3) for name in wanted[:3]]
        return IccProfile(tuple(_curve(tags[name]) for name in wanted[3:]), np.stack(columns, 1))
    except (struct.error, IndexError) as error:
        raise UnknownProfile("a damaged profile") from error


def srgb_curved_profile(name: str, chromaticities: tuple[float, ...]) -> bytes:
    """An ICC profile (version 4) of these primaries with sRGB's curve, as a parametricCurveType.

    Args:
        name: what viewers call it; ASCII.
        chromaticities: x, y of red, green, blue and white.
    """
    adapted = bradford(xyz_of_white(chromaticities[6:]), np.array(ICC_WHITE))
    columns = (adapted @ primary_matrix(chromaticities)).T
    curve = b"para" + struct.pack(">IHH", 0, 3, 0)
    curve += _fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    tags = {b"desc": _unicode(name), b"cprt": _unicode("no copyright"), b"wtpt": _xyz(*ICC_WHITE)}
    tags[b"chad"] = b"sf32" + bytes(4) + _fixed(*adapted.ravel())
    for letter, column in zip((b"r", b"g", b"b"), columns, strict=True):
        tags[letter + b"XYZ"] = _xyz(*column)
        tags[letter + b"TRC"] = curve
    places: dict[bytes, int] = {}  # the three curves are stored once
    body, start = b"", 128 + 4 + 12 * len(tags)
    directory = struct.pack(">I", len(tags))
    for tag, data in tags.items():
        if data not in places:
            places[data] = start + len(body)
            body += data + bytes(-len(data) % 4)
        directory += tag + struct.pack(">II", places[data], len(data))
    size = start + len(body)
    header = struct.pack(">I4sI4s4s4s", size, bytes(4), 0x04300000, b"mntr", b"RGB ", b"XYZ ")
    header += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp"
    header = header.ljust(68, b"\0") + _fixed(*ICC_WHITE)
    return header.ljust(128, b"\0") + directory + body


def _tags(data: bytes) -> dict[bytes, bytes]:
    try:
        (count,) = struct.unpack_from(">I", data, 128)
        entries = [struct.unpack_from(">4sII", data, 132 + 12 * k) for k in range(min(count, 200))]
    except struct.error:
        raise UnknownProfile("a damaged profile") from None
    return {name: data[start : start + size] for name, start, size in entries}


def _fixed(*numbers: float) -> bytes:
    """s15Fixed16."""
    return struct.pack(f">{len(numbers)}i", *(round(number * 65536) for number in numbers))


def _xyz(*xyz: float) -> bytes:
    return b"XYZ " + bytes(4) + _fixed(*xyz)


def _unicode(text: str) -> bytes:
    """multiLocalizedUnicodeType (ICC.1:2022, 10.15)."""
    coded = text.encode("utf-16-be")
    return b"mluc" + struct.pack(">III4sII", 0, 1, 12, b"enUS", len(coded), 28) + coded


def _numbers(tag: bytes, start: int, count: int) -> Floats:
    """s15Fixed16."""
    return np.array(struct.unpack_from(f">{count}i", tag, start), np.float64) / 65536


def _curve(tag: bytes) -> Curve:
    """A curveType or parametricCurveType (ICC.1:2022, 10.6 and 10.18)."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        table = np.array(struct.unpack_from(f">{count}H", tag, 12), np.float64)
        if count == 0:
            return lambda x: x
        if count == 1:
            gamma = float(table[0]) / 256
            return lambda x: power(x, gamma)
        places = np.linspace(0, 1, count)
        return lambda x: np.interp(x, places, table / 65535)
    if tag[:4] == b"para":
        (kind,) = struct.unpack_from(">H", tag, 8)
        if kind <= 4:
            return _parametric(kind, *_numbers(tag, 12, (1, 3, 4, 5, 7)[kind]))
    raise UnknownProfile(f"a curve of type {tag[:4]!r}")


def _parametric(kind: int, g: float, *numbers: Any) -> Curve:
    a, b, c, d, e, f = (*numbers, *(0.0,) * 6)[:6]
    if kind == 0:
        return lambda x: power(x, g)
    if kind in (1, 2):  # c is an offset; below -b/a the curve is flat
        return lambda x: power(np.maximum(a * x + b, 0), g) + c
    return lambda x: np.where(x >= d, power(a * x + b, g) + e, c * x + f)


def power(x: Floats, exponent: float) -> Floats:
    """x to the exponent; 0 below 0."""
    return np.asarray(np.maximum(x, 0) ** exponent)
