"""Text measurement files: lines and numbers, read with errors that say where, and written."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.files import written_beside
from raden_torch.measurement import Metadata
from raden_torch.measurement.text_file import UTF_8, read_text, shown

MAX_BYTES = 100_000_000
"""Larger text files are refused before they are read."""
_SIMULATED = "simulated "

MAX_WRITTEN = 6_000_000
"""Values of a text file that is written: `MAX_BYTES` hold them."""


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


def check_values(path: Path, shape: Sequence[int], channels: int) -> None:
    """Refuse a file with more than `MAX_WRITTEN` values, before memory is taken for them.

    Raises:
        InputError: names the file and its shape.
    """
    if math.prod(shape) * channels > MAX_WRITTEN:
        raise InputError(
            f"{path}: expected at most {MAX_WRITTEN} values, got "
            f"{' x '.join(map(str, (*shape, channels)))}; a larger `step_deg` makes fewer"
        )


def digits(row: NDArray[np.float64]) -> str:
    """Numbers with nine significant digits, between tabs."""
    return "\t".join([f"{value:.9g}" for value in row.tolist()])


def title(metadata: Metadata) -> str:
    """The sample's name on one line, which says what is simulated."""
    name = " ".join(metadata.sample.split()) or "sample"
    is_said = not metadata.simulated or name.lower().startswith(_SIMULATED)
    return name if is_said else f"{_SIMULATED}{name}"


def named(text: str, otherwise: str) -> Metadata:
    """What a sample's name says, as `title` wrote it."""
    name = " ".join(text.split()).strip('"') or otherwise
    simulated = name.lower().startswith(_SIMULATED)
    return Metadata(name[len(_SIMULATED) :] if simulated else name, simulated=simulated)


def stated_nm(text: str) -> float | None:
    """The wavelength that a text names: after "wavelength", else the last one."""
    number_nm = r"\b([0-9]{3,5}(?:\.[0-9]+)?)\s*nm\b"
    said = re.search(r"wavelength\W+" + number_nm, text, re.IGNORECASE)
    found = [said[1]] if said else re.findall(number_nm, text)
    return float(found[-1]) if found else None


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """A UTF-8 file with these lines, whole or not there."""
    with written_beside(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(f"{line}\n" for line in lines)


@dataclass
class Words:
    """A text file word by word, wherever its lines break, with the line that each stands on.

    Attributes:
        comments: the lines that were left out.
        line: of the last word that was read, from 1.
    """

    path: Path
    words: list[str]
    lines: list[int]
    comments: str = ""
    at: int = 0
    line: int = 1

    @classmethod
    def of(cls, path: Path, *, comments: str | None = None, begin: int = 0) -> Words:
        """The words from the line of index `begin` on.

        Args:
            comments: what a line begins with that is left out.

        Raises:
            InputError: as of `read_lines`.
        """
        words: list[str] = []
        numbers: list[int] = []
        left_out: list[str] = []
        for index, line in enumerate(read_lines(path)):
            if comments and line.lstrip().startswith(comments):
                left_out.append(line)
            if index < begin or (comments and line.lstrip().startswith(comments)):
                continue
            own = line.split()
            words += own
            numbers += [index + 1] * len(own)
        return cls(path, words, numbers, "\n".join(left_out))

    @property
    def left(self) -> int:
        """How many words are left."""
        return len(self.words) - self.at

    def next(self, wanted: str) -> str:
        if not self.left:
            raise InputError(
                f"{self.path}: expected {wanted}, got the end of the file: it is truncated"
            )
        self.line = self.lines[self.at]
        self.at += 1
        return self.words[self.at - 1]

    def one_of(self, what: str, allowed: tuple[str, ...]) -> str:
        word = self.next(f"{what} {' or '.join(allowed)}")
        if word not in allowed:
            raise InputError(
                f"{self.path}: line {self.line}: {what}: expected {' or '.join(allowed)}, got "
                f"{shown(word)}"
            )
        return word

    def count(self, what: str, highest: int) -> int:
        word = self.next(f"a number of {what}")
        return whole_number(self.path, self.line, what, word, highest)

    def number(self, what: str, low: float, high: float) -> float:
        word = self.next(f"a number of {what}")
        value = number(self.path, self.line, what, word)
        if not low <= value <= high:
            raise InputError(
                f"{self.path}: line {self.line}: {what}: expected {low:g}…{high:g}, got {value:g}"
            )
        return value

    def numbers(self, count: int, what: str) -> NDArray[np.float64]:
        """`[count]`."""
        if count > self.left:
            raise InputError(
                f"{self.path}: line {self.line}: expected {count} {what}, got {self.left} words "
                "to the end of the file: it is truncated"
            )
        found = self.words[self.at : self.at + count]
        try:
            values = np.array(found, np.float64)
        except ValueError:
            values = np.full(count, np.nan)
        if not np.isfinite(values).all():
            for place, word in enumerate(found, self.at):
                number(self.path, self.lines[place], what, word)
        self.at += count
        self.line = self.lines[self.at - 1]
        return values
