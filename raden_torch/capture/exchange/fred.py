"""FRED's text of a tabulated BSDF (Photon Engineering).

    type bsdf_data
    format angles=deg bsdf=value scale=1
    θ_specular φ_specular
    θ_scatter φ_scatter bsdf
    …

A row of two numbers starts a section, rows of three are its readings; tabs, blanks or commas
between. `angles=deg`: polar and azimuth angle; a negative polar angle is the other side of the
normal. `angles=sin`: direction cosines α = sin φ sin θ, β = cos φ sin θ. `bsdf=log`: log10 of
the value. The value times `scale` is f_r in 1/sr, so the reflectance factor is 100 π of it.

The section names the *specular* direction: the light comes from the opposite azimuth. Only
azimuth differences count in FRED; where a file has several φ_specular, they are taken as the
sample's rotation.

**What it does not hold.** Wavelength or colour (FRED calls the model wavelength invariant),
sample, instrument, date, spread, a mark for missing readings; and no negative value is allowed
in it, so files made from noisy readings were shifted before (the shared one: a blank subtracted,
the least value set to 0, azimuths ±A averaged).

Source: FRED help, "Tabulated BSDF", File Header and BSDF Data.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
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
    number,
    read_lines,
    write_lines,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.measurement.text_file import shown

_FORMAT = re.compile(r"format\s+angles=(deg|sin)\s+bsdf=(value|log)\s+scale=(\S+)", re.IGNORECASE)
_COLUMNS = ("polar angle", "azimuth", "bsdf")
_LARGEST_DEG = 360.0
_DIGITS = 8  # decimals of a degree that are written


def recognises(head: str) -> bool:
    """True where the first line is `type bsdf_data`."""
    lines = first_lines(head, 1)
    return bool(lines) and bool(re.fullmatch(r"type\s+bsdf_data", lines[0], re.IGNORECASE))


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file.

    Raises:
        InputError: names the line and column, and what would be right.
    """
    path = Path(path)
    lines = read_lines(path)
    begin = next(i for i, line in enumerate(lines) if line.strip()) + 1
    header = _FORMAT.fullmatch(lines[begin].strip()) if begin < len(lines) else None
    if header is None:
        got = shown(lines[begin]) if begin < len(lines) else "the end of the file"
        raise InputError(
            f"{path}: line {begin + 1}: expected 'format angles=deg|sin bsdf=value|log "
            f"scale=<number>', got {got}"
        )
    scale = number(path, begin + 1, "scale", header[3])
    in_degrees = header[1].lower() == "deg"
    rows = _rows(path, lines, begin + 1, in_degrees)
    specular, scatter, given = rows[:, 0:2].T, rows[:, 2:4].T, rows[:, 4]
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        bsdf = scale * (10.0**given if header[2].lower() == "log" else given)
        values = FACTOR_PER_SR * bsdf[:, None]
    if in_degrees:
        light, view = unit_vectors(specular[0], specular[1] + 180), unit_vectors(*scatter)
        azimuth = specular[1]
    else:
        light, view = _from_cosines(-specular), _from_cosines(scatter)
        azimuth = np.rad2deg(np.arctan2(specular[0], specular[1]))
    note = f"the format names no wavelength, the band is called {NOMINAL_NM:g} nm"
    return measurement_of(
        path,
        light,
        view,
        values,
        (f"{NOMINAL_NM:g}nm",),
        metadata=Metadata(sample=path.stem, notes=(note,)),
        azimuth_deg=azimuth,
        average_repeats=True,
    )


def _rows(path: Path, lines: list[str], begin: int, in_degrees: bool) -> Floats:
    """`[M, 5]`: specular direction (2), scatter direction (2), value, a row a reading."""
    specular: list[float] | None = None
    rows: list[list[float]] = []
    for index in range(begin, len(lines)):
        cells = lines[index].replace(",", " ").split()
        if not cells:
            continue
        if len(cells) not in (2, 3):
            raise InputError(
                f"{path}: line {index + 1}: expected 2 numbers (specular direction) or 3 (scatter "
                f"direction, bsdf), got {len(cells)}"
            )
        values = [number(path, index + 1, c, cell) for c, cell in enumerate(cells, 1)]
        _check_direction(path, index + 1, cells, values, in_degrees)
        if len(cells) == 2:
            specular = values
        elif specular is None:
            raise InputError(
                f"{path}: line {index + 1}: expected a specular direction (a line with two "
                "numbers), got a reading before any"
            )
        else:
            rows.append([*specular, *values])
    if not rows:
        raise InputError(
            f"{path}: expected readings below its header, got none: the file is truncated"
        )
    return np.array(rows, np.float64)


def _check_direction(
    path: Path, line: int, cells: list[str], values: list[float], in_degrees: bool
) -> None:
    first, second = values[:2]
    if in_degrees:
        for column, angle in enumerate((first, second), 1):
            if abs(angle) > _LARGEST_DEG:
                raise InputError(
                    f"{path}: line {line}, column {column}: {_COLUMNS[column - 1]}: expected at "
                    f"most {_LARGEST_DEG:g} degrees, got {shown(cells[column - 1])}"
                )
    elif abs(first) > 1 or abs(second) > 1 or first**2 + second**2 > 1:
        raise InputError(
            f"{path}: line {line}: expected direction cosines, whose squares add up to at most 1, "
            f"got {first:g}, {second:g}"
        )


def _from_cosines(alpha_beta: Floats) -> Floats:
    """`[3, M]` directions of α = sin φ sin θ and β = cos φ sin θ, `[2, M]`."""
    alpha, beta = alpha_beta
    return np.stack([beta, alpha, np.sqrt(np.maximum(1 - alpha**2 - beta**2, 0))])


def write(path: Path, measurement: BrdfMeasurement) -> None:
    """Write readings of one channel, in degrees, a section a specular direction.

    Args:
        measurement: valid readings ≥ 0, as `by_directions` gives them.

    Raises:
        InputError: more values than a text file can hold.
    """
    check_values(path, (len(measurement), 3), 1)
    write_lines(path, _written(measurement))


def _written(measurement: BrdfMeasurement) -> Iterator[str]:
    polar = polar_of(measurement.angles_deg)
    turned = measurement.azimuth_deg
    specular = np.zeros(len(measurement)) if turned is None else turned % 360
    scatter = (specular + polar.azimuth) % 360
    columns = np.stack([polar.incidence, specular, polar.scatter, scatter], axis=1)
    rows = np.column_stack([np.round(columns, _DIGITS), measurement.values / FACTOR_PER_SR])
    yield from ("type bsdf_data", "format angles=deg bsdf=value scale=1")
    section: tuple[float, ...] = ()
    for *angles, value in rows[np.lexsort(rows.T[3::-1])].tolist():
        if tuple(angles[:2]) != section:
            section = tuple(angles[:2])
            yield f"{angles[0]:.12g}\t{angles[1]:.12g}"
        yield f"{angles[2]:.12g}\t{angles[3]:.12g}\t{value:.9g}"
