"""The rig file: TOML, checked completely before anything is opened or moves. See docs/rig.md."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct
from msgspec.structs import replace

from raden_torch.capture.spectrometer import drivers
from raden_torch.capture.spectrometer.ports import Position, Target
from raden_torch.capture.spectrometer.rig import (
    ANGLES,
    MANUAL,
    Angle,
    Axis,
    ColorimeterSettings,
    GoniometerSettings,
    Obstruction,
    Rig,
    WhiteReference,
)
from raden_torch.errors import InputError
from raden_torch.schema import Text, checked, read_document

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

MAX_BYTES = 1_000_000

_MAX_GCODE_CHARS = 70  # GRBL's line buffer holds 80
_FORBIDDEN_IN_GCODE = re.compile(r"[^\x20-\x7e]|[?!~$]")
_MOVES_ELSEWHERE = re.compile(r"G\s*0*(10|28|30|92)(?!\d)")
_QUESTIONS = {
    Target.SAMPLE: "Put the sample in place, with the lamp open",
    Target.WHITE: "Put the white reference in the sample's place, with the lamp open",
    Target.DARK: "Shut the lamp",
}


RightAngle = Annotated[float, Meta(ge=-90, le=90)]


class _White(Struct, forbid_unknown_fields=True):
    reflectance_factor: Annotated[float, Meta(ge=0, le=1000)] | None = None
    file: Text | None = None
    geometry_deg: tuple[RightAngle, RightAngle, RightAngle] = (45.0, 0.0, 0.0)
    name: Text = "white reference"
    relative_std: Annotated[float, Meta(ge=0, le=0.5)] = 0.0


class _RigFile(Struct, forbid_unknown_fields=True):
    goniometer: GoniometerSettings
    colorimeter: ColorimeterSettings
    white: _White
    obstruction: Obstruction = Obstruction()
    name: Text | None = None
    simulated: bool = False


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Read and check a rig file.

    Raises:
        InputError: one line with the file, the key, and what would be right.
    """
    path = Path(path)
    file = checked(read_document(path, "a rig file", tomllib.loads, MAX_BYTES), _RigFile, str(path))
    try:
        rig = _rig(path, file)
        _check_travel(rig)
    except _WrongError as error:
        raise InputError(f"{path}: {_clipped(str(error))}") from None
    return rig


class _WrongError(Exception):
    """What no schema says, in a file that otherwise keeps to it: "key: expected …, got …"."""


def _rig(path: Path, file: _RigFile) -> Rig:
    stage, meter = file.goniometer, file.colorimeter
    _check_driver("goniometer", stage.driver, drivers.GONIOMETERS, drivers.GONIOMETER_GROUP)
    _check_driver("colorimeter", meter.driver, drivers.COLORIMETERS, drivers.COLORIMETER_GROUP)
    if stage.port == meter.port:
        raise _WrongError("colorimeter.port: the goniometer has the same port; each needs its own")
    axes = _axes(stage.axes)
    return Rig(
        name=file.name or path.stem,
        goniometer_settings=replace(stage, axes=axes, shows=_shows(stage.shows, axes)),
        colorimeter_settings=meter,
        obstruction=file.obstruction,
        white=_white(path, file.white),
        simulated=file.simulated,
    )


def _check_driver(key: str, name: str, built_in: dict[str, str], group: str) -> None:
    known = drivers.known(built_in, group)
    if name not in known:
        raise _WrongError(f"{key}.driver: expected one of {', '.join(known)}, got {name!r}")


