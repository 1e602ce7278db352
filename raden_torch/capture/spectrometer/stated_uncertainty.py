"""The uncertainties that a rig file states, which the journal keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass

from raden_torch.errors import InputError

Triple = tuple[float, float, float]

_NONE: Triple = (0.0, 0.0, 0.0)
_MOST_DEG = 10.0


@dataclass(frozen=True)
class StatedUncertainty:
    """Standard uncertainties (k = 1) that no reading can show; 0 where nothing is stated.

    Attributes:
        zero_std_deg: of the zeros of incidence, receiving and tilt: one error in a whole scan.
        position_std_deg: of each of them after a move: another error every time.
        wavelength_std_nm: of an instrument's wavelengths.
        xyz_std: relative, of X, Y and Z of an instrument without a spectrum.
    """

    zero_std_deg: Triple = _NONE
    position_std_deg: Triple = _NONE
    wavelength_std_nm: float = 0.0
    xyz_std: float = 0.0

    def __post_init__(self) -> None:
        for what in (*self.zero_std_deg, *self.position_std_deg, self.wavelength_std_nm):
            if not 0.0 <= what <= _MOST_DEG:
                raise InputError(
                    f"stated uncertainty: expected 0…{_MOST_DEG:g} degrees (or nm), got {what:g}"
                )
        if not (math.isfinite(self.xyz_std) and 0.0 <= self.xyz_std < 1.0):
            raise InputError(f"stated uncertainty of XYZ: expected 0…1, got {self.xyz_std:g}")
