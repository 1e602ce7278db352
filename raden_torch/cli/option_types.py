"""What an option's text stands for: each type is read, and refused, in one place."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

from cyclopts import Parameter, convert

from raden_torch.errors import InputError

if TYPE_CHECKING:
    from cyclopts import Token

    from raden_torch.brdf.shading.lights import Light


Points = tuple[tuple[float, float], ...]
"""x,y of each."""


def argument(text: str) -> Parameter:
    """A positional argument; `text` is its help."""
    return Parameter(help=text, allow_leading_hyphen=False)


def files(text: str) -> Parameter:
    """One or more files, which may stand between the options, too; `text` is their help."""
    return Parameter(help=text, allow_leading_hyphen=False, required=True)


def output(text: str) -> Parameter:
    """--output and -o."""
    return Parameter(name="--output", alias="-o", help=text)


def switch(text: str) -> Parameter:
    """--name and --no-name."""
    return Parameter(help=text, negative_bool="no-", negative=None)


def _read(read: Callable[[str], Any], like: str, **more: Any) -> Parameter:
    """An option whose text `read` understands, or raises a ValueError that says what it expected.

    Args:
        like: how help shows the value.
    """

    def read_tokens(_: object, tokens: Sequence[Token]) -> Any:
        return read(tokens[-1].value)  # given again, the last one counts

    return Parameter(converter=read_tokens, n_tokens=1, accepts_keys=False, metavar=like, **more)


def _read_all(read: Callable[[str], Any], like: str) -> Parameter:
    """As `_read`, of an option that may be repeated."""

    def read_tokens(_: object, tokens: Sequence[Token]) -> Any:
        return tuple(read(token.value) for token in tokens)

    return Parameter(converter=read_tokens, n_tokens=1, accepts_keys=False, metavar=like)


def read_value(wanted: Any, tokens: Sequence[Token]) -> Any:
    """What tokens stand for where an option says nothing else: numbers strictly, the rest by
    cyclopts, which would take 3.5 for a whole number and "none" for a number that is not given."""
    readers = {int: _whole, float: number}
    if NoneType in get_args(wanted):
        wanted = next(part for part in get_args(wanted) if part is not NoneType)
    if wanted in readers:
        return readers[wanted](tokens[0].value)
    if get_origin(wanted) is tuple and get_args(wanted)[0] in readers:
        return tuple(readers[get_args(wanted)[0]](token.value) for token in tokens)
    return convert(wanted, tokens)


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"expected a whole number, got {text or 'nothing'}") from None


def number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"expected a number, got {text or 'nothing'}") from None


def _triple(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected three numbers as 1,1,2, got {text}") from None
    return x, y, z


def _finite(count: str, like: str) -> Callable[[str], Any]:
    """What reads as many numbers as `like` has, which `count` says in words."""
    wanted = len(like.split(","))

    def read(text: str) -> tuple[float, ...]:
        found = _tuples(text)
        if [len(numbers) for numbers in found] != [wanted]:
            raise ValueError(f"expected {count} finite numbers as {like}, got {text}")
        return found[0]

    return read


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise ValueError(f"expected name=value, as normal=N, got {text}")
    return name, value


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(name and name.isprintable() for name in names):
        raise ValueError(f"expected names as rim,middle,eye, got {text!r}")
    return names


def _exposed(text: str) -> float | Literal["auto", "key"]:
    if text == "auto":
        return "auto"
    if text == "key":
        return "key"
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"expected a number of stops, auto or key, got {text}") from None


def _bytes(text: str) -> int:
    """`2G`, `512M`; a bare number is bytes."""
    units = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([KMGT]?)i?B?", text.strip(), re.IGNORECASE)
    if found is None:
        raise ValueError(f"expected a size as 2G or 512M, got {text}")
    amount, unit = found.groups()
    return int(float(amount) * 1024 ** units[unit.upper()])


def _limits(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    if not colon:
        raise ValueError(f"expected first and last in degrees, as 0:70, got {text}")
    return number(low), number(high)


def _frames(text: str) -> tuple[int, ...]:
    from raden_torch.sequences.frames import frame_numbers

    try:
        return frame_numbers(text)
    except InputError as error:
        raise ValueError(str(error).removeprefix("frames: ")) from None


def _size_mm(text: str) -> tuple[float, float]:
    try:
        width, height = (float(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"expected width x height in mm, as 100x80, got {text}") from None
    return width, height


def _reach_mm(text: str) -> tuple[float, float]:
    """One distance, or the least and the greatest."""
    low, _, high = text.partition(":")
    return number(low), number(high or low)


def _squares(text: str) -> tuple[int, int]:
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"expected columns x rows, as 5x7, got {text}") from None
    return columns, rows


def _points(text: str) -> Points:
    """None at all if the text is something else."""
    points = _tuples(text)
    return tuple((x, y) for x, y in points) if {len(p) for p in points} == {2} else ()


def _tuples(text: str) -> list[tuple[float, ...]]:
    """Finite numbers with commas, between spaces; none at all if the text is something else."""
    try:
        found = [tuple(float(n) for n in part.split(",")) for part in text.split()]
    except ValueError:
        return []
    return found if all(isfinite(sum(point)) for point in found) else []


def _corners_px(text: str) -> Points:
    points = _points(text)
    if len(points) != 4:
        raise ValueError(f'expected four points as "x,y x,y x,y x,y", got {text}')
    return points


def _region(text: str) -> Points:
    points = _points(text)
    if len(points) < 3:
        raise ValueError(
            f'expected three or more points in metres, as "0.05,0.05 0.1,0.05", got {text}'
        )
    return points


def _raised_region(text: str) -> tuple[tuple[float, ...], ...]:
    """x,y of each corner, or x,y,height."""
    points = _tuples(text)
    if len(points) < 3 or {len(point) for point in points} not in ({2}, {3}):
        raise ValueError(
            'expected three or more points in metres, as "0.05,0.05 0.1,0.05", or, with heights '
            f'over the board, "0.05,0.05,0.01", got {text}'
        )
    return tuple(points)


def _axis(text: str) -> Points:
    points = _points(text)
    if len(points) != 2:
        raise ValueError(f'expected two points in metres, as "0.05,0.05 0.1,0.05", got {text}')
    return points


@dataclass(frozen=True)
class LampOption:
    """A lamp on the command line: x,y,z at infinity, or point:x,y,z."""

    position: tuple[float, float, float]
    is_point: bool = False

    @classmethod
    def read(cls, text: str) -> LampOption:
        kind, colon, numbers = text.rpartition(":")
        if colon and kind != "point":
            raise ValueError(f"expected x,y,z or point:x,y,z, got {text}")
        place = _triple(numbers)
        if not all(map(isfinite, place)):
            raise ValueError(f"expected three finite numbers as 1,1,2, got {text}")
        if not (kind or any(place)):
            raise ValueError(f"expected a direction towards the lamp as 1,1,2, got {text}")
        return cls(place, bool(kind))

    @property
    def light(self) -> Light:
        from raden_torch.brdf.shading.lights import DirectionalLight, PointLight

        return (PointLight if self.is_point else DirectionalLight)(self.position)


def lights_of(lamps: Sequence[LampOption]) -> list[Light]:
    """The same for the library."""
    return [lamp.light for lamp in lamps]


def _lamp_or_file(text: str) -> tuple[float, float, float] | Path:
    return Path(text) if text.endswith(".json") else _triple(text)


Triple = Annotated[tuple[float, float, float], _read(_triple, "X,Y,Z")]
Triples = Annotated[
    tuple[tuple[float, float, float], ...], _read_all(_finite("three", "0.1,0.02,30"), "X,Y,NUMBER")
]
Five = Annotated[
    tuple[tuple[float, float, float, float, float], ...],
    _read_all(_finite("five", "0.1,0.02,30,0.14,0.05"), "X,Y,HEIGHT,X,Y"),
]
Exposed = Annotated[
    float | Literal["auto", "key"], _read(_exposed, "STOPS|auto|key", show_choices=False)
]
Bytes = Annotated[int, _read(_bytes, "SIZE", show_default=lambda size: f"{size >> 30}G")]
Limits = Annotated[tuple[float, float], _read(_limits, "FIRST:LAST")]
Frames = Annotated[tuple[int, ...] | None, _read(_frames, "FIRST-LASTxSTEP,…", show_default=False)]
SizeMm = Annotated[tuple[float, float], _read(_size_mm, "WIDTHxHEIGHT")]
ReachMm = Annotated[
    tuple[float, float],
    _read(_reach_mm, "LEAST:GREATEST", show_default=lambda reach: f"{reach[0]:g}:{reach[1]:g}"),
]
Squares = Annotated[tuple[int, int], _read(_squares, "COLUMNSxROWS")]
CornersPx = Annotated[Points, _read(_corners_px, "POINTS")]
Region = Annotated[Points, _read(_region, "POINTS")]
Regions = Annotated[tuple[Points, ...], _read_all(_region, "POINTS")]
RaisedRegions = Annotated[
    tuple[tuple[tuple[float, ...], ...], ...], _read_all(_raised_region, "POINTS")
]
Axis = Annotated[Points, _read(_axis, "POINTS")]
LampOrFile = Annotated[tuple[float, float, float] | Path, _read(_lamp_or_file, "X,Y,Z|FILE")]
Names = Annotated[tuple[str, ...], _read(_names, "NAME,NAME,…")]
Lamps = Annotated[tuple[LampOption, ...], _read_all(LampOption.read, "X,Y,Z")]
Pairs = Annotated[tuple[tuple[str, str], ...], _read_all(_pair, "NAME=VALUE")]

ModelFile = Annotated[Path, argument("a model that `raden fit` wrote")]
RenderedModel = Annotated[
    Path,
    argument("a model that `raden fit` wrote; a scene (.toml); or pearl, a simulated one"),
]
