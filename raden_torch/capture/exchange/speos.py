"""The RT-300S's text export for SPEOS, `.rtd` ("OPTIS - Anisotropic BSDF surface file v1.0").

A block an incidence:

    OPTIS - Anisotropic BSDF surface file v1.0
    SampleID:  Sample 60        the incidence in degrees
    0 1 0                       anisotropy vector
    1  0                        has reflection, has transmission
    0                           0: values go with intensity, 1: with the BSDF
    …                           numbers and lists of angles
    Reflection Spectrum
    2                           that many lines of wavelength and percent
    …
            -90     -80         azimuths, then a row a receive angle
    -30     value   value

    (a second table)

**What is read.** The incidence from `SampleID` and the first table, whose angles are the
instrument's and whose values are 100 RT, as in the export for LightTools (see
`rt300s_geometry`): the reflectance factor is value/cos R.

**What is not.** The lists of incidences and the spectrum, which are a template that does not
follow the data; the second table, which is made from the first one (it averages readings of
unlike directions). The format holds no scale of its own (SPEOS normalises it with the spectrum),
no instrument or date, and no spread. Versions 7 and 8 are read by `speos_bsdf`, others are not.

Source: Ansys help, "Structure of Anisotropic BSDF Files", for the header; the values by
comparison with the workbook of the same readings in ua-loft/bsdf-tools.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from raden_torch.capture.exchange.rt300s_geometry import RtTable, measurement_of_tables
from raden_torch.capture.exchange.text import (
    first_lines,
    number,
    read_lines,
    whole_number,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.text_file import shown

_TITLE = "OPTIS - Anisotropic BSDF surface file"
_VERSION = f"{_TITLE} v1.0"
_SPECTRUM = "Reflection Spectrum"
_MAX_WAVELENGTHS = 10_000


def recognises(head: str) -> bool:
    """True where the first line is the format's title, of any version."""
    lines = first_lines(head, 1)
    return bool(lines) and lines[0].startswith(_TITLE)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file.

    Raises:
        InputError: names the line and column, and what would be right; another version.
    """
    path = Path(path)
    lines = [line.strip() for line in read_lines(path)]
    starts = [i for i, line in enumerate(lines) if line.startswith(_TITLE)]
    ends = [*starts[1:], len(lines)]
    tables = [_block(path, lines, *ends_of) for ends_of in zip(starts, ends, strict=True)]
    return measurement_of_tables(path, tables, Metadata(sample=path.stem))


def _block(path: Path, lines: list[str], begin: int, end: int) -> RtTable:
    """The first table of the block in lines[begin:end]."""

    def line(at: int, wanted: str) -> str:
        if at >= end:
            raise InputError(
                f"{path}: line {at}: expected {wanted}, got the end of the block from line "
                f"{begin + 1}: it is truncated"
            )
        return lines[at]

    incidence = _incidence(path, begin, *(line(begin + i, "its header") for i in range(5)))
    spectrum = next((i for i in range(begin, end) if lines[i] == _SPECTRUM), end)
    size = line(spectrum + 1, f"'{_SPECTRUM}' and its length")
    at = spectrum + 2 + whole_number(path, spectrum + 2, _SPECTRUM, size, _MAX_WAVELENGTHS)
    azimuth = _numbers(path, at, line(at, "a row of azimuths"))
    receive, percent = [], []
    at += 1
    while line(at, "the rest of the table, and a second one"):
        values = _numbers(path, at, lines[at])
        if len(values) != 1 + len(azimuth):
            raise InputError(
                f"{path}: line {at + 1}: expected an angle and {len(azimuth)} values, got "
                f"{len(values)} numbers"
            )
        receive.append(values[0])
        percent.append(values[1:])
        at += 1
    if not receive:
        raise InputError(f"{path}: line {at + 1}: expected rows of an angle and values, got none")
    if not any(lines[at:end]):
        line(end, "a second table")
    for angle in (*receive, *azimuth):
        if abs(angle) > 360:
            raise InputError(
                f"{path}: table from line {spectrum + 1}: angle: expected at most 360 degrees, "
                f"got {angle:g}"
            )
    return RtTable(incidence, receive, azimuth, percent)


def _incidence(
    path: Path, begin: int, title: str, sample: str, vector: str, has: str, kind: str
) -> float:
    """The incidence in degrees, after a look at what the header says of the values."""
    del vector  # where the anisotropy points: a template
    if title != _VERSION:
        raise InputError(
            f"{path}: line {begin + 1}: expected '{_VERSION}', or v7.0 or v8.0, got {shown(title)}"
        )
    named = re.fullmatch(r"SampleID:\s*Sample\s+(\S+)", sample)
    if named is None:
        raise InputError(
            f"{path}: line {begin + 2}: expected 'SampleID: Sample <incidence>', got "
            f"{shown(sample)}"
        )
    incidence = number(path, begin + 2, 2, named[1])
    if not 0 <= incidence <= 90:
        raise InputError(
            f"{path}: line {begin + 2}: incidence: expected 0…90 degrees, got {incidence:g}"
        )
    if has.split() != ["1", "0"]:
        raise InputError(
            f"{path}: line {begin + 4}: expected '1 0' (reflection, no transmission), got "
            f"{shown(has)}"
        )
    if kind != "0":
        raise InputError(
            f"{path}: line {begin + 5}: expected 0 (values that go with intensity), got "
            f"{shown(kind)}"
        )
    return incidence


def _numbers(path: Path, at: int, text: str) -> list[float]:
    cells = text.split()
    if not cells:
        raise InputError(f"{path}: line {at + 1}: expected numbers, got an empty line")
    return [number(path, at + 1, column, cell) for column, cell in enumerate(cells, 1)]
