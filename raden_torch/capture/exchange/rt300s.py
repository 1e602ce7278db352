"""The `.xls` workbook of a J&C RT-300S goniometer (BIFF, read with xlrd).

One reading a column, over as many sheets as it takes; column A names the rows: Azimuth,
Incidence, Receive (degrees), RT (relative reflectance), X, Y, Z, then one row a wavelength from
380 nm.

Geometry, the sample's azimuth and the quantity: see `rt300s_geometry`.

**What it does not hold.** The wavelength of the lamp (650 nm, its users say; the 380 nm row then
carries a raw signal that does not follow RT), the spread of repeated readings, the stage's
rotation. X, Y, Z are used where they are filled in (taken as 100 for the diffuser, under the
file's illuminant), else wavelength rows where two or more are; neither occurs in the files seen
so far.

Source: files of ua-loft/bsdf-tools; M. Duque, "BRDF Data Collection and Post-Processing for
Various Black Paints" (2025), for the wavelength.
"""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.rt300s_geometry import LASER_NM, rt300s_measurement
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import WHITE_LEVEL, XYZ
from raden_torch.measurement.text_file import read_content, shown
from raden_torch.packages import require

MAX_BYTES = 64_000_000

_OLE2 = bytes.fromhex("d0cf11e0a1b11ae1")
_BARE_BIFF = (b"\x09\x00\x04\x00", b"\x09\x02\x06\x00", b"\x09\x04\x06\x00", b"\x09\x08")
_ANGLES = ("Azimuth", "Incidence", "Receive")
_NUMBER_CELL = 2  # xlrd.XL_CELL_NUMBER
_EMPTY_CELLS = (0, 6)  # xlrd.XL_CELL_EMPTY, XL_CELL_BLANK
_EXCEL_DAY_0 = date(1899, 12, 30)


@dataclass(frozen=True)
class _Sheet:
    """One sheet: column A's labels to row numbers, and what can be read of its cells."""

    path: Path
    sheet: Any
    rows: dict[str, int]

    def numbers(self, label: str) -> list[float | None]:
        """The row's cells from column B on; None where empty."""
        row = self.rows[label]
        cells = self.sheet.row(row)[1:]
        return [self._number(row, column, cell) for column, cell in enumerate(cells, 1)]

    def _number(self, row: int, column: int, cell: Any) -> float | None:
        if cell.ctype in _EMPTY_CELLS or cell.value == "":
            return None
        if cell.ctype != _NUMBER_CELL or not np.isfinite(cell.value):
            label = str(self.sheet.cell_value(row, 0)).strip()
            raise InputError(
                f"{self.path}: sheet {self.sheet.name!r}, cell {_column_name(column)}{row + 1}: "
                f"{label}: expected a number, got {shown(str(cell.value))}"
            )
        return float(cell.value)

    def text(self, label: str) -> str:
        """The first cell of a row as text; "" where there is none."""
        cells = self.sheet.row(self.rows[label])[1:2] if label in self.rows else []
        return str(cells[0].value).strip() if cells else ""


