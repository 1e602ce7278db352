"""The text form of ASTM E1392, `.astm`, as Cornell's gonioreflectometer data use it.

    LAB_NAME …                 keyword and value, a line each
    SAMPLE_NAME …
    NUM_POINTS 1439
    VARS theta_i,phi_i,theta_s,phi_s,400nm,410nm,…
    0.17,0,0.26,3.14,0.031,…   a line a reading

θ and φ are the polar angles and azimuths of the light (i) and of the viewer (s), both as
directions away from the surface, so the mirror is at φ_s = φ_i + 180°. Files hold them in
radians or in degrees without saying so: all θ up to π/2 and all φ up to 2π are taken as radians
(a note says which). The values are f_r in 1/sr: the reflectance factor is 100 π of them.
Channels are bands ("550nm"), X,Y,Z (taken as D65, perfect diffuser Y = 1/π) or R,G,B (taken as
linear with sRGB primaries; the monitor primaries of some files are not named in them), or one
column of any name.

φ_i is kept as the sample's azimuth where it is not 0 throughout.

**What it does not hold.** The illuminant and observer behind X,Y,Z, the primaries behind R,G,B,
the unit of its angles, spread (unless in columns of its own, which are refused), validity.

Source: files of the Cornell Program of Computer Graphics as other readers of this form take
them; the standard itself (E1392-96, withdrawn) leaves the layout to keywords.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import (
    NOMINAL_NM,
    measurement_of,
    unit_vectors,
)
from raden_torch.capture.exchange.polar import polar_of
from raden_torch.capture.exchange.text import (
    check_values,
    first_lines,
    named,
    number,
    read_lines,
    title,
    whole_number,
    write_lines,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB, XYZ
from raden_torch.measurement.text_file import shown

MAX_POINTS = 20_000_000
_MAX_COLUMNS = 2_000
_ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")
_ROUNDING = 1e-3  # angles in radians are written with few digits
_KEYWORD = re.compile(r"[A-Z][A-Z0-9_]+")


@dataclass
class _Header:
    entries: dict[str, str] = field(default_factory=dict)
    columns: list[str] = field(default_factory=list)
    points: int | None = None
    lines: int = 0  # how many lines stand before the first reading


def recognises(head: str) -> bool:
    """True where keywords stand first and a VARS line, or others of this form, follow."""
    lines = first_lines(head)
    if not lines or not _KEYWORD.match(lines[0]):
        return False
    known = r"(VARS\s+.*theta|NUM_POINTS\s|LAB_NAME\b|SYSTEM_NAME\b|MEAS_NAME\b)"
    return any(re.match(known, line) for line in lines)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file.

    Raises:
        InputError: names the line and column, and what would be right.
    """
    path = Path(path)
    lines = read_lines(path)
    header = _read_header(path, lines)
    table = _read_rows(path, lines, header)
    names = [name for name in header.columns if name not in _ANGLES]
    channels, note = _channels(path, header, names)
    order = np.argsort([float(c[:-2]) for c in channels]) if channels[0][-2:] == "nm" else [0, 1, 2]
    column = dict(zip(header.columns, table.T, strict=True))
    angles = np.stack([column[name] for name in _ANGLES])
    degrees, unit_note = _in_degrees(angles)
    _check_degrees(path, header, degrees)
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        values = FACTOR_PER_SR * np.stack([column[names[i]] for i in order], axis=1)
    return measurement_of(
        path,
        unit_vectors(degrees[0], degrees[1]),
        unit_vectors(degrees[2], degrees[3]),
        values,
        tuple(channels[i] for i in order),
        metadata=_metadata(path, header, tuple(filter(None, (note, unit_note)))),
        azimuth_deg=degrees[1],
        average_repeats=True,
    )


def _read_header(path: Path, lines: list[str]) -> _Header:
    header = _Header()
    for at, line in enumerate(lines, 1):
        key, _, value = line.strip().partition(" ")
        value = value.strip()
        if not key:
            continue
        if key == "VARS":
            header.columns = [name.strip() for name in value.split(",")]
            header.lines = at
            _check_columns(path, at, header.columns)
            return header
        if not _KEYWORD.fullmatch(key):
            raise InputError(
                f"{path}: line {at}: expected a KEYWORD and its value, or VARS, got "
                f"{shown(line.strip())}"
            )
        if key == "NUM_POINTS":
            header.points = whole_number(path, at, key, value, MAX_POINTS)
        header.entries[key] = value.strip('"')
    raise InputError(
        f"{path}: expected a line 'VARS {','.join(_ANGLES)},<channels>', got none: it is truncated"
    )


