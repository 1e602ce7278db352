"""TIFF tags of raw files: EXIF, and what a DNG asks for that LibRaw leaves to others."""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.packages import require

_DNG_VERSION = 50706
_MOSAICS = (32803, 34892)
_STARTS = {b"II": ("<", b"II*\0"), b"MM": (">", b"MM\0*")}
_OPCODE_LISTS = {51008: "OpcodeList1", 51009: "OpcodeList2", 51022: "OpcodeList3"}
_OPCODES = {
    1: "WarpRectilinear",
    2: "WarpFisheye",
    3: "FixVignetteRadial",
    4: "FixBadPixelsConstant",
    5: "FixBadPixelsList",
    6: "TrimBounds",
    7: "MapTable",
    8: "MapPolynomial",
    9: "GainMap",
    10: "DeltaPerRow",
    11: "DeltaPerColumn",
    12: "ScalePerRow",
    13: "ScalePerColumn",
    14: "WarpRectilinear2",
}
"""DNG 1.7, chapter 7."""
_MAP_POLYNOMIAL, _LOSSY = 8, 34892
_CHANGES_LIGHT = (7, 8, 10, 11, 12, 13)
_MOST_DIRECTORIES = 20


@dataclass(frozen=True)
class RawTags:
    """What a TIFF-like raw file says; empty where it is another format.

    Attributes:
        first: tags of its first directory, with EXIF's.
        raw: those of the directory that has the mosaic, of a DNG.
    """

    first: Mapping[int, Any]
    raw: Mapping[int, Any]

    @property
    def is_dng(self) -> bool:
        return _DNG_VERSION in self.first

    @property
    def notes(self) -> tuple[str, ...]:
        """What the file asks for, and is not done."""
        lists = [
            f"{name} {', '.join(dict.fromkeys(_OPCODES.get(n, str(n)) for n in numbers))}"
            for tag, name in _OPCODE_LISTS.items()
            if (numbers := self._asked((tag,)))
        ]
        return (f"not applied: the DNG's {'; '.join(lists)}",) if lists else ()

    def check(self, path: str | os.PathLike[str]) -> None:
        """Raise InputError where LibRaw would not make linear values of the file."""
        if not self.is_dng:
            return
        if np.ravel(self.raw.get(339, 1))[0] == 3:
            raise InputError(
                f"{path}: expected whole numbers, got a DNG of floats; save it as a linear 16-bit "
                "TIFF"
            )
        repeat = np.ravel(self.raw.get(50713, (1, 1)))
        varies = any(np.any(np.ravel(self.raw.get(tag, 0))) for tag in (50715, 50716))
        if varies or repeat.max() > 2:
            raise InputError(
                f"{path}: expected a black level of 2 x 2 cells at most, got one that varies from "
                "row to row or cell to cell; convert it to a linear DNG"
            )
        asked = [_OPCODES[n] for n in self._asked((51008, 51009)) if n in _CHANGES_LIGHT]
        if asked:
            raise InputError(
                f"{path}: expected values that are linear light, got a DNG that asks for "
                f"{', '.join(dict.fromkeys(asked))} first; convert it to a linear DNG"
            )

    def black(self, top: int, left: int) -> Floats | None:
        """`[2, 2]` black levels of a DNG's mosaic at and behind a pixel; None where it says none.

        LibRaw's are whole numbers, and one column or row off where the active area has odd margins.
        """
        try:
            rows, columns = (int(n) for n in np.ravel(self.raw.get(50713, (1, 1))))
            levels = np.array([float(v) for v in np.ravel(self.raw[50714])]).reshape(rows, columns)
            first_row, first_column = (int(n) for n in np.ravel(self.raw.get(50829, (0, 0)))[:2])
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            return None
        down = (np.arange(2) + top - first_row) % rows
        right = (np.arange(2) + left - first_column) % columns
        found = levels[down[:, None], right]
        return found if np.isfinite(found).all() else None

    def _asked(self, lists: tuple[int, ...]) -> list[int]:
        """The opcodes that LibRaw leaves out: it follows the polynomials of lossy DNGs."""
        is_lossy = self.raw.get(259) == _LOSSY
        numbers = [n for tag in lists for n in _opcodes(self.raw.get(tag))]
        return [n for n in numbers if not (is_lossy and n == _MAP_POLYNOMIAL)]

    def with_defaults(self, found: Mapping[int, Any]) -> dict[int, Any]:
        """The tags, and what another reader found where the file's own have nothing."""
        own = {tag: value for tag, value in self.first.items() if value not in ("", 0, None)}
        return {**found, **own}


def read_raw_tags(path: str | os.PathLike[str]) -> RawTags:
    """The tags of a file that has TIFF's structure, whatever its first bytes are called.

    A damaged file has those that could be read: LibRaw decides what it is.
    """
    require("camera raw files", "raw")
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    found: list[dict[int, Any]] = []
    try:
        with warnings.catch_warnings(), open(path, "rb") as file:
            warnings.simplefilter("ignore")  # damaged tags
            start = file.read(8)
            if start[:2] not in _STARTS:
                return RawTags({}, {})
            order, magic = _STARTS[start[:2]]
            places, seen = [struct.unpack(order + "I", start[4:])[0]], {0}
            while places and len(found) < _MOST_DIRECTORIES:
                place = places.pop(0)
                if place in seen:
                    continue
                seen.add(place)
                directory = ImageFileDirectory_v2(magic + start[4:])
                file.seek(place)
                directory.load(file)
                tags = dict(directory)
                found.append(tags)
                inner = [tags.get(34665, 0), *np.ravel(tags.get(330, 0))]
                places += [int(p) for p in (*inner, directory.next)]
    except (OSError, SyntaxError, ValueError, TypeError, KeyError, IndexError, struct.error):
        pass
    raw = next((tags for tags in found if tags.get(262) in _MOSAICS), {})
    exif = next((tags for tags in found if 33434 in tags or 33437 in tags), {})
    first = found[0] if found else {}
    return RawTags({**exif, **first}, raw)


def has_dng_version(start: bytes) -> bool:
    """Whether a file that begins so is a DNG, as far as its first directory is in it."""
    if start[:4] not in (b"II*\0", b"MM\0*"):
        return False
    order, _ = _STARTS[start[:2]]
    try:
        (place,) = struct.unpack_from(order + "I", start, 4)
        (count,) = struct.unpack_from(order + "H", start, place)
        numbers = (struct.unpack_from(order + "H", start, place + 2 + 12 * k) for k in range(count))
        return (_DNG_VERSION,) in numbers
    except struct.error:
        return False


def _opcodes(data: Any) -> list[int]:
    """The numbers in an opcode list (big-endian in every file); none in a damaged one."""
    if not isinstance(data, bytes) or len(data) < 4:
        return []
    numbers, place = [], 4
    for _ in range(min(int.from_bytes(data[:4], "big"), 1000)):
        if place + 16 > len(data):
            break
        number, _, _, length = struct.unpack_from(">IIII", data, place)
        numbers.append(int(number))
        place += 16 + length
    return numbers
