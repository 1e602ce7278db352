"""The rig file: TOML, checked completely before anything is opened or moves. See docs/rig.md."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from raden_torch.capture.spectrometer import drivers
from raden_torch.capture.spectrometer.ports import Position, Target
from raden_torch.capture.spectrometer.rig import (
    ANGLES,
    Axis,
    ColorimeterSettings,
    GoniometerSettings,
    Obstruction,
    Rig,
    WhiteReference,
)
from raden_torch.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

MAX_BYTES = 1_000_000
MANUAL = "manual"

_LETTERS = "XYZABCUVW"
_MAX_GCODE_CHARS = 70  # GRBL's line buffer holds 80
_FORBIDDEN_IN_GCODE = re.compile(r"[^\x20-\x7e]|[?!~$]")
_MOVES_ELSEWHERE = re.compile(r"G\s*0*(10|28|30|92)(?!\d)")
_QUESTIONS = {
    Target.SAMPLE: "Put the sample in place, with the lamp open",
    Target.WHITE: "Put the white reference in the sample's place, with the lamp open",
    Target.DARK: "Shut the lamp",
}


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Read and check a rig file.

    Raises:
        InputError: one line with the file, the key, and what would be right.
    """
    path = Path(path)
    top = _Table(path, "", _parsed(path))
    goniometer = _goniometer(top.table("goniometer"))
    rig = Rig(
        name=top.text("name", path.stem),
        goniometer_settings=goniometer,
        colorimeter_settings=_colorimeter(top.table("colorimeter")),
        obstruction=_obstruction(top.table("obstruction", optional=True)),
        white=_white(path, top.table("white")),
        simulated=top.flag("simulated", False),
    )
    top.check_all_used()
    if goniometer.port == rig.colorimeter_settings.port:
        raise top.error("colorimeter.port", "the goniometer has the same port; each needs its own")
    _check_travel(top, rig)
    return rig


def _goniometer(table: _Table) -> GoniometerSettings:
    default = GoniometerSettings("", "", {})
    axes = _axes(table.table("axes"))
    settings = GoniometerSettings(
        driver=table.choice("driver", drivers.known(drivers.GONIOMETERS, drivers.GONIOMETER_GROUP)),
        port=table.text("port"),
        axes=axes,
        baud=table.whole("baud", default.baud, 300, 4_000_000),
        approach_deg=table.number("approach_deg", default.approach_deg, 0.0, 10.0),
        feed_deg_per_min=table.number("feed_deg_per_min", None, 1.0, 1e6),
        rapid_deg_per_s=table.number("rapid_deg_per_s", default.rapid_deg_per_s, 1e-3, 1e5),
        settle_s=table.number("settle_s", default.settle_s, 0.0, 600.0),
        homing=table.text("homing", default.homing),
        homing_timeout_s=table.number("homing_timeout_s", default.homing_timeout_s, 1.0, 3600.0),
        reply_timeout_s=table.number("reply_timeout_s", default.reply_timeout_s, 0.1, 60.0),
        connect_timeout_s=table.number("connect_timeout_s", default.connect_timeout_s, 0.2, 60.0),
        move_timeout_s=table.number("move_timeout_s", default.move_timeout_s, 1.0, 3600.0),
        poll_s=table.number("poll_s", default.poll_s, 1e-4, 10.0),
        shows=_shows(table.table("show", optional=True), {axis.letter for axis in axes.values()}),
    )
    if settings.homing != MANUAL and not re.fullmatch(r"\$H[XYZABCUVW]?", settings.homing):
        raise table.error("homing", f"expected '$H' or 'manual', got {settings.homing!r}")
    table.check_all_used()
    return settings


def _axes(table: _Table) -> dict[str, Axis]:
    axes: dict[str, Axis] = {}
    default = Axis("")
    for name in ANGLES:
        entry = table.table(name)
        letter = entry.text("letter").upper()
        if letter not in tuple(_LETTERS):
            raise entry.error("letter", f"expected one of {', '.join(_LETTERS)}, got {letter!r}")
        for other, axis in axes.items():
            if axis.letter == letter:
                raise entry.error(
                    "letter",
                    f"expected a letter of its own, got {letter!r}, which turns {other} already",
                )
        axes[name] = Axis(
            letter,
            entry.choice("direction", (1, -1), 1),
            entry.number("zero_deg", 0.0, -3600.0, 3600.0),
            entry.interval("limits_deg", -180.0, 180.0),
            entry.number("zero_std_deg", default.zero_std_deg, 0.0, 10.0),
            entry.number("position_std_deg", default.position_std_deg, 0.0, 10.0),
        )
        entry.check_all_used()
    table.check_all_used()
    return axes


