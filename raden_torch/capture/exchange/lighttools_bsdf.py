"""LightTools' own text of a BSDF, `.bsdf` (Synopsys).

    Symmetry  Asymmetric
    SpectralContent  Monochrome | XYZ
    ScatterAzimuth  72         each followed by that many angles in degrees
    ScatterRadial  36
    DataBegin
    AOI  10                    a block an incidence (and a tristimulus value)
    POI  0
    Side  Front
    Wavelength  550            or TristimulusValue  TrisX | TrisY | TrisZ
    ScatterType  BRDF
    TIS  0.31
    …                          a row of radial values an azimuth
    DataEnd

Values are BSDF in 1/sr: the reflectance factor is 100 π of them. Words are read wherever lines
break; lines that start with # are comments.

**Geometry.** Radial and azimuth are polar angles about the *normal*; the light stands at azimuth
90, so the mirror is at 270. AOI is the incidence. POI (the plane of incidence) is taken as the
sample's azimuth. Blocks of the back and of transmission are left out, and counted.

**What it does not hold.** The white of XYZ (D65 is taken), spread, a mark for "not measured":
values of exactly 0 are left out.

Source: the layout as `LightToolsBsdfReader` of libbsdf takes it (K. Ryo); Synopsys publishes none.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import ONE_BAND, measurement_of
from raden_torch.capture.exchange.scatter_grid import ScatterGrid, light_and_view
from raden_torch.capture.exchange.text import (
    Words,
    check_values,
    digits,
    first_lines,
    named,
    title,
    write_lines,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, XYZ
from raden_torch.measurement.text_file import shown

MAX_VALUES = 20_000_000
_MAX_ANGLES = 10_000
_MIRROR_DEG = 270.0
_TRISTIMULUS = ("TrisX", "TrisY", "TrisZ")
_AXES = ("ScatterAzimuth", "ScatterRadial")
_CONTENT = {"Monochrome": 1, "XYZ": 3}


@dataclass
class _Block:
    """One incidence, of one channel."""

    line: int
    entries: dict[str, str] = field(default_factory=dict)
    incidence_deg: float = 0.0
    plane_deg: float = 0.0
    channel: int = 0


def recognises(head: str) -> bool:
    """True where the header's words stand first, after comments."""
    lines = [line for line in first_lines(head, 10_000) if not line.startswith("#")][:4]
    return any(re.fullmatch(r"Symmetry\s+Asymmetric(4D)?", line) for line in lines)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read the front's reflection.

    Raises:
        InputError: names the line, and what would be right; no reflection of the front.
    """
    path = Path(path)
    words = Words.of(path, comments="#")
    sample = re.search(r"^#\s*Sample:(.*)", words.comments, re.MULTILINE)
    about = named(sample[1] if sample else "", path.stem)
    content, azimuth, radial = _header(words)
    size = len(azimuth) * len(radial)
    blocks, rows, skipped = [], [], 0
    while (word := words.next("a block's AOI, or DataEnd")) != "DataEnd":
        block = _block(words, word, content)
        if size > words.left:
            raise InputError(
                f"{path}: line {words.line}: expected {len(azimuth)} x {len(radial)} values by its "
                f"header, got at most {words.left}; the file is truncated"
            )
        values = words.numbers(size, "values")
        if block is None:
            skipped += 1
            continue
        blocks.append(block)
        rows.append(values)
    if not blocks:
        raise InputError(
            f"{path}: expected the front's reflection (Side Front, ScatterType BRDF), got "
            f"{skipped} blocks of transmission or of the back"
        )
    notes = [f"{skipped} blocks of transmission or of the back left out"] if skipped else []
    about = replace(about, notes=tuple(notes))
    return _measurement(path, content, blocks, np.array(rows), (azimuth, radial), about)


def _header(words: Words) -> tuple[str, Floats, Floats]:
    content, axes = "", {}
    while (word := words.next("DataBegin")) != "DataBegin":
        if word == "SpectralContent":
            content = words.one_of(word, tuple(_CONTENT))
        elif word == "Symmetry":
            words.one_of(word, ("Asymmetric", "Asymmetric4D"))
        elif word in _AXES:
            axes[word] = words.numbers(words.count(word, _MAX_ANGLES), f"angles of {word}")
            if not (abs(axes[word]) <= 360).all():
                raise InputError(
                    f"{words.path}: line {words.line}: {word}: expected at most 360 degrees"
                )
        else:
            words.next(f"a value of {word}")
    for name, there in (("SpectralContent", content), *((n, n in axes) for n in _AXES)):
        if not there:
            raise InputError(f"{words.path}: expected '{name}' before DataBegin, got none")
    return content, axes["ScatterAzimuth"], axes["ScatterRadial"]


def _block(words: Words, word: str, content: str) -> _Block | None:
    """What stands before a block's values; None of transmission or of the back."""
    block, kept = _Block(words.line), True
    while word != "TIS":
        if word == "AOI":
            block.incidence_deg = words.number(word, 0, 90)
        elif word == "POI":
            block.plane_deg = words.number(word, -360, 360)
        elif word == "Side":
            kept &= words.one_of(word, ("Front", "Back")) == "Front"
        elif word == "ScatterType":
            kept &= words.one_of(word, ("BRDF", "BTDF")) == "BRDF"
        elif word == "TristimulusValue":
            block.channel = _TRISTIMULUS.index(words.one_of(word, _TRISTIMULUS))
        elif word == "Wavelength":
            block.entries[word] = f"{words.number(word, 0, 1e6):g}"
        else:
            raise InputError(
                f"{words.path}: line {words.line}: expected AOI, POI, Side, Wavelength, "
                f"ScatterType, TristimulusValue or TIS, got {shown(word)}"
            )
        word = words.next("TIS")
    words.number("TIS", -np.inf, np.inf)
    return block if kept else None


