"""The project's own measurement file: a comment header, a line of column names, a row a reading.

    # material: pearl-paint
    # quantity: XYZ reflectance factor, perfect reflecting diffuser Y = 100 in every geometry; …
    # readings: 12615
    incidence_deg,receiving_deg,tilt_deg,X,Y,Z
    0,-70,-70,19.4706,20.0899,19.1346

Rows in any order, gaps allowed. Optional columns: `azimuth_deg`, `std_<channel>`, `count`, `valid`
(0 or 1). An empty or `nan` value is a reading without a value. `readings`, where it is given, must
be the number of rows: that is how a file cut at the end of a line is noticed. The entries
of `CommonErrors` (`scale_std` and others) may be missing.
"""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside
from raden_torch.measurement import common_errors
from raden_torch.measurement.readings import BrdfMeasurement, Floats, Metadata

MAX_BYTES = 2_000_000_000
_ANGLES = ("incidence_deg", "receiving_deg", "tilt_deg")
_QUANTITY = "reflectance factor, perfect reflecting diffuser = 100 in every geometry"
_OWN_KEYS = (
    *("material", "quantity", "instrument", "white", "observer", "simulated", "readings"),
    *common_errors.KEYS,
)
_QUARTER_TURN_RAD = 1.6


@dataclass
class _Header:
    entries: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    columns: list[str] = field(default_factory=list)
    lines: int = 0  # how many lines stand before the first row


