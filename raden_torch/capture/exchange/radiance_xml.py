"""The XML of a BSDF that WINDOW and Radiance's genBSDF write (LBNL): Klems matrix and tensor tree.

    <WindowElement><Optical><Layer>
      <Material><Name>…</Name><Manufacturer>…</Manufacturer></Material>
      <DataDefinition>
        <IncidentDataStructure>Columns | Rows | TensorTree3 | TensorTree4</…>
        <AngleBasis>…</AngleBasis>          of a matrix: polar bounds and azimuths of its patches
      </DataDefinition>
      <WavelengthData>
        <Wavelength>Visible | CIE-X | CIE-Z</Wavelength>
        <WavelengthDataBlock>
          <WavelengthDataDirection>Reflection Front | Reflection Back | Transmission …</…>
          <ScatteringData>numbers</ScatteringData>
        …

Values are BRDF in 1/sr: the reflectance factor is 100 π of them. Of a matrix each pair of patches
is a reading at their middles; with `Columns` the numbers of one outgoing patch follow each other,
with `Rows` those of one incident patch. Of a tree each leaf is; leaves wider than an eighth of
their axes are read as eighths. An incident azimuth is kept as the sample's.

**Sides.** `Reflection Front` is read where it is there, else `Reflection Back`: what WINDOW calls
front Radiance calls back, and its directions are those seen from behind.

**Colour.** `Visible` with CIE-X and CIE-Z is XYZ, taken with white E, as Radiance's greys have
X = Y = Z; `Visible` alone is one band. Other wavelengths (Solar, NIR) are left out.

**What it does not hold.** Anything finer than its patches (of 10 degrees in the full Klems basis);
spread; negative values. Transmission is not read.

Source: Radiance's bsdf_m.c, bsdf_t.c, disk2square.c and genBSDF, for the order of numbers and the
directions of both sides.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import NOMINAL_NM, ONE_BAND, measurement_of
from raden_torch.capture.exchange.tensor_tree import leaves, tree_directions
from raden_torch.capture.exchange.text import MAX_BYTES
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, XYZ
from raden_torch.measurement.text_file import read_text, shown

KLEMS = {
    "lbnl/klems full": ((0, 5, 15, 25, 35, 45, 55, 65, 75, 90), (1, 8, 16, 20, 24, 24, 24, 16, 12)),
    "lbnl/klems half": ((0, 6.5, 19.5, 32.5, 46.5, 61.5, 76.5, 90), (1, 8, 12, 16, 20, 12, 4)),
    "lbnl/klems quarter": ((0, 9, 27, 46, 66, 90), (1, 8, 12, 12, 8)),
}
"""Polar bounds in degrees, and the number of azimuths between each pair."""

_MAX_PATCHES = 2_500
_COLOURS = ("cie-x", "visible", "cie-z")
_SIDES = ("reflection front", "reflection back")
_RANKS = {"tensortree3": 3, "tensortree4": 4}


@dataclass(frozen=True)
class _Readings:
    """Directions `[3, M]`, the sample's azimuth `[M]` and f_r `[M]` of one block."""

    light: Floats
    view: Floats
    azimuth_deg: Floats
    f_r: Floats


