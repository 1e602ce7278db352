"""Spectra → X, Y, Z and linear RGB, for NumPy and torch: the CIE's sums from tables of our own.

    X = k Σ S(λ) R(λ) x̄(λ) Δλ,  k = 1 / Σ S(λ) ȳ(λ) Δλ

(CIE 015:2018, §7.1), at steps of 1 nm over 380…780 nm, so that Y is 1 for the perfect reflecting
diffuser. A spectrum is taken as linear between its wavelengths and constant beyond them. The tables
of observers and illuminants come from colour-science, which `tests/optics/test_spectral_colour.py`
compares; it is not needed here.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from raden_torch.arrays import Floats
from raden_torch.colorimetry import (
    WHITES_2_DEG,
    WHITES_10_DEG,
    XYZ_TO_SRGB,
    bradford,
    xyz_of_white,
)
from raden_torch.errors import InputError
from raden_torch.optics.array_library import Array, as_real

OBSERVERS = {"CIE 1931 2 deg": WHITES_2_DEG, "CIE 1964 10 deg": WHITES_10_DEG}
ILLUMINANTS = ("A", "C", "D50", "D55", "D65", "D75", "E")
VISIBLE_NM = (380.0, 780.0)

_FARTHEST_NM = 20.0  # that a spectrum may end before the visible range does
_COARSEST_NM = 40.0


def xyz_weights(
    wavelength_nm: ArrayLike, *, illuminant: str = "D65", observer: str = "CIE 1931 2 deg"
) -> Floats:
    """`[W, 3]`: spectrum @ weights is X, Y, Z, 1 for Y of the perfect diffuser.

    Args:
        wavelength_nm: `[W]`, rising, at most 40 nm apart, from 400 nm or less to 760 nm or more;
            what lies outside 380…780 nm counts where the spectrum is linear to it.
        illuminant: one of `ILLUMINANTS`.
        observer: a key of `OBSERVERS`.

    Raises:
        InputError: wavelengths, illuminant or observer that are not these.
    """
    if illuminant not in ILLUMINANTS:
        raise InputError(
            f"illuminant: expected one of {', '.join(ILLUMINANTS)}, got {illuminant!r}"
        )
    if observer not in OBSERVERS:
        raise InputError(f"observer: expected one of {', '.join(OBSERVERS)}, got {observer!r}")
    nodes = np.asarray(wavelength_nm, np.float64)
    if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0).all():
        raise InputError("wavelength_nm: expected two numbers [W] or more that rise, got others")
    low, high = VISIBLE_NM[0] + _FARTHEST_NM, VISIBLE_NM[1] - _FARTHEST_NM
    if nodes[0] > low or nodes[-1] < high or np.diff(nodes).max() > _COARSEST_NM:
        raise InputError(
            f"wavelength_nm: expected {low:g}…{high:g} nm or more in steps of at most "
            f"{_COARSEST_NM:g} nm, got {nodes[0]:g}…{nodes[-1]:g} nm in steps of up to "
            f"{np.diff(nodes).max():g} nm"
        )
    return _weights(tuple(nodes.tolist()), illuminant, observer).copy()


def spectrum_to_xyz(
    spectrum: Array,
    wavelength_nm: ArrayLike,
    *,
    illuminant: str = "D65",
    observer: str = "CIE 1931 2 deg",
) -> Array:
    """`[..., W]` reflectances → `[..., 3]` X, Y, Z, Y = 1 for the perfect reflecting diffuser.

    Linear, so differentiable: with a tensor the weights are of its dtype and on its device. Other
    arguments and errors as of `xyz_weights`.

    Examples:
        >>> import numpy as np
        >>> wavelengths = np.arange(380.0, 781.0, 5.0)
        >>> spectrum_to_xyz(np.ones(81), wavelengths).round(4).tolist()
        [0.9504, 1.0, 1.0889]
    """
    weights = xyz_weights(wavelength_nm, illuminant=illuminant, observer=observer)
    return _applied(spectrum, weights)


def spectrum_to_rgb(
    spectrum: Array,
    wavelength_nm: ArrayLike,
    *,
    illuminant: str = "D65",
    observer: str = "CIE 1931 2 deg",
) -> Array:
    """`[..., W]` reflectances → `[..., 3]` linear RGB with sRGB primaries, unclipped.

    The perfect reflecting diffuser is 1, 1, 1 under every illuminant (Bradford's transform), and
    colours outside the gamut have a negative channel. Arguments as for `spectrum_to_xyz`.
    """
    weights = xyz_weights(wavelength_nm, illuminant=illuminant, observer=observer)
    source = xyz_of_white(OBSERVERS[observer][illuminant])
    target = xyz_of_white(WHITES_2_DEG["D65"])
    to_rgb = weights @ (XYZ_TO_SRGB @ bradford(source, target)).T
    return _applied(spectrum, to_rgb / to_rgb.sum(axis=0))


def _applied(spectrum: Array, weights: Floats) -> Array:
    values = as_real(spectrum)
    if values.shape[-1:] != weights.shape[:1]:
        raise InputError(
            f"spectrum: expected {len(weights)} values in the last dimension, one for each "
            f"wavelength, got shape {list(values.shape)}"
        )
    return values @ as_real(weights, values)


@lru_cache(maxsize=32)
def _weights(nodes: tuple[float, ...], illuminant: str, observer: str) -> Floats:
    observers, illuminants = _table("observers.csv"), _table("illuminants.csv")
    nm = observers[:, 0]
    first = 1 + 3 * tuple(OBSERVERS).index(observer)
    light = np.interp(nm, illuminants[:, 0], illuminants[:, 1 + ILLUMINANTS.index(illuminant)])
    lit = observers[:, first : first + 3] * light[:, None]
    # each 1 nm goes to the two wavelengths beside it
    share = np.stack([np.interp(nm, nodes, row) for row in np.eye(len(nodes))])
    return share @ lit / lit[:, 1].sum()


@lru_cache(maxsize=2)
def _table(name: str) -> Floats:
    return np.loadtxt(Path(__file__).with_name(name), delimiter=",", skiprows=3)
