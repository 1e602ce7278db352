"""The project's own measurement file: a comment header, a line of column names, a row a reading.

    # material: pearl-paint
    # quantity: XYZ reflectance factor, perfect reflecting diffuser Y = 100 in every geometry; …
    # readings: 12615
    incidence_deg,receiving_deg,tilt_deg,X,Y,Z
    0,-70,-70,19.4706,20.0899,19.1346

Rows in any order, gaps allowed. Optional columns: `azimuth_deg`, `std_<channel>`, `count`, `valid`
(0 or 1). An empty or `nan` value is a reading without a value. `readings`, where it is given, must
be the number of rows: that is how a file cut at the end of a line is noticed. The entries
of `SystematicErrors` (`scale_std` and others) may be missing.

So it is written, in UTF-8. It is read as spreadsheets save it, too: `csv_table` and `text_file` say
which encodings, separators, decimal commas and column names are taken; a warning says what was.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside
from raden_torch.measurement import systematic_errors
from raden_torch.measurement.csv_table import CsvTable, find_heading, open_table
from raden_torch.measurement.readings import BrdfMeasurement, Metadata

MAX_BYTES = 2_000_000_000
_ANGLES = ("incidence_deg", "receiving_deg", "tilt_deg")
_QUANTITY = "reflectance factor, perfect reflecting diffuser = 100 in every geometry"
_OWN_KEYS = (
    *("material", "quantity", "instrument", "white", "observer", "simulated", "readings"),
    *systematic_errors.KEYS,
)
_QUARTER_TURN_RAD = 1.6
_BAND = r"\d+(\.\d*)?nm"


@dataclass(frozen=True)
class _Header:
    entries: dict[str, str]
    notes: tuple[str, ...]


def recognises(head: str) -> bool:
    """True where a text begins like this format, or like an attempt at it."""
    names = re.split(r"[,;\t]", find_heading(head).names)
    angle = re.compile(r'[\s"]*(incidence|receiving|tilt)', re.IGNORECASE)
    return len(names) > 1 and any(angle.match(name) for name in names)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a measurement.

    Raises:
        InputError: one line that names the file, the line and column, and what would be right.
    """
    path = Path(path)
    file = open_table(path, MAX_BYTES, _ANGLES)
    header = _read_header(file.comments)
    _check_claimed_rows(file, header)
    channels = _channels(path, file.columns)
    spread = [name for name in file.columns if name[:4] == "std_"]
    table = file.numbers(may_be_empty={*channels, *spread, "azimuth_deg"})
    _check_rows(path, header, len(table))
    columns = dict(zip(file.columns, table.T, strict=True))
    _check_degrees(path, header, columns)
    std = [columns.get(f"std_{channel}") for channel in channels]
    count = _whole_numbers(path, columns, "count")
    valid = _whole_numbers(path, columns, "valid")
    try:
        return BrdfMeasurement(
            incidence_deg=columns["incidence_deg"],
            receiving_deg=columns["receiving_deg"],
            tilt_deg=columns["tilt_deg"],
            values=np.stack([columns[channel] for channel in channels], axis=1),
            channels=channels,
            azimuth_deg=columns.get("azimuth_deg"),
            std=None if std[0] is None else np.stack(std, axis=1),  # type: ignore[arg-type]
            count=None if count is None else count.astype(np.int64),
            valid=np.ones(len(table), bool) if valid is None else valid.astype(bool),
            metadata=_metadata(path, header),
        )
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix('measurement: ')}") from None


