"""Errors that all readings of a measurement share, and what they do to each reading.

A common error moves all values together, so it does not average out over cells and says nothing
about how well they compare with each other. Three kinds are stated in a measurement's file:

- the scale's (the white reference's certificate): value · `scale_std`. It is not in `std`.
- the mean of all white readings that a scan was divided by: its noise is a scale error of its own.
- the axes' zeros: angles that are off by one amount in the whole measurement. Where a white
  reference was read at one geometry w and the irradiance follows cos a cos t,

      dR/da₀ = ∂R/∂a + R (tan a_w − tan a),
      dR/dr₀ = ∂R/∂r,
      dR/dt₀ = ∂R/∂t + R (tan t_w − tan t).

The last two are in `std`, since a reader of one cell needs them there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.errors import InputError

Triple = tuple[float, float, float]

_NONE: Triple = (0.0, 0.0, 0.0)
KEYS = ("scale_std", "scale_reference", "white_mean_std", "zero_std_deg", "white_deg")
"""The header entries of a measurement file."""


@dataclass(frozen=True)
class SystematicErrors:
    """What is known of the errors that all readings share. Standard uncertainties, k = 1.

    Attributes:
        scale_std: relative, of all values together; 0 where none is stated.
        scale_reference: what the scale comes from, as "tile 1234". Measurements that name the same
            reference share its error.
        white_mean_std: relative, of the mean of the white readings: not shared by a second scan,
            whatever its reference.
        zero_std_deg: of the zeros of incidence, receiving and tilt.
        white_deg: incidence, receiving and tilt of the white reference; None where the irradiance
            was compared in every cell.

    Raises:
        InputError: a number out of its range.
    """

    scale_std: float = 0.0
    scale_reference: str = ""
    white_mean_std: float = 0.0
    zero_std_deg: Triple = _NONE
    white_deg: Triple | None = None

    def __post_init__(self) -> None:
        for name in ("scale_std", "white_mean_std"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError(f"measurement: {name}: expected 0…1, got {getattr(self, name):g}")
        if not all(0.0 <= std <= 10.0 for std in self.zero_std_deg):
            raise InputError(
                "measurement: zero_std_deg: expected three numbers in 0…10 degrees, got "
                f"{_words(self.zero_std_deg)}"
            )
        if self.white_deg is not None and not all(abs(angle) < 90.0 for angle in self.white_deg):
            raise InputError(
                "measurement: white_deg: expected three angles between -90 and 90 degrees, got "
                f"{_words(self.white_deg)}"
            )

    def as_entries(self) -> tuple[tuple[str, str], ...]:
        """Header entries; none for what is not stated."""
        stated = {
            "scale_std": repr(self.scale_std) if self.scale_std else "",
            "scale_reference": self.scale_reference,
            "white_mean_std": repr(self.white_mean_std) if self.white_mean_std else "",
            "zero_std_deg": _words(self.zero_std_deg) if any(self.zero_std_deg) else "",
            "white_deg": "" if self.white_deg is None else _words(self.white_deg),
        }
        return tuple((key, text) for key, text in stated.items() if text)

    @classmethod
    def from_entries(cls, entries: Mapping[str, str]) -> SystematicErrors:
        """What `as_entries` wrote. Raises InputError where it is not numbers, or out of range."""
        white = entries.get("white_deg")
        return cls(
            scale_std=_share(entries, "scale_std"),
            scale_reference=entries.get("scale_reference", ""),
            white_mean_std=_share(entries, "white_mean_std"),
            zero_std_deg=_triple(entries, "zero_std_deg") if "zero_std_deg" in entries else _NONE,
            white_deg=None if white is None else _triple(entries, "white_deg"),
        )


def zero_sensitivity(
    values: Floats, angles_deg: Floats, slopes_per_deg: Floats, white_deg: Triple | None
) -> Floats:
    """`[M, C, 3]`: how much a value changes per degree that a zero is off; see the module's text.

    Args:
        values: `[M, C]` reflectance factors.
        angles_deg: `[M, 3]` incidence, receiving, tilt.
        slopes_per_deg: `[M, C, 3]` ∂R/∂angle, per degree.
        white_deg: the white reference's angles; None where no cosine was divided by.
    """
    if white_deg is None:
        return slopes_per_deg
    lit = np.tan(np.radians(white_deg)) - np.tan(np.radians(np.clip(angles_deg, -89.9, 89.9)))
    lit[:, 1] = 0.0  # receiving does not change the irradiance
    return np.asarray(slopes_per_deg + np.radians(1.0) * values[:, :, None] * lit[:, None, :])


def _words(numbers: Triple) -> str:
    return " ".join(f"{number!r}" for number in numbers)


def _share(entries: Mapping[str, str], key: str) -> float:
    return _numbers(entries, key, 1)[0] if key in entries else 0.0


def _triple(entries: Mapping[str, str], key: str) -> Triple:
    a, r, t = _numbers(entries, key, 3)
    return a, r, t


def _numbers(entries: Mapping[str, str], key: str, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in entries[key].split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        wanted = "one number" if count == 1 else f"{count} numbers separated by spaces"
        raise InputError(f"measurement: header: {key}: expected {wanted}, got {entries[key]!r}")
    return numbers
