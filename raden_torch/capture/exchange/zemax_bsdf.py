"""The Zemax (Radiant) tabular BSDF interchange file, `.bsdf`.

    Source  Measured
    Symmetry  PlaneSymmetrical | Asymmetrical | Asymmetrical4D
    SpectralContent  Monochrome | XYZ
    ScatterType  BRDF | BTDF
    SampleRotation  1          each followed by a line with that many angles in degrees
    AngleOfIncidence  4
    ScatterAzimuth  19
    ScatterRadial  12
    Monochrome                 or TristimulusX, then …Y and …Z with their own data
    DataBegin
    TIS 0.108                  a block a rotation and incidence, with a row of radial values
    …                          an azimuth
    DataEnd

Values are BSDF in 1/sr: the reflectance factor is 100 π of them. Lines that start with # are
comments.

**Geometry.** Radial and azimuth are polar angles about the *specular* direction S, not about the
normal; azimuth 0 points from S towards the normal and turns counter-clockwise, looking at the
sample. Directions that this puts below the horizon are only filling and are left out. With
`PlaneSymmetrical` the file holds one side of the plane of incidence; the other is added as its
mirror image, which is what the word says. `SampleRotation` is the sample's azimuth.

**What it does not hold.** The wavelength of a monochrome file (a "… nm" in its comments is
taken); the white of XYZ (D65 is taken, perfect diffuser 1/π); spread; a mark for "not measured":
writers put 0, so readings of exactly 0 are left out. Negative noise has been removed by most
writers.

Source: "BSDF Data Interchange File Format Specification" (R. Rykowski), Zemax knowledge base.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import (
    NOMINAL_NM,
    measurement_of,
)
from raden_torch.capture.exchange.scatter_grid import ScatterGrid, light_and_view
from raden_torch.capture.exchange.text import (
    check_values,
    digits,
    first_lines,
    named,
    number,
    read_lines,
    stated_nm,
    title,
    whole_number,
    write_lines,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, XYZ
from raden_torch.measurement.text_file import shown

MAX_VALUES = 20_000_000
_MAX_ANGLES = 10_000
_WORDS = {
    "Source": ("Measured",),
    "Symmetry": ("PlaneSymmetrical", "Asymmetrical", "Asymmetrical4D"),
    "SpectralContent": ("Monochrome", "XYZ"),
    "ScatterType": ("BRDF",),
}
_AXES = {  # largest angle in degrees, in the order of the data
    "SampleRotation": 360.0,
    "AngleOfIncidence": 90.0,
    "ScatterAzimuth": 360.0,
    "ScatterRadial": 180.0,
}
_SECTIONS = {
    "Monochrome": ("Monochrome",),
    "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ"),
}


@dataclass
class _Lines:
    """The lines that are neither empty nor comments, with their numbers, and where we are."""

    path: Path
    rows: list[tuple[int, list[str]]]
    at: int = 0

    def next(self, wanted: str) -> tuple[int, list[str]]:
        if self.at == len(self.rows):
            raise InputError(
                f"{self.path}: expected {wanted}, got the end of the file: it is truncated"
            )
        self.at += 1
        return self.rows[self.at - 1]

    def keyword(self, word: str, others: int, shape: str) -> tuple[int, list[str]]:
        """The cells after a keyword, which the next line must start with."""
        line, cells = self.next(f"'{shape}'")
        if cells[0].lower() != word.lower() or len(cells) != 1 + others:
            raise InputError(
                f"{self.path}: line {line}: expected '{shape}', got {shown(' '.join(cells))}"
            )
        return line, cells[1:]

    def numbers(self, count: int, what: str) -> tuple[int, list[float]]:
        line, cells = self.next(f"a row of {count} {what}")
        if len(cells) != count:
            raise InputError(f"{self.path}: line {line}: expected {count} {what}, got {len(cells)}")
        return line, [number(self.path, line, c, cell) for c, cell in enumerate(cells, 1)]


def recognises(head: str) -> bool:
    """True where a keyword of the header stands first, after comments."""
    lines = [line for line in first_lines(head, 10_000) if not line.startswith("#")][:4]
    starts = r"Source\s+Measured|Symmetry\s+A?(Plane)?Symmetrical(4D)?|SpectralContent\s+\w+"
    return any(re.fullmatch(starts, line, re.IGNORECASE) for line in lines)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file.

    Raises:
        InputError: names the line and column, and what would be right; a transmission (BTDF) file.
    """
    path = Path(path)
    text = read_lines(path)
    rows = [(i, line.split()) for i, line in enumerate(text, 1) if line.strip()]
    lines = _Lines(path, [row for row in rows if not row[1][0].startswith("#")])
    words = {name: _word(lines, name) for name in _WORDS}
    axes = [_axis(lines, name) for name in _AXES]
    sections = _SECTIONS[words["SpectralContent"]]
    _check_size(lines, axes, len(sections))
    tables = [_table(lines, section, axes) for section in sections]
    comments = [line.strip().lstrip("#").strip() for line in text if line.lstrip()[:1] == "#"]
    channels, metadata = _channels(path, words["SpectralContent"], comments)
    symmetrical = words["Symmetry"] == "PlaneSymmetrical"
    return _measurement(path, axes, np.stack(tables, axis=-1), channels, metadata, symmetrical)


