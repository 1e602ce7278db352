"""Which colour is looked for, at which angles, and the formula that ranks shells by it.

All is in CIELAB under D65, 2° observer: L*, a*, b* of the reflectance, where the perfect reflecting
diffuser has L* = 100 (CIE 15:2018, 8.2.1). A highlight has more.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.colorimetry import SRGB, lab_of, primary_matrix
from raden_torch.errors import InputError
from raden_torch.images.colour_space import srgb_curve
from raden_torch.packages import require

Rank = Literal["chroma", "saturation"]

_RED, _YELLOW, _GREEN, _BLUE = 24.0, 90.0, 162.0, 246.0
"""CIELAB hue angles of the unique hues in daylight: Fairchild, Color Appearance Models, ch. 10."""

HUES = {
    "red 赤": _RED,
    "orange 黄赤 橙": (_RED + _YELLOW) / 2,
    "yellow 黄": _YELLOW,
    "yellow-green 黄緑": (_YELLOW + _GREEN) / 2,
    "green 緑": _GREEN,
    "blue-green turquoise 青緑": (_GREEN + _BLUE) / 2,
    "blue 青": _BLUE,
    "violet 青紫": _BLUE + (_RED + 360 - _BLUE) / 4,
    "purple 紫": _BLUE + (_RED + 360 - _BLUE) / 2,
    "red-purple pink 赤紫 桃": _BLUE + 3 * (_RED + 360 - _BLUE) / 4,
}
"""Degrees, by the ten chromatic names of JIS Z 8102 and their English; those between two unique
hues stand at equal steps between them."""
NEUTRALS = {"white 白": 100.0, "grey gray 灰": 50.0, "black 黒": 0.0}
"""L*, at a* = b* = 0."""


def _by_name(names: dict[str, float]) -> dict[str, float]:
    return {name: value for several, value in names.items() for name in several.split()}


@dataclass(frozen=True)
class Geometry:
    """Where light and viewer are, degrees; see docs/conventions.md.

    Attributes:
        incidence_deg: 0…80.
        receiving_deg: −80…80; None: the mirror direction, receiving = incidence.
        tilt_deg: −60…60.
    """

    incidence_deg: float = 40.0
    receiving_deg: float | None = None
    tilt_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, least, most in (
            ("incidence_deg", 0.0, 80.0),
            ("receiving_deg", -80.0, 80.0),
            ("tilt_deg", -60.0, 60.0),
        ):
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise InputError(
                    f"`{name}`: expected {least:g}…{most:g} degrees, got {value:g} degrees"
                )

    @property
    def receiving(self) -> float:
        return self.incidence_deg if self.receiving_deg is None else self.receiving_deg

    def __str__(self) -> str:
        mirror = " (mirror)" if self.receiving == self.incidence_deg else ""
        return (
            f"incidence {self.incidence_deg:g}, receiving {self.receiving:g}{mirror}, "
            f"tilt {self.tilt_deg:g} deg"
        )


@dataclass(frozen=True)
class ColourQuery:
    """A hue, of which most is best; or a colour, to which the nearest is best.

    Attributes:
        text: as it was asked for.
        hue_deg: CIELAB hue angle h_ab, degrees; None where a colour is looked for.
        lab: L*, a*, b* of that colour; None where a hue is.
        rank: of a hue: "chroma", C* cos(h − h₀), how far the colour reaches towards the hue h₀
            in the a*b* plane; "saturation", that over √(C*² + L*²), the same for a dull and a
            bright shell of one spectrum's shape.

    A colour is ranked by ΔE*00 (CIEDE2000, ISO/CIE 11664-6).
    """

    text: str
    hue_deg: float | None
    lab: tuple[float, float, float] | None
    rank: Rank = "chroma"

    @classmethod
    def read(cls, text: str, rank: Rank = "chroma") -> ColourQuery:
        """What a text asks for: green, 緑, 162 (a hue angle), #3fa27c (sRGB) or lab:60,-40,20.

        Raises:
            InputError: none of these.
        """
        word = text.strip().lower()
        hues, neutrals = _by_name(HUES), _by_name(NEUTRALS)
        if word in hues:
            return cls(text, hues[word], None, rank)
        if word in neutrals:
            return cls(text, None, (neutrals[word], 0.0, 0.0), rank)
        if re.fullmatch(r"#[0-9a-f]{6}", word):
            return cls(text, None, _lab_of_hex(word), rank)
        numbers = _numbers(word.removeprefix("lab:").removesuffix("°"))
        if word.startswith("lab:") and len(numbers) == 3:
            lightness, a, b = numbers
            return cls(text, None, (lightness, a, b), rank)
        if not word.startswith("lab:") and len(numbers) == 1 and 0 <= numbers[0] <= 360:
            return cls(text, numbers[0], None, rank)
        names = ", ".join(several.split()[0] for several in (*HUES, *NEUTRALS))
        raise InputError(
            f"`colour`: expected a name ({names}, or in Japanese, as 緑), a hue angle 0…360, "
            f"#rrggbb or lab:L,a,b, got {text!r}"
        )

    @property
    def formula(self) -> str:
        """Of the score, in words."""
        if self.hue_deg is None:
            return "ΔE00 from it, least first"
        share = " / √(C*² + L*²)" if self.rank == "saturation" else ""
        return f"C* cos(h − {self.hue_deg:g}°){share}, most first"

    @property
    def best_is_least(self) -> bool:
        return self.hue_deg is None

    def scores(self, lab: Floats) -> Floats:
        """`[N, 3]` L*, a*, b* → `[N]`, as `formula` says.

        Raises:
            MissingPackageError: ΔE00 without colour-science.
        """
        if self.lab is not None:
            require("colour differences", "spectral")
            import colour

            return np.asarray(colour.delta_E(lab, np.array(self.lab), method="CIE 2000"))
        hue = np.deg2rad(self.hue_deg or 0.0)
        reach = lab[:, 1] * np.cos(hue) + lab[:, 2] * np.sin(hue)
        if self.rank == "chroma":
            return np.asarray(reach)
        return np.asarray(reach / np.maximum(np.linalg.norm(lab, axis=1), 1e-9))


def chroma_and_hue(lab: Floats | tuple[float, float, float]) -> tuple[float, float]:
    """C*_ab and h_ab in degrees, 0…360, of one colour."""
    _, a, b = lab
    return float(np.hypot(a, b)), float(np.rad2deg(np.arctan2(b, a)) % 360)


def _numbers(text: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return found if np.isfinite(found).all() else []


def _lab_of_hex(text: str) -> tuple[float, float, float]:
    coded = np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    matrix = primary_matrix(SRGB)
    lightness, a, b = lab_of(matrix @ srgb_curve(coded), matrix.sum(axis=1)).tolist()
    return lightness, a, b
