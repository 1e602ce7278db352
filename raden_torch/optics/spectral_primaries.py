"""Linear RGB → a spectrum: three smooth spectra, one of each sRGB primary, that sum to 1.

A reflectance of r, g, b gets the spectrum r R(λ) + g G(λ) + b B(λ), so grey stays even, and any
number of colours mix alike before and after. Under D65 it has the colour that it was made of. The
spectra are the smoothest (least squared second differences) within 0…1 that do, after Mallett and
Yuksel, Spectral Primary Decomposition for Rendering with sRGB Reflectance (EGSR 2019).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.optimize import LinearConstraint, minimize

from raden_torch.arrays import Floats
from raden_torch.optics.spectral_colour import VISIBLE_NM, spectrum_to_rgb

STEP_NM = 20.0
"""Between the nodes of the spectra, which are linear between them."""


def primary_spectra(wavelength_nm: Floats) -> Floats:
    """`[W, 3]`: the spectra of red, green and blue; they sum to 1 at every wavelength.

    Args:
        wavelength_nm: `[W]`; beyond 380…780 nm the ends continue.

    Examples:
        >>> import numpy as np
        >>> from raden_torch.optics.spectral_colour import spectrum_to_rgb
        >>> nm = np.arange(380.0, 781.0, 20.0)
        >>> orange = primary_spectra(nm) @ (0.9, 0.4, 0.1)
        >>> spectrum_to_rgb(orange, nm).round(4).tolist()
        [0.9, 0.4, 0.1]
    """
    nm, spectra = _primaries()
    return np.stack([np.interp(wavelength_nm, nm, column) for column in spectra.T], axis=1)


@lru_cache(maxsize=1)
def _primaries() -> tuple[Floats, Floats]:
    nm = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + 1, STEP_NM)
    count = len(nm)
    of_rgb = spectrum_to_rgb(np.eye(count), nm).T  # [3, W]
    bend = np.diff(np.eye(count), 2, axis=0)
    roughness = bend.T @ bend
    # of two spectra; the third is what they leave of 1, and of its roughness they share
    both = np.kron(np.array([[2.0, 1.0], [1.0, 2.0]]), roughness)
    colours = np.kron(np.eye(2), of_rgb)
    sums = np.kron(np.ones((1, 2)), np.eye(count))
    found = minimize(
        lambda x: (x @ both @ x / 2, both @ x),
        np.full(2 * count, 1 / 3),
        jac=True,
        bounds=[(0.0, 1.0)] * (2 * count),
        constraints=[
            LinearConstraint(colours, *[[1.0, 0, 0, 0, 1, 0]] * 2),
            LinearConstraint(sums, 0.0, 1.0),
        ],
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-12},
    )
    red, green = found.x.reshape(2, count)
    return nm, np.stack([red, green, 1 - red - green], axis=1)