def write(measurement: BrdfMeasurement, path: str | os.PathLike[str]) -> None:
    """Write a measurement so that `read` gives back an equal one, to the bit.

    Raises:
        InputError: a suffix other than .csv, or a place that cannot be written.
    """
    target = check_output(path, (".csv",))
    m, meta = measurement, measurement.metadata
    entries = [
        ("material", meta.sample),
        ("quantity", _QUANTITY),
        ("instrument", meta.instrument),
        ("white", meta.white),
        ("observer", meta.observer),
        ("simulated", "true" if meta.simulated else "false"),
        *meta.systematic.as_entries(),
        *meta.other,
        ("readings", str(len(m))),
    ]
    columns = {name: getattr(m, name) for name in _ANGLES}
    if m.azimuth_deg is not None:
        columns["azimuth_deg"] = m.azimuth_deg
    columns |= dict(zip(m.channels, m.values.T, strict=True))
    if m.std is not None:
        columns |= {f"std_{c}": s for c, s in zip(m.channels, m.std.T, strict=True)}
    if m.count is not None:
        columns["count"] = m.count
    if not m.valid.all():
        columns["valid"] = m.valid.astype(int)
    with written_beside(target) as temporary, temporary.open("w", encoding="utf-8") as file:
        for key, value in entries:
            file.write(f"# {key}: {_one_line(value)}\n")
        for note in meta.notes:
            file.write(f"# {_one_line(note)}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            file.write(",".join(map(_number, row)) + "\n")


def _number(value: float | int) -> str:
    """The shortest text that reads back to the same float64."""
    return repr(value).removesuffix(".0")


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _read_header(comments: Sequence[str]) -> _Header:
    entries, notes = {}, []
    for text in comments:
        key, colon, value = text.partition(":")
        if colon and re.fullmatch(r"[\w .-]+", key):
            entries[key.strip()] = value.strip()
        else:
            notes.append(text)
    return _Header(entries, tuple(notes))


def _check_claimed_rows(file: CsvTable, header: _Header) -> None:
    """Refuse a claim that the file cannot hold, before its rows are read."""
    claimed = header.entries.get("readings")
    if claimed is None:
        return
    if not re.fullmatch("[0-9]{1,18}", claimed):
        raise InputError(
            f"{file.path}: header: readings: expected a whole number, got {claimed[:40]!r}"
        )
    least = 2 * len(file.columns)  # a digit and a separator or line end each
    if int(claimed) * least > len(file.body) + 1:
        raise InputError(
            f"{file.path}: expected {claimed} readings by its header, got {len(file.body)} "
            "characters, in which they do not fit; the file is truncated or the header is wrong"
        )


def _check_rows(path: Path, header: _Header, rows: int) -> None:
    if not rows:
        raise InputError(f"{path}: expected readings below its column names, got none")
    claimed = header.entries.get("readings")
    if claimed is not None and int(claimed) != rows:
        raise InputError(
            f"{path}: expected {claimed} readings by its header, got {rows}; the file is "
            "truncated, or `readings` was not kept up"
        )


def _channels(path: Path, columns: Sequence[str]) -> tuple[str, ...]:
    where = f"{path}: columns {','.join(name[:40] for name in columns[:12])}"
    missing = [name for name in _ANGLES if name not in columns]
    if missing:
        raise InputError(
            f"{where}: expected columns of angles in degrees, got none named {', '.join(missing)}"
        )
    optional = {"azimuth_deg", "count", "valid"}
    channels = tuple(
        name for name in columns if name not in {*_ANGLES, *optional} and name[:4] != "std_"
    )
    bands = bool(channels) and all(re.fullmatch(_BAND, name) for name in channels)
    if bands:  # in any order: spectrophotometers begin with the longest
        channels = tuple(sorted(channels, key=lambda name: float(name[:-2])))
    known = channels in (("X", "Y", "Z"), ("R", "G", "B")) or bands
    if not known:
        names = ", ".join(name[:40] or "(no name)" for name in channels[:12])
        raise InputError(
            f"{where}: value columns: expected X,Y,Z or R,G,B or bands as 550nm, got "
            f"{names or '(none)'}"
        )
    spread = [name for name in columns if name[:4] == "std_"]
    if spread and set(spread) != {f"std_{channel}" for channel in channels}:
        raise InputError(
            f"{where}: expected one column std_ per channel, got {', '.join(spread[:12])}"
        )
    return channels


def _check_degrees(path: Path, header: _Header, columns: dict[str, Floats]) -> None:
    angles = np.stack([columns[name] for name in _ANGLES])
    if header.entries.get("angles") == "degrees" or not np.isfinite(angles).all():
        return
    largest = abs(angles).max()
    fractional = (angles != np.round(angles)).any()
    if 0 < largest <= _QUARTER_TURN_RAD and fractional:
        raise InputError(
            f"{path}: expected angles in degrees, got {largest:g} at most, which look like "
            "radians (if they are degrees, add the header line '# angles: degrees')"
        )


def _whole_numbers(path: Path, columns: dict[str, Floats], name: str) -> Floats | None:
    column = columns.get(name)
    if column is None:
        return None
    highest, wanted = (1, "0 or 1") if name == "valid" else (2**53, "a whole number")
    wrong = ~((column >= 0) & (column <= highest) & (column == np.floor(column)))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{path}: reading {row + 1}, column {name}: expected {wanted}, got {column[row]:g}"
        )
    return column


def _metadata(path: Path, header: _Header) -> Metadata:
    entries = header.entries
    simulated = entries.get("simulated", "false").lower()
    if simulated not in ("true", "false"):
        raise InputError(
            f"measurement: header: simulated: expected true or false, got {simulated!r}"
        )
    quantity = entries.get("quantity", "")
    scale = re.search(r"=\s*([0-9]+(?:\.[0-9]+)?)", quantity)
    if scale and float(scale[1]) != 100:
        raise InputError(
            f"measurement: header: perfect reflecting diffuser: expected 100, got {scale[1]}; "
            "scale the values"
        )
    stated = re.search(r"\b(D50|D55|D60|D65|D75|A|C|E)\s*$", quantity)
    ten_degrees = re.search(r"CIE 1964|\b10 deg", quantity)
    return Metadata(
        sample=entries.get("material") or entries.get("sample", ""),
        instrument=entries.get("instrument", ""),
        white=entries.get("white") or (stated[1] if stated else "D65"),
        observer=entries.get("observer")
        or ("CIE 1964 10 deg" if ten_degrees else "CIE 1931 2 deg"),
        simulated=simulated == "true",
        systematic=systematic_errors.SystematicErrors.from_entries(entries),
        other=tuple((k, v) for k, v in entries.items() if k not in _OWN_KEYS),
        notes=header.notes,
    )
