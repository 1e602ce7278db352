"""The white reference and its reflectance factor."""

from __future__ import annotations

import math

from msgspec import Struct, field

from raden_torch.capture.spectrometer.ports import Position
from raden_torch.errors import InputError

Triple = tuple[float, float, float]

UNNAMED = "white reference"
"""The name of a white whose certificate was not named."""

_MOST = 300.0  # no white reflects three times as much as a perfect diffuser


class White(Struct, frozen=True):
    """A white reference as a scan uses it, and as its journal keeps it.

    Attributes:
        position: where it is read again and again, for the drift.
        xyz: its XYZ reflectance factor there, for D65; the perfect reflecting diffuser has Y = 100.
        name: what it is, from its certificate.
        at_cells: the same in each cell of the plan, where the white is read in every cell; empty
            where it is read at `position` alone.
        relative_std: the certificate's standard uncertainty (k = 1), relative to `xyz`.
    """

    position: Position = field(name="position_deg")
    xyz: Triple
    name: str = UNNAMED
    at_cells: tuple[Triple, ...] = ()
    relative_std: float = 0.0

    def __post_init__(self) -> None:
        for where, xyz in (("", self.xyz), *((" in a cell", cell) for cell in self.at_cells)):
            if not all(math.isfinite(value) and 0 < value <= _MOST for value in xyz):
                raise InputError(
                    f"{self.name}: XYZ reflectance factor{where}: expected above 0 and up to "
                    f"{_MOST:g} (the perfect reflecting diffuser has Y = 100), got {xyz}"
                )
        if not (math.isfinite(self.relative_std) and 0 <= self.relative_std < 1):
            raise InputError(
                f"{self.name}: relative standard uncertainty: expected 0…1, got {self.relative_std}"
            )
        here = self.position
        if not (0 <= here.incidence_deg < 90 and abs(here.tilt_deg) < 90):
            raise InputError(
                f"{self.name}: expected incidence and tilt below 90 degrees, got incidence "
                f"{here.incidence_deg:g}, tilt {here.tilt_deg:g}, where no lamp can light it"
            )
