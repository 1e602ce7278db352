"""A table of numbers in a text file, as spreadsheets of various locales save it.

    sep=;                                             Excel's hint, where it is there
    # comments
    incidence_deg;receiving_deg;tilt_deg;X;Y;Z        names: see `column_names`
    0;-70;−70;19,4706;20,0899;"19,1346"               numbers: see `csv_rows`

The separator is a comma, a semicolon or a tab: the one by which the line of names gives the wanted
columns. Every row must have as many cells. Empty columns at the end, and lines of empty cells, are
passed over. Cells in double quotes may hold separators, but no line ends. Encodings and gzip: see
`text_file`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.measurement import csv_rows
from raden_torch.measurement.column_names import own_name
from raden_torch.measurement.csv_rows import BLANK, cells_of
from raden_torch.measurement.text_file import UTF_8, read_text

SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab"}

_HINT = re.compile(r'"?sep=(.)"?[,;\t ]*', re.IGNORECASE)


@dataclass(frozen=True)
class CsvHeading:
    """The lines above the rows.

    Attributes:
        comments: the lines that begin with #.
        names: the line of column names; empty where the text has none.
        number: its number, from 1.
        end: where in the text the next line begins.
        hint: the separator that a first line `sep=` names, or "".
    """

    comments: tuple[str, ...]
    names: str
    number: int
    end: int
    hint: str


@dataclass(frozen=True)
class CsvTable:
    """A file's comments and columns, and its rows as text.

    Attributes:
        path: the file.
        encoding: what its text was taken for.
        comments: the texts behind # above the names.
        written: the columns' names as they are in the file.
        columns: the same, by the project's names where it knows them.
        separator: one of `SEPARATORS`.
        body: the text below the names.
        first_line: the number of its first line, from 1.
    """

    path: Path
    encoding: str
    comments: tuple[str, ...]
    written: tuple[str, ...]
    columns: tuple[str, ...]
    separator: str
    body: str
    first_line: int

    def numbers(
        self, names: Sequence[str] | None = None, *, may_be_empty: Collection[str] = ()
    ) -> NDArray[np.float64]:
        """`[M, columns]`, of all columns or the named ones; NaN for empty cells where allowed.

        One warning says what was assumed of the file, if anything was.

        Raises:
            InputError: names line and column of what is not a number; rows of another length.
        """
        wanted = self.columns if names is None else tuple(names)
        table, decimal_commas = csv_rows.read(self, wanted, may_be_empty)
        assumed = self._assumed(decimal_commas)
        if assumed:
            warnings.warn(f"{self.path}: read as {assumed}", stacklevel=4)
        return table

    def _assumed(self, decimal_commas: bool) -> str:
        parts = [] if self.encoding == UTF_8 else [self.encoding]
        if self.separator != ",":
            commas = " with decimal commas" if decimal_commas else ""
            parts.append(f"{SEPARATORS[self.separator]}-separated{commas}")
        names = zip(self.written, self.columns, strict=True)
        renamed = [(written, own) for written, own in names if written != own]
        if renamed:
            before, after = (", ".join(column[:8]) for column in zip(*renamed, strict=True))
            parts.append(f"columns {before} as {after}")
        return ", ".join(parts)


def find_heading(text: str) -> CsvHeading:
    """The comments and the line of column names at the beginning of a text."""
    comments, hint, at, number = [], "", 0, 0
    while at < len(text):
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        line, at, number = text[at:end], end + 1, number + 1
        stated = _HINT.fullmatch(line.strip(" ")) if number == 1 else None
        if stated:
            hint = stated[1]
        elif line.lstrip(' "').startswith("#"):
            comments.append(line.strip())
        elif line.strip(BLANK):
            return CsvHeading(tuple(comments), line, number, min(at, len(text)), hint)
    return CsvHeading(tuple(comments), "", number, len(text), hint)


def open_table(path: Path, limit: int, wanted: Sequence[str]) -> CsvTable:
    """The table of a file of at most `limit` bytes; `wanted` columns tell its separator.

    Columns that are missing are the caller's to refuse.

    Raises:
        InputError: what `read_text` refuses; no line of names; a name twice, whatever its case; a
            line `sep=` that contradicts the names.
    """
    file = read_text(path, limit)
    heading = find_heading(file.text)
    if not heading.names:
        raise InputError(f"{path}: expected columns {','.join(wanted)}, got an empty file")
    separator, written = _separated(path, heading, wanted)
    columns = tuple(map(own_name, written))
    _check_each_once(path, heading.number, columns)
    return CsvTable(
        path,
        file.encoding,
        _comment_texts(heading.comments, separator),
        written,
        columns,
        separator,
        file.text[heading.end :],
        heading.number + 1,
    )


def _separated(
    path: Path, heading: CsvHeading, wanted: Sequence[str]
) -> tuple[str, tuple[str, ...]]:
    """The separator, and the names without the empty ones at the end."""
    splits: dict[str, tuple[str, ...]] = {}
    for separator in SEPARATORS:
        cells = cells_of(heading.names, separator) or []
        names = [" ".join(cell.split()) for cell in cells]
        while names and not names[-1]:
            names.pop()
        splits[separator] = tuple(names)
    fitting = [s for s in splits if {*wanted} <= {*map(own_name, splits[s])}]
    stated = heading.hint
    if stated and (stated not in splits or (fitting and stated not in fitting)):
        found = SEPARATORS[fitting[0]] if fitting else "a comma, semicolon or tab"
        raise InputError(
            f"{path}: line 1: sep={stated}: expected the separator of the columns, {found}"
        )
    best = stated or (fitting or sorted(splits, key=lambda s: -len(splits[s])))[0]
    if not splits[best]:
        raise InputError(
            f"{path}: line {heading.number}: expected column names, got a quote that is not closed"
        )
    return best, splits[best]


def _check_each_once(path: Path, line: int, columns: Sequence[str]) -> None:
    seen = set()
    for column in columns:
        if column and column.casefold() in seen:
            raise InputError(
                f"{path}: line {line}: expected each column once, got {column[:40]} twice "
                "(upper and lower case count as one)"
            )
        seen.add(column.casefold())


def _comment_texts(lines: Sequence[str], separator: str) -> tuple[str, ...]:
    """What the comments say; a spreadsheet fills all of them up with empty cells, and quotes."""
    filled_up = all(line.endswith((separator, '"')) for line in lines)
    texts = []
    for line in lines:
        cells = cells_of(line, separator) if line.startswith('"') else None
        text = separator.join(cells) if cells else line
        texts.append((text.rstrip(separator) if filled_up else text).lstrip(' "')[1:].strip())
    return tuple(text for text in texts if text)