def _shows(table: _Table, letters: set[str]) -> dict[Target, tuple[str, ...] | str]:
    shows: dict[Target, tuple[str, ...] | str] = {}
    for target in Target:
        key, value = target.value, table.value(target.value, MANUAL)
        if value == MANUAL:
            shows[target] = _QUESTIONS[target]
            continue
        if not isinstance(value, list) or not all(isinstance(line, str) for line in value):
            raise table.error(key, f"expected a list of G-code lines or 'manual', got {value!r}")
        for line in value:
            _check_gcode(table, key, line, letters)
        shows[target] = tuple(value)
    table.check_all_used()
    return shows


def _check_gcode(table: _Table, key: str, line: str, letters: set[str]) -> None:
    words = re.sub(r"\([^)]*\)|;.*", "", line.upper())
    if not words.strip() or len(line) > _MAX_GCODE_CHARS:
        raise table.error(
            key, f"expected one G-code line of up to {_MAX_GCODE_CHARS} characters, got {line!r}"
        )
    if _FORBIDDEN_IN_GCODE.search(line):
        raise table.error(
            key, f"expected G-code words only, without $ ? ! ~ or line ends, got {line!r}"
        )
    if _MOVES_ELSEWHERE.search(words):
        raise table.error(
            key,
            f"expected only G0, G1, G4 and M words, which are safe, got {line!r}, which "
            "changes coordinates",
        )
    driven = sorted(letter for letter in letters if letter in words)
    if driven:
        raise table.error(
            key,
            f"expected a line that keeps within the limits, got {line!r}, which would drive "
            f"{', '.join(driven)} past them; use other axes",
        )


def _colorimeter(table: _Table) -> ColorimeterSettings:
    default = ColorimeterSettings("", "")
    settings = ColorimeterSettings(
        driver=table.choice(
            "driver", drivers.known(drivers.COLORIMETERS, drivers.COLORIMETER_GROUP)
        ),
        port=table.text("port"),
        baud=table.whole("baud", None, 300, 4_000_000),
        spectrum=table.flag("spectrum", default.spectrum),
        reply_timeout_s=table.number("reply_timeout_s", default.reply_timeout_s, 0.1, 120.0),
        connect_timeout_s=table.number("connect_timeout_s", default.connect_timeout_s, 0.2, 120.0),
        wavelength_std_nm=table.number("wavelength_std_nm", default.wavelength_std_nm, 0.0, 10.0),
        xyz_std=table.number("xyz_std", default.xyz_std, 0.0, 0.5),
    )
    table.check_all_used()
    return settings


def _obstruction(table: _Table) -> Obstruction:
    obstruction = Obstruction(
        table.number("angle_deg", 0.0, 0.0, 90.0), table.flag("collides", False)
    )
    table.check_all_used()
    return obstruction


def _white(path: Path, table: _Table) -> WhiteReference:
    geometry = Position(*table.numbers("geometry_deg", [45.0, 0.0, 0.0], -90.0, 90.0))
    factor = table.number("reflectance_factor", None, 0.0, 1000.0)
    file = table.value("file", None)
    name = table.text("name", "white reference")
    relative_std = table.number("relative_std", 0.0, 0.0, 0.5)
    table.check_all_used()
    if (factor is None) == (file is None):
        raise table.error(
            "reflectance_factor",
            "expected this or `file` (100 is perfect white), got "
            f"{'neither' if file is None else 'both'}",
        )
    if file is None:
        if factor == 0.0:
            raise table.error(
                "reflectance_factor",
                "expected above 0, since readings are divided by it (99, say), got 0",
            )
        if factor is not None and factor <= 1.5:
            raise table.error(
                "reflectance_factor",
                f"expected percent (the perfect diffuser is 100 here, not 1), got {factor:g}",
            )
        return WhiteReference(factor, None, geometry, name, relative_std)
    if not isinstance(file, str):
        raise table.error("file", f"expected the name of a measurement, got {file!r}")
    white = WhiteReference(None, path.parent / file, geometry, name, relative_std)
    xyz = white.xyz(geometry)
    if not (xyz > 0).all():
        raise table.error(
            "file", f"expected XYZ above 0 at the white's geometry, got {xyz.tolist()} in {file!r}"
        )
    return white


