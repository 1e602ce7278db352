"""How the camera was set, by EXIF: what must be alike in photographs that belong together."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raden_torch.errors import InputError

_ALIKE = {
    "camera": "camera",
    "serial": "serial number of the camera",
    "lens": "lens",
    "focal_length_mm": "focal length in mm",
    "white_balance": "white balance",
    "turned": "orientation by EXIF",
}
_EXPOSES = {
    "exposure_s": (1.0, "exposure time"),
    "iso": (1.0, "ISO"),
    "f_number": (-2.0, "aperture"),
}
"""The power by which each makes a photograph brighter, and its name."""
_NEAR = 0.01
_WHITE_BALANCES = {0: "automatic", 1: "manual"}


@dataclass(frozen=True)
class ShotSettings:
    """What EXIF says of one photograph; None where it says nothing.

    Attributes:
        exposure_s: seconds.
        iso, f_number, focal_length_mm: as the camera rounds them.
        camera: maker and model.
        serial, lens: of the body; its model.
        white_balance: "automatic" or "manual"; raw files have none, which are balanced later.
        orientation: 1…8, by which the picture was turned as it was read; 1: not at all.
    """

    exposure_s: float | None = None
    iso: float | None = None
    f_number: float | None = None
    focal_length_mm: float | None = None
    camera: str | None = None
    serial: str | None = None
    lens: str | None = None
    white_balance: str | None = None
    orientation: int | None = None

    @property
    def turned(self) -> int:
        """The orientation; 1 where none is said."""
        return self.orientation or 1


UNKNOWN = ShotSettings()


def settings_of(tags: Mapping[int, Any], *, is_raw: bool = False) -> ShotSettings:
    """Of TIFF's and EXIF's tags; maker notes are not looked at."""
    maker, model = _text(tags.get(271)) or "", _text(tags.get(272)) or ""
    camera = model if model.startswith(maker) else f"{maker} {model}".strip()
    balance = tags.get(41987)
    return ShotSettings(
        positive(tags.get(33434)),
        positive(tags.get(34855)),
        positive(tags.get(33437)),
        positive(tags.get(37386)),
        camera or None,
        _text(tags.get(42033)),
        _text(tags.get(42036)),
        _WHITE_BALANCES.get(balance) if isinstance(balance, int) and not is_raw else None,
        orientation_of(tags),
    )


def orientation_of(tags: Mapping[int, Any]) -> int | None:
    """EXIF's, 1…8; None where there is none."""
    value = tags.get(274)
    return value if isinstance(value, int) and 1 <= value <= 8 else None


def settings_in_words(shot: ShotSettings) -> list[str]:
    """A line of the camera and one of the exposure, as far as they are known."""
    camera: list[Any] = [shot.camera, shot.serial and f"number {shot.serial}", shot.lens]
    seconds = shot.exposure_s
    exposure: list[Any] = [
        seconds and (f"1/{1 / seconds:.4g} s" if seconds < 0.3 else f"{seconds:.3g} s"),
        shot.f_number and f"f/{shot.f_number:.3g}",
        shot.iso and f"ISO {shot.iso:g}",
        shot.focal_length_mm and f"{shot.focal_length_mm:.3g} mm",
        shot.white_balance and f"white balance {shot.white_balance}",
    ]
    lines = {"camera": camera, "exposure": exposure}
    said = {name: ", ".join(str(w) for w in words if w) for name, words in lines.items()}
    return [f"{name}: {text}" for name, text in said.items() if text]


def check_alike(shots: Sequence[tuple[Path, ShotSettings]]) -> None:
    """Raise InputError, naming two files, where camera, lens, zoom or white balance differ.

    What EXIF does not say of one of them is not compared, but an orientation, which is 1 then.
    """
    known: dict[str, tuple[Path, Any]] = {}
    for path, shot in shots:
        for name, word in _ALIKE.items():
            value = getattr(shot, name)
            if value is None:
                continue
            first, wanted = known.setdefault(name, (path, value))
            if not same_setting(value, wanted):
                raise InputError(
                    f"{path}: {word}: expected {_said(wanted)} as in {first}, got "
                    f"{_said(value)}; photographs that belong together are of one camera, lens "
                    "and zoom, with one setting"
                )


def relative_exposures(shots: Sequence[tuple[Path, ShotSettings]]) -> list[float] | None:
    """How much brighter each photograph is than the first, by t · ISO / f-number²; None where all
    were exposed alike, as far as EXIF says.

    Raises:
        InputError: one of these differs, and one photograph does not say its own.

    Warns:
        UserWarning: some were exposed otherwise, and how sure that is.
    """
    found, changed = [1.0] * len(shots), dict[str, int]()
    for name, (power, word) in _EXPOSES.items():
        values = [getattr(shot, name) for _, shot in shots]
        there = [value for value in values if value is not None]
        if all(same_setting(value, there[0]) for value in there):
            continue
        if len(there) < len(values):
            raise InputError(
                f"{shots[values.index(None)][0]}: expected its {word} in its EXIF, since it "
                "differs between the others, got none"
            )
        changed[word] = next(k for k, v in enumerate(values) if not same_setting(v, values[0]))
        found = [f * (v / values[0]) ** power for f, v in zip(found, values, strict=True)]
    if not changed:
        return None
    k = min(changed.values())
    warnings.warn(
        f"{shots[k][0]}: {', '.join(changed)} differ from {shots[0][0]}: it is taken for "
        f"{found[k]:.3g} times as exposed (ISO and apertures are rounded: some per cent)",
        stacklevel=3,
    )
    return found


def positive(value: Any) -> float | None:
    """A number of a tag above 0, else None."""
    try:
        number = float(value[0] if isinstance(value, (tuple, list)) else value)
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    return number if 0 < number < float("inf") else None


def same_setting(value: Any, wanted: Any) -> bool:
    """Whether two values of one setting are the same; cameras round numbers otherwise."""
    if isinstance(value, float):
        return abs(value / wanted - 1) <= _NEAR
    return bool(value == wanted)


def _said(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _text(value: Any) -> str | None:
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    if not isinstance(value, str):
        return None
    printable = "".join(c for c in value.partition("\0")[0] if c.isprintable())
    return " ".join(printable.split()) or None