def _measurement(
    path: Path,
    content: str,
    blocks: list[_Block],
    rows: Floats,
    axes: tuple[Floats, Floats],
    about: Metadata,
) -> BrdfMeasurement:
    notes = list(about.notes)
    channels = _CONTENT[content]
    place: dict[tuple[float, float], dict[int, int]] = {}
    for i, block in enumerate(blocks):
        own = place.setdefault((block.plane_deg, block.incidence_deg), {})
        if block.channel in own:
            raise InputError(f"{path}: line {block.line}: expected another AOI, got one twice")
        own[block.channel] = i
    for (_, incidence), own in place.items():
        if set(own) != set(range(channels)):
            raise InputError(
                f"{path}: AOI {incidence:g}: expected {channels} blocks ({content}), got {len(own)}"
            )
    table = np.stack([rows[[own[c] for c in range(channels)]].T for own in place.values()])
    planes, incidences = np.array(list(place)).T
    azimuth, radial = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    one = np.ones(len(azimuth))
    angles = (
        np.outer(incidences, one).ravel(),
        np.tile(azimuth - _MIRROR_DEG, len(planes)),
        np.tile(radial, len(planes)),
    )
    light, view = light_and_view(*map(np.deg2rad, angles), about="normal")
    values = table.reshape(-1, channels)
    filling = (values == 0).all(axis=1)
    if filling.all():
        raise InputError(f"{path}: expected a measurement, got values that are all 0")
    if filling.any():
        notes.append(f"{int(filling.sum())} readings of exactly 0 left out as not measured")
    nm = blocks[0].entries.get("Wavelength", "0")
    names: tuple[str, ...]
    if content == "XYZ":
        names, note = XYZ, "white taken as D65"
    elif nm != "0":
        names, note = (f"{nm}nm",), ""
    else:
        names = ONE_BAND
        note = f"the file names no wavelength, the band is called {names[0]}"
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        factors = FACTOR_PER_SR * values[~filling]
    return measurement_of(
        path,
        light[:, ~filling],
        view[:, ~filling],
        factors,
        names,
        metadata=replace(about, notes=tuple(filter(None, [note, *notes]))),
        azimuth_deg=np.outer(planes, one).ravel()[~filling],
        average_repeats=True,
    )


def write(
    path: Path, grid: ScatterGrid, f_r: Floats, channels: tuple[str, ...], metadata: Metadata
) -> None:
    """Write a grid about the normal.

    Args:
        f_r: `[M, C]` in 1/sr in the order of `grid.nodes()`; NaN, where nothing is known, becomes
            0.
        channels: X, Y and Z, or one.

    Raises:
        InputError: more values than a text file can hold.
    """
    check_values(path, grid.shape, len(channels))
    order = np.argsort((grid.azimuth_deg + _MIRROR_DEG) % 360)
    table = f_r.reshape(*grid.shape, -1)[:, :, order].reshape(f_r.shape)
    turned = (grid.azimuth_deg[order] + _MIRROR_DEG) % 360
    write_lines(path, _written(replace(grid, azimuth_deg=turned), table, channels, metadata))


def _written(
    grid: ScatterGrid, f_r: Floats, channels: tuple[str, ...], metadata: Metadata
) -> Iterator[str]:
    is_xyz = channels == XYZ
    yield f"# Sample: {title(metadata)}"
    yield "Symmetry  Asymmetric"
    yield f"SpectralContent  {'XYZ' if is_xyz else 'Monochrome'}"
    for name, axis in (("ScatterAzimuth", grid.azimuth_deg), ("ScatterRadial", grid.radial_deg)):
        yield from (f"{name}  {len(axis)}", digits(axis))
    yield "DataBegin"
    totals = grid.totals(f_r)
    table = np.nan_to_num(f_r).reshape(*grid.shape, len(channels))
    for rotation, incidence, c in np.ndindex(*grid.shape[:2], len(channels)):
        yield f"AOI  {grid.incidence_deg[incidence]:.9g}"
        yield f"POI  {grid.rotation_deg[rotation]:.9g}"
        yield "Side  Front"
        if not is_xyz:
            yield f"Wavelength  {channels[0].removesuffix('nm')}"
        yield "ScatterType  BRDF"
        if is_xyz:
            yield f"TristimulusValue  {_TRISTIMULUS[c]}"
        yield f"TIS  {totals[rotation, incidence, c]:.6g}"
        yield from map(digits, table[rotation, incidence, :, :, c])
    yield "DataEnd"