def _check_travel(top: _Table, rig: Rig) -> None:
    for name in ANGLES:
        low, high = rig.goniometer_settings.axes[name].limits_deg
        if high - low <= rig.goniometer_settings.approach_deg:
            raise top.error(
                f"goniometer.axes.{name}.limits_deg",
                f"{low:g}…{high:g} leaves no room for approach_deg = "
                f"{rig.goniometer_settings.approach_deg:g}",
            )
    reason = rig.reachable(rig.white.geometry)
    if reason:
        raise top.error("white.geometry_deg", f"out of reach: {reason}")


def _parsed(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: expected a rig file, got over {MAX_BYTES} bytes")
        text = path.read_bytes().decode("utf-8-sig")
        return tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path}: expected a rig file, got an error: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: expected a rig file in TOML, got bytes that are not UTF-8 text"
        ) from None
    except (
        ValueError,
        RecursionError,
    ) as error:  # what tomllib raises, and its int() of 5,000 digits
        raise InputError(f"{path}: not valid TOML: {_clipped(str(error))}") from None


def _clipped(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 200 else text[:200] + "…"


class _Table:
    """One table of the file; every look-up is checked, and every key must be looked up."""

    def __init__(self, path: Path, name: str, content: dict[str, Any]) -> None:
        self._path, self._name, self._content = path, name, content
        self._used: set[str] = set()

    def error(self, key: str, message: str) -> InputError:
        where = ".".join(part for part in (self._name, key) if part)
        return InputError(f"{self._path}: {where}: {_clipped(message)}")

    def check_all_used(self) -> None:
        unknown = [key for key in self._content if key not in self._used]
        if unknown:
            raise self.error(
                unknown[0], f"expected one of {', '.join(sorted(self._used))}, got {unknown[0]!r}"
            )

    def value(self, key: str, default: Any = ...) -> Any:
        self._used.add(key)
        if key not in self._content:
            if default is ...:
                raise self.error(key, "expected a value, got none")
            return default
        return self._content[key]

    def table(self, key: str, optional: bool = False) -> _Table:
        content = self.value(key, {} if optional else ...)
        name = ".".join(part for part in (self._name, key) if part)
        if not isinstance(content, dict):
            raise self.error(key, f"expected a table [{name}], got {content!r}")
        return _Table(self._path, name, content)

    def text(self, key: str, default: Any = ...) -> str:
        value = self.value(key, default)
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            raise self.error(key, f"expected a text, got {value!r}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self.value(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"expected true or false, got {value!r}")
        return value

    def choice(self, key: str, choices: Iterable[Any], default: Any = ...) -> Any:
        value, choices = self.value(key, default), list(choices)
        if isinstance(value, bool) or value not in choices:
            names = ", ".join(str(c) for c in choices)
            raise self.error(key, f"expected one of {names}, got {value!r}")
        return value

    def number(self, key: str, default: Any, low: float, high: float) -> Any:
        value = self.value(key, default)
        if key not in self._content:
            return value
        return self._checked(key, value, low, high)

    def whole(self, key: str, default: Any, low: int, high: int) -> Any:
        value = self.number(key, default, low, high)
        if value is not None and value != int(value):
            raise self.error(key, f"expected a whole number, got {value!r}")
        return None if value is None else int(value)

    def numbers(self, key: str, default: list[float], low: float, high: float) -> list[float]:
        value = self.value(key, default)
        if not isinstance(value, list) or len(value) != len(default):
            raise self.error(key, f"expected {len(default)} numbers, as {default}, got {value!r}")
        return [self._checked(key, v, low, high) for v in value]

    def interval(self, key: str, low: float, high: float) -> tuple[float, float]:
        self.value(key)
        a, b = self.numbers(key, [low, high], low, high)
        if a >= b:
            raise self.error(key, f"expected the lower limit first, got [{a:g}, {b:g}]")
        return a, b

    def _checked(self, key: str, value: Any, low: float, high: float) -> float:
        number = not isinstance(value, bool) and isinstance(value, (int, float))
        if not number or not low <= value <= high:  # NaN fails too
            raise self.error(key, f"expected a number in {low:g}…{high:g}, got {value!r}")
        return float(value)