def recognises(head: str) -> bool:
    """True where XML of a window element begins."""
    return bool(re.match(r"\s*<", head)) and "<WindowElement" in head


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read the reflection of one side.

    Raises:
        InputError: no XML, or not of this kind; transmission only; too few numbers.
    """
    path = Path(path)
    layer = _layer(path)
    structure = _text(layer, "DataDefinition/IncidentDataStructure").lower()
    if structure not in (*_RANKS, "rows", "columns"):
        raise InputError(
            f"{path}: IncidentDataStructure: expected Rows, Columns, TensorTree3 or TensorTree4, "
            f"got {shown(structure)}"
        )
    side, blocks = _blocks(path, layer)
    bases = KLEMS | _own_bases(path, layer)
    readings = {
        colour: _tree(path, block, _RANKS[structure])
        if structure in _RANKS
        else _matrix(path, block, bases, by_rows=structure == "rows")
        for colour, block in blocks.items()
    }
    return _measurement(path, layer, side, readings)


def _layer(path: Path) -> ElementTree.Element:
    text = read_text(path, MAX_BYTES).text
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: expected XML without a DOCTYPE, got one")
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except ElementTree.ParseError as error:
        line = error.position[0]
        raise InputError(
            f"{path}: line {line}: expected whole XML, got an error ({error}): the file is "
            "truncated or damaged"
        ) from None
    for element in root.iter():
        element.tag = str(element.tag).rpartition("}")[2]
    layers = root.findall("Optical/Layer")
    if root.tag != "WindowElement" or not layers:
        raise InputError(
            f"{path}: expected a WindowElement with Optical and Layer, got {shown(root.tag)}"
        )
    return layers[0]


def _text(element: ElementTree.Element, place: str) -> str:
    return " ".join((element.findtext(place) or "").split())


def _blocks(path: Path, layer: ElementTree.Element) -> tuple[str, dict[str, ElementTree.Element]]:
    """Which side is read, and its blocks by colour."""
    found: dict[str, dict[str, ElementTree.Element]] = {}
    directions = set()
    for data in layer.findall("WavelengthData"):
        colour = _text(data, "Wavelength").lower()
        for block in data.findall("WavelengthDataBlock"):
            direction = _text(block, "WavelengthDataDirection").lower()
            directions.add(direction)
            if colour in _COLOURS:
                found.setdefault(direction, {})[colour] = block
    for side in _SIDES:
        own = found.get(side, {})
        if set(own) >= set(_COLOURS):
            return side, {colour: own[colour] for colour in _COLOURS}
        if "visible" in own:
            return side, {"visible": own["visible"]}
    raise InputError(
        f"{path}: expected a block 'Reflection Front' or 'Reflection Back' of Wavelength Visible, "
        f"got {', '.join(sorted(directions)) or 'no block'}"
    )


def _own_bases(
    path: Path, layer: ElementTree.Element
) -> dict[str, tuple[tuple[float, ...], tuple[int, ...]]]:
    """Angle bases that the file itself defines."""
    bases = {}
    for basis in layer.findall("DataDefinition/AngleBasis"):
        name = _text(basis, "AngleBasisName")
        bounds, azimuths = [0.0], []
        for block in basis.findall("AngleBasisBlock"):
            upper = _number(path, _text(block, "ThetaBounds/UpperTheta"), "UpperTheta")
            count = _number(path, _text(block, "nPhis"), "nPhis")
            if not (bounds[-1] < upper <= 90 and count == round(count) and count >= 1):
                raise InputError(
                    f"{path}: AngleBasis {shown(name)}: expected ascending bounds up to 90 degrees "
                    f"and whole numbers of azimuths, got {upper:g} and {count:g}"
                )
            bounds.append(upper)
            azimuths.append(int(count))
        if azimuths and sum(azimuths) <= _MAX_PATCHES:
            bases[name.lower()] = (tuple(bounds), tuple(azimuths))
    return bases


def _patches(bounds: tuple[float, ...], azimuths: tuple[int, ...]) -> tuple[Floats, Floats]:
    """`[P]` polar angle and azimuth of the patches' middles, in radians; the first is the pole."""
    middles = (np.array(bounds[:-1]) + bounds[1:]) / 2
    if azimuths[0] == 1:
        middles[0] = 0.0
    polar = np.repeat(middles, azimuths)
    around = np.concatenate([360 * np.arange(n) / n for n in azimuths])
    return np.deg2rad(polar), np.deg2rad(around)


