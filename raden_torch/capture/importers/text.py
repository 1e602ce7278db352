"""Reading text measurement files: lines and numbers, with errors that say where."""

from __future__ import annotations

import math
import re
from pathlib import Path

from raden_torch.errors import InputError

MAX_BYTES = 100_000_000
"""Larger text files are refused before they are read."""


def first_lines(head: bytes, count: int = 40) -> list[str]:
    """The first lines of a file that hold anything; none where it is not text."""
    if b"\0" in head:
        return []
    lines = re.split(r"\r\n|\r|\n", head.decode("utf-8", "replace").lstrip("\ufeff"))
    return [line.strip() for line in lines if line.strip()][:count]


def read_lines(path: Path) -> list[str]:
    """The lines of a UTF-8 text file, whatever ends them (LF, CR LF or CR).

    Raises:
        InputError: the file is too large, or holds bytes that are not UTF-8.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{path}: {size / 1e6:.0f} MB; at most {MAX_BYTES / 1e6:g} MB are read")
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        line = before.count(b"\n") + 1
        raise InputError(
            f"{path}: line {line}: byte 0x{data[error.start]:02x} is not UTF-8; "
            "this format is read as UTF-8 (or ASCII), save it so"
        ) from None
    return re.split(r"\r\n|\r|\n", text)


def number(path: Path, line: int, column: int | str, text: str) -> float:
    """A finite number; `line` and `column` count from 1 and are what the message names."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}: line {line}, column {column}: {shown(text)} is not a number")
    return value


def whole_number(path: Path, line: int, name: str, text: str, highest: int) -> int:
    """A count that the file claims, 1…`highest`: checked before any memory is taken for it."""
    if not re.fullmatch(r"[0-9]{1,18}", text) or not 1 <= int(text) <= highest:
        raise InputError(
            f"{path}: line {line}: {name} = {shown(text)}; a whole number 1…{highest} was wanted"
        )
    return int(text)


def shown(text: str) -> str:
    """A piece of a file, quoted and shortened, fit for a one-line message."""
    return repr(text if len(text) <= 40 else f"{text[:37]}…")
