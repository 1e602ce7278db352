"""The rig file: TOML, checked completely before anything is opened or moves. See docs/rig.md."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from raden_torch.capture.spectrometer import drivers
from raden_torch.capture.spectrometer.ports import Position, Target
from raden_torch.capture.spectrometer.rig import (
    ANGLES,
    ColorimeterSettings,
    GoniometerSettings,
    Obstruction,
    Rig,
    WhiteReference,
)
from raden_torch.capture.spectrometer.white_reference import UNNAMED
from raden_torch.errors import InputError
from raden_torch.schema import Text, checked, read_document

MAX_BYTES = 1_000_000

_MAX_GCODE_CHARS = 70  # GRBL's line buffer holds 80
_FORBIDDEN_IN_GCODE = re.compile(r"[^\x20-\x7e]|[?!~$]")
_MOVES_ELSEWHERE = re.compile(r"G\s*0*(10|28|30|92)(?!\d)")
RightAngle = Annotated[float, Meta(ge=-90, le=90)]


class _White(Struct, forbid_unknown_fields=True):
    reflectance_factor: Annotated[float, Meta(ge=0, le=1000)] | None = None
    file: Text | None = None
    geometry_deg: tuple[RightAngle, RightAngle, RightAngle] = (45.0, 0.0, 0.0)
    name: Text = UNNAMED
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
    stage, meter = file.goniometer, file.colorimeter
    try:
        _check_driver("goniometer", stage.driver, drivers.GONIOMETERS, drivers.GONIOMETER_GROUP)
        _check_driver("colorimeter", meter.driver, drivers.COLORIMETERS, drivers.COLORIMETER_GROUP)
        if stage.port == meter.port:
            raise InputError("colorimeter.port: the goniometer has the same; each needs its own")
        _check_axes(stage)
        _check_shows(stage)
        rig = Rig(
            name=file.name or path.stem,
            goniometer_settings=stage,
            colorimeter_settings=meter,
            obstruction=file.obstruction,
            white=_white(path, file.white),
            simulated=file.simulated,
        )
        reason = rig.reachable(rig.white.geometry)
        if reason:
            raise InputError(f"white.geometry_deg: out of reach: {reason}")
    except InputError as error:
        raise InputError(f"{path}: {_clipped(str(error))}") from None
    return rig


def _check_driver(key: str, name: str, built_in: dict[str, str], group: str) -> None:
    known = drivers.known(built_in, group)
    if name not in known:
        raise InputError(f"{key}.driver: expected one of {', '.join(known)}, got {name!r}")


def _check_axes(stage: GoniometerSettings) -> None:
    turned: dict[str, str] = {}
    for name in ANGLES:
        axis, key = stage.axes[name], f"goniometer.axes.{name}"
        low, high = axis.limits_deg
        if axis.letter in turned:
            raise InputError(
                f"{key}.letter: expected a letter of its own, got {axis.letter!r}, which turns "
                f"{turned[axis.letter]} already"
            )
        if low >= high:
            raise InputError(
                f"{key}.limits_deg: expected the lower limit first, got [{low:g}, {high:g}]"
            )
        if high - low <= stage.approach_deg:
            raise InputError(
                f"{key}.limits_deg: {low:g}…{high:g} leaves no room for approach_deg = "
                f"{stage.approach_deg:g}"
            )
        turned[axis.letter] = name


def _check_shows(stage: GoniometerSettings) -> None:
    letters = {stage.axes[name].letter for name in ANGLES}
    for target in Target:
        lines = stage.shows[target]
        for line in lines if isinstance(lines, tuple) else ():
            _check_gcode(f"goniometer.show.{target.value}", line, letters)


def _check_gcode(key: str, line: str, letters: set[str]) -> None:
    words = re.sub(r"\([^)]*\)|;.*", "", line.upper())
    if not words.strip() or len(line) > _MAX_GCODE_CHARS:
        raise InputError(
            f"{key}: expected one G-code line of up to {_MAX_GCODE_CHARS} characters, got {line!r}"
        )
    if _FORBIDDEN_IN_GCODE.search(line):
        raise InputError(
            f"{key}: expected G-code words only, without $ ? ! ~ or line ends, got {line!r}"
        )
    if _MOVES_ELSEWHERE.search(words):
        raise InputError(
            f"{key}: expected only G0, G1, G4 and M words, which are safe, got {line!r}, which "
            "changes coordinates",
        )
    driven = sorted(letter for letter in letters if letter in words)
    if driven:
        raise InputError(
            f"{key}: expected a line that keeps within the limits, got {line!r}, which would drive "
            f"{', '.join(driven)} past them; use other axes",
        )


def _white(path: Path, table: _White) -> WhiteReference:
    geometry, factor = Position(*table.geometry_deg), table.reflectance_factor
    if (factor is None) == (table.file is None):
        raise InputError(
            "white.reflectance_factor: expected this or `file` (100 is perfect white), got "
            f"{'neither' if factor is None else 'both'}"
        )
    if table.file is None:
        if factor == 0.0:
            raise InputError(
                "white.reflectance_factor: expected above 0, since readings are divided by it "
                "(99, say), got 0"
            )
        if factor is not None and factor <= 1.5:
            raise InputError(
                "white.reflectance_factor: expected percent (the perfect diffuser is 100 here, not "
                f"1), got {factor:g}"
            )
        return WhiteReference(factor, None, geometry, table.name, table.relative_std)
    white = WhiteReference(None, path.parent / table.file, geometry, table.name, table.relative_std)
    xyz = white.xyz(geometry)
    if not (xyz > 0).all():
        raise InputError(
            f"white.file: expected XYZ above 0 at the white's geometry, got {xyz.tolist()} in "
            f"{table.file!r}"
        )
    return white


def _clipped(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 200 else text[:200] + "…"
