"""SPEOS' text of an anisotropic BSDF, `.anisotropicbsdf` ("OPTIS - Anisotropic BSDF surface file",
v7.0 and v8.0, text mode).

    OPTIS - Anisotropic BSDF surface file v8.0
    0                          text
    a comment
    5                          so many characters of description follow
    shell
    0 1 0                  anisotropy vector
    1 0                      has reflection, has transmission
    1                          values go with the BSDF (0: with intensity, BSDF · cos θ)
    1                          sample azimuths, and which
    0
    3                          incidences, and which, once for each azimuth
    0 30 60
    0 0                      incidence and azimuth at which the spectrum was measured

    2                          that many lines of wavelength in nm and percent
    350 31
    850 31
    19 72                      a table an azimuth and incidence: polar angles, azimuths
        0 5 …
    0 0.1 0.1 …
    End of file

Polar angles are about the normal; azimuth 0 is taken as the mirror's side, counter-clockwise seen
from above. The spectrum gives the scale: BSDF = percent/100 · value / ∫ value cos θ dω, with the
integral of the spectrum's own incidence by the trapezoidal rule. A scale within 1e-4 of 1 is
rounding, and the values are taken as they stand.

**What it does not hold.** A distribution for each colour: the spectrum is one factor for all
directions, so a colour that changes with the angle is lost (the first wavelength's percent is
read); white, spread, a mark for "not measured": values of exactly 0 are left out.

Source: Ansys help, "Structure of Anisotropic BSDF Files", and the layout that Ansys' converters
from other formats write (their azimuth 0 is the mirror's).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import NOMINAL_NM, measurement_of
from raden_torch.capture.exchange.scatter_grid import ScatterGrid, light_and_view
from raden_torch.capture.exchange.text import (
    Words,
    check_values,
    digits,
    first_lines,
    named,
    read_lines,
    stated_nm,
    title,
    whole_number,
    write_lines,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.measurement.text_file import shown

_TITLE = "OPTIS - Anisotropic BSDF surface file"
_VERSION = "v8.0"
_READ = ("v7.0", "v8.0")
_MAX_ANGLES = 10_000
_MAX_TEXT = 100_000
_ROUNDING = 1e-4  # of the scale


def recognises(head: str) -> bool:
    """True where the first line is the format's title, of a version that is read here."""
    lines = first_lines(head, 1)
    return bool(lines) and lines[0] in [f"{_TITLE} {version}" for version in _READ]


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read the reflection.

    Raises:
        InputError: names the line, and what would be right; binary mode; transmission.
    """
    path = Path(path)
    lines = read_lines(path)
    text, begin = _texts(path, lines)
    words = Words.of(path, begin=begin)
    words.numbers(3, "numbers (the anisotropy vector)")
    sides = words.next("1 0"), words.next("1 0")
    if sides != ("1", "0"):
        raise InputError(
            f"{path}: line {words.line}: expected '1 0' (reflection, no transmission), got "
            f"{shown(' '.join(sides))}"
        )
    with_cosine = words.one_of("kind of values", ("0", "1")) == "0"
    rotations = words.numbers(words.count("azimuths", _MAX_ANGLES), "azimuths")
    incidences = [words.numbers(words.count("incidences", _MAX_ANGLES), "incidences")
        for _ in rotations]  # fmt: skip
    _check(words, "azimuths", rotations, 360)
    _check(words, "incidences", np.concatenate(incidences), 90)
    at = words.numbers(2, "angles of the spectrum")
    spectrum = words.numbers(2 * words.count("wavelengths", _MAX_ANGLES), "numbers of the spectrum")
    tables = [
        (rotation, incidence, *_table(words))
        for rotation, own in zip(rotations, incidences, strict=True)
        for incidence in own
    ]
    if words.left and words.next("End of file") != "End":
        raise InputError(f"{path}: line {words.line}: expected 'End of file', got more numbers")
    scale = _scale(path, tables, at, spectrum[1] / 100, with_cosine)
    return _measurement(path, tables, scale, with_cosine, text)


def _texts(path: Path, lines: list[str]) -> tuple[str, int]:
    """Comment and description, and the index of the line after them."""
    if len(lines) < 5:
        raise InputError(f"{path}: expected a header of 5 lines, got {len(lines)}: it is truncated")
    if lines[1].strip() != "0":
        raise InputError(f"{path}: line 2: expected 0 (text mode), got {shown(lines[1])}")
    left = whole_number(path, 4, "characters", lines[3].strip(), _MAX_TEXT)
    at, description = 4, []
    while left > 0 and at < len(lines):
        description.append(lines[at])
        left -= len(lines[at]) + 1
        at += 1
    return "\n".join([lines[2], *description]), at


def _table(words: Words) -> tuple[Floats, Floats, Floats]:
    """Polar angles `[P]`, azimuths `[A]` and values `[P, A]` of one incidence."""
    polar = words.count("polar angles", _MAX_ANGLES)
    azimuths = words.count("azimuths", _MAX_ANGLES)
    if (polar + 1) * azimuths > words.left:
        raise InputError(
            f"{words.path}: line {words.line}: expected a table of {polar} x {azimuths}, got at "
            f"most {words.left} numbers; the file is truncated or the header is wrong"
        )
    azimuth = words.numbers(azimuths, "azimuths")
    rows = words.numbers(polar * (azimuths + 1), "numbers of a table").reshape(polar, -1)
    _check(words, "azimuths", azimuth, 360)
    _check(words, "polar angles", rows[:, 0], 180)
    return rows[:, 0], azimuth, rows[:, 1:]


def _check(words: Words, what: str, angles: Floats, most: float) -> None:
    wrong = abs(angles) > most
    if wrong.any():
        raise InputError(
            f"{words.path}: line {words.line}: {what}: expected at most {most:g} degrees, got "
            f"{angles[int(np.argmax(wrong))]:g}"
        )


Table = tuple[float, float, Floats, Floats, Floats]


def _scale(path: Path, tables: list[Table], at: Floats, share: float, with_cosine: bool) -> float:
    """What makes BSDF in 1/sr of values, or of values over cos θ."""
    far = [abs(rotation - at[1]) + abs(incidence - at[0]) for rotation, incidence, *_ in tables]
    rotation, incidence, polar, azimuth, values = tables[int(np.argmin(far))]
    order, turned = np.argsort(polar), np.argsort(azimuth % 360)
    around = azimuth[turned] % 360
    kept = np.concatenate([[True], np.diff(around) > 1e-6])  # 0 and 360
    grid = ScatterGrid(
        np.array([rotation]), np.array([incidence]), around[kept], polar[order], "normal"
    )
    f = _bsdf(values, polar, with_cosine)[order][:, turned][:, kept].T.reshape(-1, 1)
    total = float(grid.totals(f)[0, 0, 0])
    if not (total > 0 and share > 0):
        raise InputError(
            f"{path}: expected a spectrum and a table above 0, to scale the values by, got "
            f"{100 * share:g} percent and an integral of {total:g}"
        )
    scale = share / total
    return 1.0 if abs(scale - 1) < _ROUNDING else scale


def _bsdf(values: Floats, polar: Floats, with_cosine: bool) -> Floats:
    if not with_cosine:
        return values
    cosine = np.cos(np.deg2rad(polar))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(cosine[:, None] > 0.01, values / cosine[:, None], 0.0)


def _measurement(
    path: Path, tables: list[Table], scale: float, with_cosine: bool, text: str
) -> BrdfMeasurement:
    columns = []
    for rotation, incidence, polar, azimuth, values in tables:
        p, a = (x.ravel() for x in np.meshgrid(polar, azimuth, indexing="ij"))
        f = scale * _bsdf(values, polar, with_cosine).ravel()
        one = np.ones(len(p))
        columns.append(np.stack([rotation * one, incidence * one, a, p, f]))
    rotation, incidence, azimuth, polar, f = np.concatenate(columns, axis=1)
    filling = f == 0
    if filling.all():
        raise InputError(f"{path}: expected a measurement, got values that are all 0")
    kept = ~filling
    angles = (np.deg2rad(x[kept]) for x in (incidence, azimuth, polar))
    light, view = light_and_view(*angles, about="normal")
    about = named(text.partition("\n")[2].partition(";")[0], path.stem)
    stated = stated_nm(text)
    nm = stated or NOMINAL_NM
    notes = [
        f"wavelength of {nm:g} nm from the comment"
        if stated
        else f"the spectrum is one factor for all directions, the band is called {nm:g} nm",
        f"values times {scale:.6g}, by the spectrum" if scale != 1 else "",
        f"{int(filling.sum())} readings of exactly 0 left out as not measured"
        if filling.any()
        else "",
    ]
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        factors = FACTOR_PER_SR * f[kept, None]
    return measurement_of(
        path,
        light,
        view,
        factors,
        (f"{nm:g}nm",),
        metadata=replace(about, notes=tuple(filter(None, notes))),
        azimuth_deg=rotation[kept],
        average_repeats=True,
    )


def write(
    path: Path, grid: ScatterGrid, f_r: Floats, channels: tuple[str, ...], metadata: Metadata
) -> None:
    """Write a grid about the normal as v8.0, with values in 1/sr and the spectrum that fits them.

    Args:
        f_r: `[M, 1]` in 1/sr in the order of `grid.nodes()`; NaN, where nothing is known, becomes
            0.
        channels: one.

    Raises:
        InputError: more values than a text file can hold.
    """
    check_values(path, grid.shape, 1)
    write_lines(path, _written(grid, f_r, channels[0], title(metadata)))


def _written(grid: ScatterGrid, f_r: Floats, channel: str, name: str) -> Iterator[str]:
    description = f"{name}; {channel.removesuffix('nm')} nm"
    table = np.nan_to_num(f_r).reshape(grid.shape)
    percent = 100 * grid.totals(f_r)[0, 0, 0]
    yield from (f"{_TITLE} {_VERSION}", "0", "written by raden convert")
    yield from (str(len(description)), description, "0\t1\t0", "1\t0", "1")
    yield from (str(len(grid.rotation_deg)), digits(grid.rotation_deg))
    for _ in grid.rotation_deg:
        yield from (str(len(grid.incidence_deg)), digits(grid.incidence_deg))
    yield f"{grid.incidence_deg[0]:.9g}\t{grid.rotation_deg[0]:.9g}"
    yield from ("", "2", f"350\t{percent:.12g}", f"850\t{percent:.12g}")
    for rotation, incidence in np.ndindex(grid.shape[:2]):
        yield f"{len(grid.radial_deg)} {len(grid.azimuth_deg)}"
        yield "\t" + digits(grid.azimuth_deg)
        for polar, row in zip(grid.radial_deg, table[rotation, incidence].T, strict=True):
            yield f"{polar:.9g}\t{digits(row)}"
    yield "End of file"
