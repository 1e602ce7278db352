"""The rows of a `csv_table` → numbers.

**Decimal comma.** Where the separator is no comma and no number of the file has a point. In a table
with tabs, at least one comma must not look like a thousands separator ("1,234" does, "0,123" and
"12,34" do not); semicolons are there because the comma is taken. Thousands separators are refused.

`−`, full-width digits and no-break spaces around a number are read. A comment may stand behind a
row. A spreadsheet's error cells ("#N/A") are neither comments nor numbers.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.measurement.text_file import shown

if TYPE_CHECKING:
    from raden_torch.measurement.csv_table import CsvTable

BLANK = ',;\t "\u00a0'
"""What a line of empty cells is made of."""

_COMMENT = re.compile(r'("(?:[^"]|"")*")|#(?!N/A|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!|#).*')
_THOUSANDS = re.compile(r"[-+]?[1-9][0-9]{0,2}(,[0-9]{3})+")
_SIGNS = str.maketrans("−–－＋．０１２３４５６７８９", "---+.0123456789")


def cells_of(line: str, separator: str) -> list[str] | None:
    """The cells of a line; None where a quote is not closed, or ends within a cell."""
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True))
    except csv.Error:
        return None


def read(
    table: CsvTable, names: Sequence[str], may_be_empty: Collection[str]
) -> tuple[NDArray[np.float64], bool]:
    """`[M, names]`, and whether the numbers have decimal commas.

    Raises:
        InputError: names line and column of what is not a number; rows of another length; decimals
            that are ambiguous.
    """
    plain = _read_plain(table) if tuple(names) == table.columns else None
    return plain or _read_row_by_row(table, names, may_be_empty)


def _read_plain(table: CsvTable) -> tuple[NDArray[np.float64], bool] | None:
    """All columns at once; None where a look at each row is needed."""
    body, separator = table.body, table.separator
    if not body.isascii():
        body = body.translate(_SIGNS)
    decimal_commas = separator != "," and "," in body
    if decimal_commas:
        if separator == "\t" or "." in body:
            return None
        body = body.replace(",", ".")
    if not re.search(r"^[^#\n]", body, re.MULTILINE):
        return None  # nothing but comments
    try:
        values = np.loadtxt(body.split("\n"), delimiter=separator, ndmin=2, comments="#")
    except ValueError:
        return None
    return (values, decimal_commas) if values.shape[1] == len(table.columns) else None


def _read_row_by_row(
    table: CsvTable, names: Sequence[str], may_be_empty: Collection[str]
) -> tuple[NDArray[np.float64], bool]:
    places = [(name, table.columns.index(name)) for name in names]
    numbers = _Numbers(table, may_be_empty)
    values = array("d")
    for line, cells in _rows(table):
        values.extend([numbers.value(line, name, cells[place]) for name, place in places])
    numbers.check_decimals()
    return np.array(values, np.float64).reshape(-1, len(places)), bool(numbers.comma)


def _rows(table: CsvTable) -> Iterator[tuple[int, list[str]]]:
    """The number and the cells of each line that has any."""
    width = len(table.columns)
    lines = table.body.split("\n")
    for number, line in enumerate(lines, table.first_line):
        if "#" in line:
            line = "" if line.lstrip()[:1] == "#" else _COMMENT.sub(lambda m: m[1] or "", line)
        if not line.strip(BLANK):
            continue
        cells = cells_of(line, table.separator)
        if cells is None:
            raise InputError(
                f"{table.path}: line {number}: expected a closing quote, got the end of the line"
            )
        if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
            del cells[width:]
        if len(cells) != width:
            last = number == table.first_line + len(lines) - 1
            raise InputError(
                f"{table.path}: line {number}: expected {width} values, got {len(cells)}"
                + _why(table, len(cells) - width, last)
            )
        yield number, cells


def _why(table: CsvTable, surplus: int, last: bool) -> str:
    if surplus < 0:
        return "; the file is truncated" if last else ""
    if table.separator == ",":
        return "; decimal commas cannot be told from the separators, save it with semicolons"
    return ""


@dataclass
class _Numbers:
    """Cells → numbers, and what is known of the file's decimal sign so far.

    Attributes:
        comma, point: the first number with a decimal comma, and with a point: place and text.
        is_decimal: a comma was seen that cannot be a thousands separator.
    """

    table: CsvTable
    may_be_empty: Collection[str]
    comma: tuple[str, str] | None = None
    point: tuple[str, str] | None = None
    is_decimal: bool = False

    def value(self, line: int, column: str, cell: str) -> float:
        text = cell if cell.isascii() else cell.translate(_SIGNS)
        text = text.strip()
        if not text and column in self.may_be_empty:
            return float("nan")
        if self.table.separator != ",":
            text = self._with_point(line, column, text)
        try:
            if text.isascii() and "_" not in text:
                return float(text)
        except ValueError:
            pass
        raise InputError(
            f"{self._place(line, column)}: expected a number, got {shown(cell)}"
            + ("; thousands separators are not read" if _is_grouped(cell) else "")
        )

    def check_decimals(self) -> None:
        if self.comma and self.table.separator == "\t" and not self.is_decimal:
            place, text = self.comma
            raise InputError(
                f"{place}: {shown(text)} may be {text.replace(',', '.')} or "
                f"{text.replace(',', '')}; expected decimal points"
            )

    def _with_point(self, line: int, column: str, text: str) -> str:
        """The number with a decimal point; remembers which of the two it had."""
        if "," in text and "." not in text:
            self.comma = self.comma or (self._place(line, column), text)
            self.is_decimal = self.is_decimal or not _THOUSANDS.fullmatch(text)
        elif "." in text and "," not in text:
            self.point = self.point or (self._place(line, column), text)
        if self.comma and self.point:
            (first, one), (second, other) = self.comma, self.point
            raise InputError(
                f"{first}: {shown(one)} has a decimal comma, {shown(other)} in "
                f"{second.removeprefix(f'{self.table.path}: ')} a decimal point; expected one kind"
            )
        return text if "." in text else text.replace(",", ".")

    def _place(self, line: int, column: str) -> str:
        return f"{self.table.path}: line {line}, column {column}"


def _is_grouped(cell: str) -> bool:
    """Whether a number in groups of three digits is meant, as 1.234,5 or 1 234 or 1'234."""
    return bool(re.fullmatch(r"[-+]?\d{1,3}([.,\s'’]\d{3})+([.,]\d*)?", cell.strip()))
