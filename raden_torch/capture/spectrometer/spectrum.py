"""A spectrum as CIE XYZ."""

from __future__ import annotations

from functools import cache

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.packages import require

LUMINOUS_EFFICACY_LM_PER_W = 683.002
"""Of 540 THz: K_m of CIE 018:2019."""


def xyz_of(radiance: Floats, wavelengths_nm: Floats) -> Floats:
    """CIE 1931 2° XYZ of a spectral radiance; Y in cd/m².

    X = K_m Σ L(λ) x̄(λ) Δλ (CIE 015:2018), with colour-science's 1 nm table, over the wavelengths
    given: 380…780 nm leaves out less than 1e-4 of white light.

    Args:
        radiance: `(n,)` in W/(sr·m²·nm).
        wavelengths_nm: `(n,)` whole nanometres, 1 nm apart.

    Returns:
        `(3,)`.
    """
    first, last = int(wavelengths_nm[0]), int(wavelengths_nm[-1])
    return LUMINOUS_EFFICACY_LM_PER_W * np.asarray(radiance) @ colour_matching(first, last)


@cache
def colour_matching(first_nm: int, last_nm: int) -> Floats:
    """`(n, 3)` CIE 1931 2° colour-matching functions at 1 nm."""
    require("spectra", "spectral")
    import colour

    table = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy()
    return np.asarray(table.align(colour.SpectralShape(first_nm, last_nm, 1)).values, np.float64)