def _check_columns(path: Path, line: int, columns: list[str]) -> None:
    missing = [name for name in _ANGLES if name not in columns]
    if missing or len(set(columns)) != len(columns) or len(columns) <= len(_ANGLES):
        wrong = f"no {', '.join(missing)}" if missing else "a name twice, or no channel"
        raise InputError(
            f"{path}: line {line}: VARS: expected '{','.join(_ANGLES)},<channels>', got {wrong}"
        )
    if len(columns) > _MAX_COLUMNS:
        raise InputError(
            f"{path}: line {line}: VARS: expected at most {_MAX_COLUMNS} columns, got "
            f"{len(columns)}"
        )


def _read_rows(path: Path, lines: list[str], header: _Header) -> Floats:
    """`[M, columns]`."""
    width, points = len(header.columns), header.points
    rows = [(at, line) for at, line in enumerate(lines, 1) if at > header.lines and line.strip()]
    if not rows or (points is not None and points != len(rows)):
        claim = "at least one reading" if points is None else f"{points} readings (NUM_POINTS)"
        raise InputError(
            f"{path}: expected {claim} below VARS, got {len(rows)}; the file is truncated or the "
            "header is wrong"
        )
    table = np.empty((len(rows), width))
    for row, (at, line) in enumerate(rows):
        cells = line.replace(",", " ").split()
        if len(cells) != width:
            raise InputError(f"{path}: line {at}: expected {width} numbers, got {len(cells)}")
        table[row] = [
            number(path, at, name, cell) for name, cell in zip(header.columns, cells, strict=True)
        ]
    return table


def _channels(path: Path, header: _Header, names: list[str]) -> tuple[tuple[str, ...], str]:
    """The channels' names in the file's order, and a note on what was assumed."""
    if tuple(names) == XYZ:
        return XYZ, "white taken as D65"
    if tuple(names) == RGB:
        return RGB, "R, G, B taken as linear with sRGB primaries"
    if all(re.fullmatch(r"[0-9]+(\.[0-9]+)?\s*nm", name) for name in names):
        return tuple(f"{float(name[:-2]):g}nm" for name in names), ""
    if len(names) == 1:
        stated = re.match(r"[0-9]+(\.[0-9]+)?", header.entries.get("WAVELENGTH", ""))
        nm = float(stated[0]) if stated else NOMINAL_NM
        note = "" if stated else f"the file names no wavelength, the band is called {nm:g} nm"
        return (f"{nm:g}nm",), note
    raise InputError(
        f"{path}: line {header.lines}: VARS: channels: expected X,Y,Z or R,G,B or bands as 550nm, "
        f"got {', '.join(names[:8])}"
    )


def _in_degrees(angles: Floats) -> tuple[Floats, str]:
    theta, phi = abs(angles[[0, 2]]).max(), abs(angles[[1, 3]]).max()
    if theta <= np.pi / 2 + _ROUNDING and phi <= 2 * np.pi + _ROUNDING:
        return np.rad2deg(angles), "angles taken as radians"
    return angles, "angles taken as degrees"


def _check_degrees(path: Path, header: _Header, degrees: Floats) -> None:
    for name, angles in zip(_ANGLES, degrees, strict=True):
        limit = 360.0 if name[:3] == "phi" else 180.0
        wrong = abs(angles) > limit + 1
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{path}: reading {row + 1}, column {name}: expected at most {limit:g} degrees, "
                f"got {angles[row]:g}"
            )


def _metadata(path: Path, header: _Header, notes: tuple[str, ...]) -> Metadata:
    entries = dict(header.entries)
    entries.pop("NUM_POINTS", None)
    return replace(
        named(entries.pop("SAMPLE_NAME", ""), path.stem),
        instrument=entries.pop("SYSTEM_NAME", ""),
        other=tuple((key, value) for key, value in entries.items() if value),
        notes=notes,
    )


def write(path: Path, measurement: BrdfMeasurement) -> None:
    """Write readings, in radians.

    Args:
        measurement: valid readings, as `by_directions` gives them.

    Raises:
        InputError: more values than a text file can hold.
    """
    check_values(path, (len(measurement),), len(_ANGLES) + len(measurement.channels))
    write_lines(path, _written(measurement))


def _written(measurement: BrdfMeasurement) -> Iterator[str]:
    polar = polar_of(measurement.angles_deg)
    turned = measurement.azimuth_deg
    light = np.zeros(len(measurement)) if turned is None else turned % 360
    # the mirror is at φ_s = φ_i + 180°
    view = (light + 180 + polar.azimuth) % 360
    angles = np.deg2rad(np.stack([polar.incidence, light, polar.scatter, view], axis=1))
    name = title(measurement.metadata).replace('"', "'")
    yield f'SAMPLE_NAME "{name}"'
    if measurement.metadata.instrument:
        yield "SYSTEM_NAME " + " ".join(measurement.metadata.instrument.split())
    yield f"NUM_POINTS {len(measurement)}"
    yield "VARS " + ",".join([*_ANGLES, *measurement.channels])
    for row in np.hstack([angles, measurement.values / FACTOR_PER_SR]).tolist():
        yield ",".join([f"{value:.15g}" for value in row])