def _matrix(
    path: Path,
    block: ElementTree.Element,
    bases: dict[str, tuple[tuple[float, ...], tuple[int, ...]]],
    *,
    by_rows: bool,
) -> _Readings:
    angles = []
    for place in ("ColumnAngleBasis", "RowAngleBasis"):  # incident, outgoing
        name = _text(block, place)
        if name.lower() not in bases:
            raise InputError(
                f"{path}: {place}: expected LBNL/Klems Full, Half or Quarter, or one that the file "
                f"defines, got {shown(name)}"
            )
        angles.append(_patches(*bases[name.lower()]))
    (theta_i, phi_i), (theta_o, phi_o) = angles
    values = _numbers(path, block)
    incident, outgoing = len(theta_i), len(theta_o)
    if len(values) != incident * outgoing:
        raise InputError(
            f"{path}: ScatteringData: expected {incident} x {outgoing} numbers, got {len(values)}"
        )
    table = values.reshape(incident, outgoing) if by_rows else values.reshape(outgoing, incident).T
    i, o = (x.ravel() for x in np.indices((incident, outgoing)))
    light = _direction(theta_i[i], phi_i[i] + np.pi)
    azimuth = np.where(theta_i[i] > 0, np.rad2deg(phi_i[i]), 0.0)
    return _Readings(light, _direction(theta_o[o], phi_o[o]), azimuth, table.ravel())


def _direction(polar: Floats, azimuth: Floats) -> Floats:
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)])


def _tree(path: Path, block: ElementTree.Element, rank: int) -> _Readings:
    basis = _text(block, "AngleBasis")
    if basis.lower() != "lbnl/shirley-chiu":
        raise InputError(f"{path}: AngleBasis: expected LBNL/Shirley-Chiu, got {shown(basis)}")
    centres, values = leaves(path, block.findtext("ScatteringData") or "", rank)
    light, view = tree_directions(centres)
    azimuth = np.rad2deg(np.arctan2(-light[1], -light[0])) % 360
    azimuth[np.hypot(light[0], light[1]) < 1e-9] = 0.0
    return _Readings(light, view, azimuth, values)


def _numbers(path: Path, block: ElementTree.Element) -> Floats:
    words = (block.findtext("ScatteringData") or "").replace(",", " ").split()
    return np.array([_number(path, word, "ScatteringData") for word in words])


def _number(path: Path, word: str, what: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{path}: {what}: expected a number, got {shown(word)}")
    return value


def _measurement(
    path: Path, layer: ElementTree.Element, side: str, readings: dict[str, _Readings]
) -> BrdfMeasurement:
    first = readings["visible"]
    if any(len(own.f_r) != len(first.f_r) for own in readings.values()):
        raise InputError(f"{path}: expected CIE-X, Visible and CIE-Z on the same leaves, got other")
    light, view, azimuth = first.light.copy(), first.view.copy(), first.azimuth_deg
    if side == _SIDES[0]:  # seen from behind, which turns the other way round
        light[1], view[1] = -light[1], -view[1]
        azimuth = -azimuth % 360
    channels: tuple[str, ...] = XYZ
    if len(readings) == 3:
        white = "E"
        note = "white taken as E, as Radiance's greys have X = Y = Z"
        f_r = np.stack([readings[colour].f_r for colour in _COLOURS], axis=1)
    else:
        channels, white, f_r = ONE_BAND, "D65", first.f_r[:, None]
        note = f"Visible alone (luminance), the band is called {NOMINAL_NM:g} nm"
    names = (_text(layer, "Material/Name"), _text(layer, "Material/Manufacturer"))
    other = (("manufacturer", names[1]),) if names[1] else ()
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        factors = FACTOR_PER_SR * f_r
    return measurement_of(
        path,
        light,
        view,
        factors,
        channels,
        metadata=Metadata(
            names[0] or path.stem, white=white, other=other, notes=(f"{side}; {note}",)
        ),
        azimuth_deg=azimuth,
        average_repeats=True,
    )