def _word(lines: _Lines, name: str) -> str:
    allowed = _WORDS[name]
    line, (word,) = lines.keyword(name, 1, f"{name} {'|'.join(allowed)}")
    for known in allowed:
        if word.lower() == known.lower():
            return known
    raise InputError(
        f"{lines.path}: line {line}: {name}: expected {' or '.join(allowed)}, got {shown(word)}"
    )


def _axis(lines: _Lines, name: str) -> Floats:
    line, (count,) = lines.keyword(name, 1, f"{name} <number of angles>")
    size = whole_number(lines.path, line, name, count, _MAX_ANGLES)
    line, angles = lines.numbers(size, f"angles of {name}")
    for column, angle in enumerate(angles, 1):
        if not 0 <= angle <= _AXES[name]:
            raise InputError(
                f"{lines.path}: line {line}, column {column}: {name}: expected 0…{_AXES[name]:g} "
                f"degrees, got {angle:g}"
            )
    return np.array(angles)


def _check_size(lines: _Lines, axes: list[Floats], sections: int) -> None:
    sizes = [len(axis) for axis in axes]
    claimed = sections * int(np.prod(sizes, dtype=np.float64))
    there = sum(len(cells) for _, cells in lines.rows[lines.at :])
    if claimed > min(MAX_VALUES, there):
        raise InputError(
            f"{lines.path}: expected {' x '.join(map(str, sizes))} "
            f"values{' x 3' if sections == 3 else ''} by its header, got at most "
            f"{min(MAX_VALUES, there)}; the file is truncated or the header is wrong"
        )


def _table(lines: _Lines, section: str, axes: list[Floats]) -> Floats:
    """`[rotation, incidence, azimuth, radial]` of one section."""
    lines.keyword(section, 0, section)
    lines.keyword("DataBegin", 0, "DataBegin")
    rotations, incidences, azimuths, radials = map(len, axes)
    rows = []
    for _ in range(rotations * incidences):
        line, (total,) = lines.keyword("TIS", 1, "TIS <number>")
        number(lines.path, line, 2, total)
        rows += [lines.numbers(radials, "values")[1] for _ in range(azimuths)]
    lines.keyword("DataEnd", 0, "DataEnd")
    return np.array(rows).reshape(rotations, incidences, azimuths, radials)


def _channels(
    path: Path, spectral_content: str, comments: list[str]
) -> tuple[tuple[str, ...], Metadata]:
    about = named("", path.stem)
    other = []
    for comment in comments:
        key, colon, value = (part.strip() for part in comment.partition(":"))
        if not colon or not value:
            continue
        if key.lower() in ("sample", "name"):
            about = replace(named(value, path.stem), instrument=about.instrument)
        elif key.lower() == "scatterometer":
            about = replace(about, instrument=value)
        elif re.fullmatch(r"[\w .-]+", key):
            other.append((key, value))
    if spectral_content == "XYZ":
        return XYZ, replace(about, other=tuple(other), notes=("white taken as D65",))
    stated = stated_nm("\n".join(comments))
    nm = stated or NOMINAL_NM
    note = (
        f"wavelength of {nm:g} nm from the comments"
        if stated
        else f"the file names no wavelength, the band is called {nm:g} nm"
    )
    return (f"{nm:g}nm",), replace(about, other=tuple(other), notes=(note,))