def _axes(given: Mapping[Angle, Axis]) -> dict[Angle, Axis]:
    """In the order of `ANGLES`, their letters large."""
    axes: dict[Angle, Axis] = {}
    turned: dict[str, str] = {}
    for name in ANGLES:
        key = f"goniometer.axes.{name}"
        if name not in given:
            raise _WrongError(f"{key}: expected a table [{key}], got none")
        axis = replace(given[name], letter=given[name].letter.upper())
        low, high = axis.limits_deg
        if axis.letter in turned:
            raise _WrongError(
                f"{key}.letter: expected a letter of its own, got {axis.letter!r}, which turns "
                f"{turned[axis.letter]} already"
            )
        if low >= high:
            raise _WrongError(
                f"{key}.limits_deg: expected the lower limit first, got [{low:g}, {high:g}]"
            )
        axes[name] = axis
        turned[axis.letter] = name
    return axes


def _shows(
    given: Mapping[Target, tuple[str, ...] | str], axes: dict[Angle, Axis]
) -> dict[Target, tuple[str, ...] | str]:
    shows: dict[Target, tuple[str, ...] | str] = {}
    for target, question in _QUESTIONS.items():
        lines, key = given.get(target, MANUAL), f"goniometer.show.{target.value}"
        if isinstance(lines, str) and lines != MANUAL:
            raise _WrongError(f"{key}: expected a list of G-code lines or 'manual', got {lines!r}")
        shows[target] = question if isinstance(lines, str) else lines
        for line in lines if isinstance(lines, tuple) else ():
            _check_gcode(key, line, {axis.letter for axis in axes.values()})
    return shows


def _check_gcode(key: str, line: str, letters: set[str]) -> None:
    words = re.sub(r"\([^)]*\)|;.*", "", line.upper())
    if not words.strip() or len(line) > _MAX_GCODE_CHARS:
        raise _WrongError(
            f"{key}: expected one G-code line of up to {_MAX_GCODE_CHARS} characters, got {line!r}"
        )
    if _FORBIDDEN_IN_GCODE.search(line):
        raise _WrongError(
            f"{key}: expected G-code words only, without $ ? ! ~ or line ends, got {line!r}"
        )
    if _MOVES_ELSEWHERE.search(words):
        raise _WrongError(
            f"{key}: expected only G0, G1, G4 and M words, which are safe, got {line!r}, which "
            "changes coordinates",
        )
    driven = sorted(letter for letter in letters if letter in words)
    if driven:
        raise _WrongError(
            f"{key}: expected a line that keeps within the limits, got {line!r}, which would drive "
            f"{', '.join(driven)} past them; use other axes",
        )


def _white(path: Path, table: _White) -> WhiteReference:
    geometry, factor = Position(*table.geometry_deg), table.reflectance_factor
    if (factor is None) == (table.file is None):
        raise _WrongError(
            "white.reflectance_factor: expected this or `file` (100 is perfect white), got "
            f"{'neither' if factor is None else 'both'}"
        )
    if table.file is None:
        if factor == 0.0:
            raise _WrongError(
                "white.reflectance_factor: expected above 0, since readings are divided by it "
                "(99, say), got 0"
            )
        if factor is not None and factor <= 1.5:
            raise _WrongError(
                "white.reflectance_factor: expected percent (the perfect diffuser is 100 here, not "
                f"1), got {factor:g}"
            )
        return WhiteReference(factor, None, geometry, table.name, table.relative_std)
    white = WhiteReference(None, path.parent / table.file, geometry, table.name, table.relative_std)
    xyz = white.xyz(geometry)
    if not (xyz > 0).all():
        raise _WrongError(
            f"white.file: expected XYZ above 0 at the white's geometry, got {xyz.tolist()} in "
            f"{table.file!r}"
        )
    return white


def _check_travel(rig: Rig) -> None:
    approach = rig.goniometer_settings.approach_deg
    for name, axis in rig.goniometer_settings.axes.items():
        low, high = axis.limits_deg
        if high - low <= approach:
            raise _WrongError(
                f"goniometer.axes.{name}.limits_deg: {low:g}…{high:g} leaves no room for "
                f"approach_deg = {approach:g}"
            )
    reason = rig.reachable(rig.white.geometry)
    if reason:
        raise _WrongError(f"white.geometry_deg: out of reach: {reason}")


def _clipped(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 200 else text[:200] + "…"
