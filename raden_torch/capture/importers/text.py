"""Reading text measurement files: lines and numbers, with errors that say where."""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.measurement.text_file import UTF_8, read_text, shown

MAX_BYTES = 100_000_000
"""Larger text files are refused before they are read."""


def first_lines(head: str, count: int = 40) -> list[str]:
    """The first lines of a text that hold anything."""
    return [line.strip() for line in head.split("\n") if line.strip()][:count]


def read_lines(path: Path) -> list[str]:
    """The lines of a text file, whatever ends them (LF, CR LF or CR).

    A warning says where the encoding was not UTF-8.

    Raises:
        InputError: the file is too large, or no text (`measurement.text_file`).
    """
    file = read_text(path, MAX_BYTES)
    if file.encoding != UTF_8:
        warnings.warn(f"{path}: read as {file.encoding}", stacklevel=4)
    return file.text.split("\n")


def number(path: Path, line: int, column: int | str, text: str) -> float:
    """A finite number; `line` and `column` count from 1 and are what the message names."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{path}: line {line}, column {column}: expected a number, got {shown(text)}"
        )
    return value


def whole_number(path: Path, line: int, name: str, text: str, highest: int) -> int:
    """A count that the file claims, 1…`highest`: checked before any memory is taken for it."""
    if not re.fullmatch(r"[0-9]{1,18}", text) or not 1 <= int(text) <= highest:
        raise InputError(
            f"{path}: line {line}: {name}: expected a whole number 1…{highest}, got {shown(text)}"
        )
    return int(text)