def _measurement(
    path: Path,
    axes: list[Floats],
    table: Floats,
    channels: tuple[str, ...],
    metadata: Metadata,
    symmetrical: bool,
) -> BrdfMeasurement:
    rotation, incidence, azimuth, radial = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    values = table.reshape(-1, len(channels))
    notes = list(metadata.notes)
    if symmetrical:
        twin = ~np.isin(azimuth % 180, 0) & (radial > 0)
        notes.append(f"{int(twin.sum())} readings added as mirror images (PlaneSymmetrical)")
        rotation, incidence, radial = (
            np.concatenate([a, a[twin]]) for a in (rotation, incidence, radial)
        )
        azimuth = np.concatenate([azimuth, -azimuth[twin]])
        values = np.concatenate([values, values[twin]])
    angles = (np.deg2rad(incidence), np.deg2rad(azimuth), np.deg2rad(radial))
    light, view = light_and_view(*angles, about="specular")
    filling = (values == 0).all(axis=1) & (view[2] > 0)
    if filling.all():
        raise InputError(f"{path}: expected a measurement, got values that are all 0")
    if filling.any():
        notes.append(f"{int(filling.sum())} readings of exactly 0 left out as not measured")
    kept = ~filling
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        factors = FACTOR_PER_SR * values[kept]
    return measurement_of(
        path,
        light[:, kept],
        view[:, kept],
        factors,
        channels,
        metadata=replace(metadata, notes=tuple(notes)),
        azimuth_deg=rotation[kept],
        average_repeats=True,
    )


def write(
    path: Path,
    grid: ScatterGrid,
    f_r: Floats,
    channels: tuple[str, ...],
    metadata: Metadata,
) -> None:
    """Write a grid about the specular direction.

    Args:
        f_r: `[M, C]` in 1/sr in the order of `grid.nodes()`; NaN, where nothing is known, becomes
            0, as below the horizon.
        channels: X, Y and Z, or one.

    Raises:
        InputError: more values than a text file can hold.
    """
    check_values(path, grid.shape, len(channels))
    symmetry = "Asymmetrical4D" if len(grid.rotation_deg) > 1 else "Asymmetrical"
    one_side = grid.half(f_r)
    if one_side is not None and symmetry == "Asymmetrical":
        symmetry = "PlaneSymmetrical"
        grid, f_r = one_side
    content = "XYZ" if channels == XYZ else "Monochrome"
    write_lines(path, _written(grid, f_r, channels, symmetry, content, metadata))


def _written(
    grid: ScatterGrid,
    f_r: Floats,
    channels: tuple[str, ...],
    symmetry: str,
    content: str,
    metadata: Metadata,
) -> Iterator[str]:
    yield f"# Sample: {title(metadata)}"
    if metadata.instrument:
        yield "# Scatterometer: " + " ".join(metadata.instrument.split())
    if content == "Monochrome":
        yield f"# Wavelength: {channels[0].removesuffix('nm')} nm"
    yield from ("Source  Measured", f"Symmetry  {symmetry}", f"SpectralContent  {content}")
    yield "ScatterType  BRDF"
    axes = (grid.rotation_deg, grid.incidence_deg, grid.azimuth_deg, grid.radial_deg)
    for name, axis in zip(_AXES, axes, strict=True):
        yield from (f"{name}  {len(axis)}", digits(axis))
    yield ""
    totals = grid.totals(f_r)
    table = np.nan_to_num(f_r).reshape(*grid.shape, len(channels))
    for c, section in enumerate(_SECTIONS[content]):
        yield from (section, "DataBegin")
        for rotation, incidence in np.ndindex(grid.shape[:2]):
            yield f"TIS  {totals[rotation, incidence, c]:.6g}"
            yield from map(digits, table[rotation, incidence, :, :, c])
        yield "DataEnd"