def recognises(head: bytes) -> bool:
    """True where the first bytes look like this format, or like an attempt at it."""
    if b"\0" in head:
        return False
    for line in head.decode("utf-8", "replace").lstrip("\ufeff").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return bool(re.search(r"incidence|receiving|tilt", line)) and "," in line
    return False


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a measurement.

    Raises:
        InputError: one line that names the file, the line and column, and what would be right.
    """
    path = Path(path)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{path}: {size / 1e9:.1f} GB; at most {MAX_BYTES / 1e9:g} GB are read")
    text = _decoded(path)
    lines = text.split("\n")
    header = _read_header(path, lines)
    _check_claimed_rows(path, header, size)
    channels = _channels(path, header.columns)
    table = _read_rows(path, header, lines)
    columns = dict(zip(header.columns, table.T, strict=True))
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
        *meta.common.as_entries(),
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


def _decoded(path: Path) -> str:
    data = path.read_bytes()
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}: line {line}: byte 0x{data[error.start]:02x} is not UTF-8; save it as UTF-8"
        ) from None


def _read_header(path: Path, lines: list[str]) -> _Header:
    header = _Header()
    for number, line in enumerate(lines):
        line = line.strip()
        if line.startswith("#"):
            key, colon, value = line[1:].strip().partition(":")
            if colon and re.fullmatch(r"[\w .-]+", key):
                header.entries[key.strip()] = value.strip()
            elif line[1:].strip():
                header.notes.append(line[1:].strip())
        elif line:
            header.columns = [name.strip() for name in line.split(",")]
            header.lines = number + 1
            break
    if not header.columns:
        raise InputError(f"{path}: it is empty; columns {','.join(_ANGLES)},X,Y,Z were wanted")
    return header


def _check_claimed_rows(path: Path, header: _Header, size: int) -> None:
    claimed = header.entries.get("readings")
    if claimed is None:
        return
    if not claimed.isdigit():
        raise InputError(f"{path}: header: readings = {claimed!r} is not a whole number")
    least = 2 * len(header.columns)  # a digit and a comma or line end each
    if int(claimed) * least > size + 1:
        raise InputError(
            f"{path}: header claims {claimed} readings, more than its {size} bytes can hold; "
            "the file is truncated or the header is wrong"
        )


def _channels(path: Path, columns: list[str]) -> tuple[str, ...]:
    where = f"{path}: columns {','.join(columns[:12])}"
    missing = [name for name in _ANGLES if name not in columns]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} missing; angles are wanted in degrees")
    if len(set(columns)) != len(columns):
        raise InputError(f"{where}: a column occurs twice")
    optional = {"azimuth_deg", "count", "valid"}
    channels = tuple(
        name for name in columns if name not in {*_ANGLES, *optional} and name[:4] != "std_"
    )
    known = channels in (("X", "Y", "Z"), ("R", "G", "B")) or (
        channels and all(re.fullmatch(r"[\d.]+nm", name) for name in channels)
    )
    if not known:
        raise InputError(
            f"{where}: value columns {', '.join(channels) or '(none)'}; "
            "X,Y,Z or R,G,B or bands as 550nm were wanted"
        )
    spread = [name for name in columns if name[:4] == "std_"]
    if spread and set(spread) != {f"std_{channel}" for channel in channels}:
        raise InputError(f"{where}: {', '.join(spread)} do not match the channels; one for each")
    return channels


def _read_rows(path: Path, header: _Header, lines: list[str]) -> Floats:
    body = "\n".join(lines[header.lines :])
    if not body.strip():
        raise InputError(f"{path}: it has no readings below its column names")
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments="#")
    except ValueError:
        table = _read_rows_slowly(path, header, lines)
    if table.shape[1] != len(header.columns):
        table = _read_rows_slowly(path, header, lines)
    claimed = header.entries.get("readings")
    if claimed is not None and int(claimed) != len(table):
        raise InputError(
            f"{path}: header says {claimed} readings, {len(table)} are there; "
            "the file is truncated, or `readings` was not kept up"
        )
    return table


def _read_rows_slowly(path: Path, header: _Header, lines: list[str]) -> Floats:
    """Row by row: accepts empty values, and finds the line and column of what is wrong."""
    rows = []
    last = max(i for i, line in enumerate(lines) if line.strip())
    for number in range(header.lines, len(lines)):
        line = lines[number].split("#")[0].strip()
        if not line:
            continue
        cells = line.split(",")
        if len(cells) != len(header.columns):
            end = "; the file is truncated" if number == last and len(lines) == last + 1 else ""
            raise InputError(
                f"{path}: line {number + 1}: {len(cells)} values, "
                f"{len(header.columns)} were wanted{end}"
            )
        rows.append(
            [
                _cell(path, number, name, cell)
                for name, cell in zip(header.columns, cells, strict=True)
            ]
        )
    if not rows:
        raise InputError(f"{path}: it has no readings below its column names")
    return np.array(rows, np.float64)


def _cell(path: Path, number: int, column: str, cell: str) -> float:
    cell = cell.strip()
    if not cell and column not in (*_ANGLES, "count", "valid"):
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        raise InputError(
            f"{path}: line {number + 1}, column {column}: {cell!r} is not a number"
        ) from None


def _check_degrees(path: Path, header: _Header, columns: dict[str, Floats]) -> None:
    angles = np.stack([columns[name] for name in _ANGLES])
    if header.entries.get("angles") == "degrees" or not np.isfinite(angles).all():
        return
    largest = abs(angles).max()
    fractional = (angles != np.round(angles)).any()
    if 0 < largest <= _QUARTER_TURN_RAD and fractional:
        raise InputError(
            f"{path}: the largest angle is {largest:g}: these look like radians; degrees are "
            "wanted (if they are degrees, add the header line '# angles: degrees')"
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
            f"{path}: reading {row + 1}, column {name}: {column[row]:g} is not {wanted}"
        )
    return column


def _metadata(path: Path, header: _Header) -> Metadata:
    entries = header.entries
    simulated = entries.get("simulated", "false").lower()
    if simulated not in ("true", "false"):
        raise InputError(f"{path}: header: simulated = {simulated!r}; true or false was wanted")
    quantity = entries.get("quantity", "")
    scale = re.search(r"=\s*([\d.]+)", quantity)
    if scale and float(scale[1]) != 100:
        raise InputError(
            f"{path}: header: the perfect reflecting diffuser is {scale[1]}; 100 is wanted "
            "(scale the values)"
        )
    stated = re.search(r"\b(D50|D55|D60|D65|D75|A|C|E)\s*$", quantity)
    ten_degrees = re.search(r"CIE 1964|\b10 deg", quantity)
    return Metadata(
        sample=entries.get("material", ""),
        instrument=entries.get("instrument", ""),
        white=entries.get("white") or (stated[1] if stated else "D65"),
        observer=entries.get("observer")
        or ("CIE 1964 10 deg" if ten_degrees else "CIE 1931 2 deg"),
        simulated=simulated == "true",
        common=common_errors.CommonErrors.from_entries(entries),
        other=tuple((k, v) for k, v in entries.items() if k not in _OWN_KEYS),
        notes=tuple(header.notes),
    )