def recognises(head: bytes) -> bool:
    """True for any BIFF or OLE2 file: `read` says what is wrong with another workbook."""
    return head.startswith((_OLE2, *_BARE_BIFF))


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a workbook.

    Raises:
        InputError: truncated, no workbook, or not one of an RT-300S; a cell that is no number.
    """
    path = Path(path)
    sheets = _sheets(path, _workbook(path))
    azimuth, incidence, receive, rt = _readings(sheets)
    channels, percent = _values(sheets, rt, len(azimuth))
    metadata = _metadata(path, sheets[0], channels)
    return rt300s_measurement(
        path, azimuth, incidence, receive, percent, channels, metadata=metadata
    )


def _workbook(path: Path) -> Any:
    require(f"{path}: workbooks of the RT-300S", "xls")
    import xlrd

    data = read_content(path, MAX_BYTES)
    _check_sectors(path, data)
    try:
        # ragged rows: a cell far out in a sheet does not fill memory up to it
        return xlrd.open_workbook(file_contents=data, logfile=io.StringIO(), ragged_rows=True)
    except Exception as error:  # xlrd lets through whatever a broken file causes inside it
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path}: expected the whole .xls workbook that the RT-300S program saved, got a "
            f"truncated or damaged file ({why})"
        ) from None


def _check_sectors(path: Path, data: bytes) -> None:
    """Refuse an OLE2 file that ends before the last sector its allocation table uses.

    xlrd reads some of those without a word. Source: [MS-CFB] 2.2, 2.3.
    """
    if not data.startswith(_OLE2) or len(data) < 512:
        return  # xlrd says what is wrong
    sector = 1 << min(int.from_bytes(data[30:32], "little"), 16)
    table_sectors = np.frombuffer(data, "<u4", 109, 76).astype(np.int64)
    last = -1
    for place, at in enumerate(table_sectors[table_sectors < 0xFFFFFFFA]):
        begin = (int(at) + 1) * sector
        entries = np.frombuffer(data[begin : begin + sector // 4 * 4], np.uint8)
        entries = entries[: len(entries) // 4 * 4].view("<u4")
        used = np.flatnonzero(entries != 0xFFFFFFFF)
        last = max(last, int(at), *(place * (sector // 4) + used[-1:]).tolist())
    wanted = (last + 2) * sector  # the header takes the room of one
    if len(data) < wanted:
        raise InputError(
            f"{path}: expected an .xls file of {wanted} bytes or more, by its table of sectors, "
            f"got one truncated at byte {len(data)}"
        )


def _sheets(path: Path, book: Any) -> list[_Sheet]:
    sheets = []
    for sheet in book.sheets():
        if not sheet.nrows:
            continue
        labels = [sheet.row(row)[:1] for row in range(sheet.nrows)]
        rows: dict[str, int] = {}
        for row, cells in enumerate(labels):
            if cells and cells[0].ctype not in _EMPTY_CELLS:
                rows.setdefault(str(cells[0].value).strip(), row)
        missing = [name for name in (*_ANGLES, "RT") if name not in rows]
        if missing:
            raise InputError(
                f"{path}: sheet {sheet.name!r}, column A: expected a workbook of the RT-300S "
                f"(rows Azimuth, Incidence, Receive, RT), got no row named {', '.join(missing)}"
            )
        sheets.append(_Sheet(path, sheet, rows))
    if not sheets:
        raise InputError(f"{path}: expected a workbook of the RT-300S, got empty sheets")
    return sheets


def _readings(sheets: list[_Sheet]) -> tuple[Floats, Floats, Floats, Floats]:
    """Azimuth, incidence, receive (degrees) and RT, `[M]` each, of all sheets."""
    columns: list[tuple[float, ...]] = []
    for sheet in sheets:
        names = (*_ANGLES, "RT")
        rows = [sheet.numbers(name) for name in names]
        width = max(map(len, rows))
        padded = [row + [None] * (width - len(row)) for row in rows]
        for column, cells in enumerate(zip(*padded, strict=True), 1):
            if all(cell is None for cell in cells):
                continue
            for name, cell, limit in zip(names, cells, (360.0, 90.0, 360.0, np.inf), strict=True):
                _check_cell(sheet, name, column, cell, limit)
            columns.append(tuple(cell for cell in cells if cell is not None))
    if not columns:
        raise InputError(f"{sheets[0].path}: expected readings to the right of column A, got none")
    azimuth, incidence, receive, rt = np.array(columns, np.float64).T
    return azimuth, incidence, receive, rt


def _check_cell(sheet: _Sheet, name: str, column: int, value: float | None, limit: float) -> None:
    low = 0.0 if name == "Incidence" else -limit
    if value is None or not low <= value <= limit:
        wanted = "a number" if limit == np.inf else f"{low:g}…{limit:g} degrees"
        raise InputError(
            f"{sheet.path}: sheet {sheet.sheet.name!r}, cell "
            f"{_column_name(column)}{sheet.rows[name] + 1}: {name}: expected {wanted}, got "
            f"{'nothing' if value is None else f'{value:g}'}"
        )


def _values(sheets: list[_Sheet], rt: Floats, count: int) -> tuple[tuple[str, ...], Floats]:
    """Channel names and 100 RT (or XYZ) `[M, C]`: XYZ where filled in, else bands, else RT."""
    tristimulus = [_whole_row(sheets, name, count) for name in XYZ]
    if all(row is not None for row in tristimulus):
        return XYZ, np.stack([row for row in tristimulus if row is not None], axis=1)
    bands = {
        float(label): row
        for label in sheets[0].rows
        if re.fullmatch(r"[0-9]{3,4}(\.[0-9]+)?", label)
        and (row := _whole_row(sheets, label, count)) is not None
    }
    if len(bands) > 1:
        names = tuple(f"{nm:g}nm" for nm in sorted(bands))
        return names, WHITE_LEVEL * np.stack([bands[nm] for nm in sorted(bands)], axis=1)
    return (f"{LASER_NM:g}nm",), WHITE_LEVEL * rt[:, None]


def _whole_row(sheets: list[_Sheet], label: str, count: int) -> Floats | None:
    """The row's numbers over all sheets, where every reading has one."""
    if any(label not in sheet.rows for sheet in sheets):
        return None
    cells = [cell for sheet in sheets for cell in sheet.numbers(label) if cell is not None]
    return np.array(cells, np.float64) if len(cells) == count else None


def _metadata(path: Path, sheet: _Sheet, channels: tuple[str, ...]) -> Metadata:
    sample = sheet.text("Model ID") or path.stem
    other = []
    for key, label in (("method", "Method"), ("technician", "Technician")):
        if sheet.text(label):
            other.append((key, sheet.text(label)))
    day = sheet.text("Date")
    if re.fullmatch(r"[0-9]{1,6}(\.[0-9]*)?", day):
        other.append(("date", str(_EXCEL_DAY_0 + timedelta(days=int(float(day))))))
    turned = re.search(r"stage_?rotation_?([0-9]+)", path.stem, re.IGNORECASE)
    if turned:
        other.append(("stage rotation deg", f"{turned[1]}, from the name; not in the azimuth"))
    if channels != XYZ:
        note = f"the lamp's wavelength is not in the file, taken as {LASER_NM:g} nm"
        notes = (note,) if len(channels) == 1 else ()
        return Metadata(sample=sample, other=tuple(other), notes=notes)
    ten_degrees = "10" in sheet.text("Observer.")
    return Metadata(
        sample=sample,
        white=sheet.text("Illuminant.") or "D65",
        observer="CIE 1964 10 deg" if ten_degrees else "CIE 1931 2 deg",
        other=tuple(other),
    )


def _column_name(column: int) -> str:
    """A, B, … Z, AA, …: a spreadsheet's name of a column that counts from 0."""
    name = ""
    column += 1
    while column:
        column, letter = divmod(column - 1, 26)
        name = chr(ord("A") + letter) + name
    return name
