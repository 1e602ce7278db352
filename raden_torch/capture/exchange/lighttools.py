"""The RT-300S's text export for LightTools (the layout of a STIL/Light Tec REFLET).

A block an incidence: `key : value` lines, `Theta Lighting` with the incidence, then a row a
receive angle with a value an azimuth ("Phi").

    Data file type :        Intensity BRDF
    Theta measure beginning :       -30          … end, step; Phi measure beginning, end, step
    Theta Lighting  60
    -30     value   value
    …

Angles are the instrument's own, in degrees. The values are 100 RT: the same readings in its
workbook differ by that factor, to the workbook's three digits. Hence the reflectance factor is
value/cos θ; see `rt300s_geometry`.

**What it does not hold.** BSDF in 1/sr, despite its name: there is no normalisation. Wavelength,
colour, stage rotation, spread. A block of zeros is one that was not measured. LightTools' own
BSDF files (keywords AOI, POI, Side) are another format (`lighttools_bsdf`).

Source: the export beside the workbook of the same readings in ua-loft/bsdf-tools.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from raden_torch.capture.exchange.rt300s_geometry import RtTable, measurement_of_tables
from raden_torch.capture.exchange.text import first_lines, number, read_lines
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.text_file import shown

_FIRST_KEY = "Name / Comment"
_TABLE = "Theta Lighting"
_KIND = "Intensity BRDF"
_MAX_STEPS = 100_000
_KEPT = ("Date", "Data file type", "Calibration Value", "Theta sample")


@dataclass
class _Block:
    """One block's header: keys to the line and the text of their value."""

    path: Path
    begin: int
    entries: dict[str, tuple[int, str]] = field(default_factory=dict)

    def value(self, key: str) -> tuple[int, str]:
        if key not in self.entries:
            raise InputError(
                f"{self.path}: block from line {self.begin}: expected '{key} :' before "
                f"'{_TABLE}', got none"
            )
        return self.entries[key]

    def steps(self, name: str) -> list[float]:
        """The angles from `name measure beginning` to `end` by `step`."""
        entries = [self.value(f"{name} measure {part}") for part in ("beginning", "end", "step")]
        begin, end, step = (number(self.path, at, 2, text) for at, text in entries)
        count = (end - begin) / step + 1 if step else 0.0
        if not 0.5 < count < _MAX_STEPS + 0.5 or abs(count - round(count)) > 1e-6:
            raise InputError(
                f"{self.path}: line {entries[0][0]}: {name}: expected a row of 1…{_MAX_STEPS} "
                f"angles, got {begin:g} to {end:g} by {step:g}"
            )
        if max(abs(begin), abs(end)) > 360:
            raise InputError(
                f"{self.path}: line {entries[0][0]}: {name}: expected at most 360 degrees, got "
                f"{begin:g} to {end:g}"
            )
        return [begin + i * step for i in range(round(count))]


def recognises(head: str) -> bool:
    """True where the first lines are those of the export's header."""
    lines = first_lines(head, 12)
    return bool(lines) and lines[0].startswith(_FIRST_KEY)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file.

    Raises:
        InputError: names the line and column, and what would be right.
    """
    path = Path(path)
    lines = read_lines(path)
    tables: list[RtTable] = []
    block = first = _Block(path, 1)
    at = 0
    while at < len(lines):
        cells = [cell.strip() for cell in lines[at].split("\t")]
        at += 1
        key = cells[0].removesuffix(":").strip()
        text = cells[1] if len(cells) > 1 else ""
        if key == _FIRST_KEY:
            block = _Block(path, at)
            first = first if first.entries else block
        if key == _TABLE:
            table = _table(block, lines, at, text)
            tables.append(table)
            at += len(table.receive_deg)
            block = _Block(path, at + 1)
        elif key:
            _check_entry(path, at, lines[at - 1])
            block.entries[key] = (at, text)
    if block.entries or not tables:
        raise InputError(
            f"{path}: expected the '{_TABLE}' of the block from line {block.begin}, got the end "
            "of the file: it is truncated"
        )
    other = tuple((key, first.entries[key][1]) for key in _KEPT if key in first.entries)
    sample = first.entries.get(_FIRST_KEY, (0, ""))[1]
    return measurement_of_tables(path, tables, Metadata(sample=sample or path.stem, other=other))


def _check_entry(path: Path, line: int, text: str) -> None:
    if ":" not in text:
        raise InputError(
            f"{path}: line {line}: expected a 'key : value' line or '{_TABLE}' with its rows, got "
            f"{shown(text)}"
        )


def _table(block: _Block, lines: list[str], at: int, incidence: str) -> RtTable:
    """The rows from line index `at` on."""
    path = block.path
    kind_at, kind = block.value("Data file type")
    if kind != _KIND:
        raise InputError(f"{path}: line {kind_at}: expected '{_KIND}', got {shown(kind)}")
    tilt = number(path, at, 2, incidence)
    if not 0 <= tilt <= 90:
        raise InputError(f"{path}: line {at}: {_TABLE}: expected 0…90 degrees, got {tilt:g}")
    receive, azimuth = block.steps("Theta"), block.steps("Phi")
    if len(receive) > len(lines) - at:
        raise InputError(
            f"{path}: line {at}: expected {len(receive)} rows by its header, got "
            f"{len(lines) - at} lines; the file is truncated or the header is wrong"
        )
    rows = []
    for index, angle in enumerate(receive, at):
        cells = lines[index].split()
        if len(cells) != 1 + len(azimuth):
            raise InputError(
                f"{path}: line {index + 1}: expected an angle and {len(azimuth)} values, got "
                f"{len(cells)} numbers"
            )
        values = [number(path, index + 1, c, cell) for c, cell in enumerate(cells, 1)]
        if abs(values[0] - angle) > 1e-3:
            raise InputError(
                f"{path}: line {index + 1}, column 1: expected {angle:g} degrees by the file's "
                f"header, got {values[0]:g}"
            )
        rows.append(values[1:])
    return RtTable(tilt, receive, azimuth, rows)
