"""Spectral bands → XYZ → linear RGB; bands and rarer whites through colour-science.

All three are reflectance factors on the scale where the perfect reflecting diffuser is 100, so a
neutral sample has X : Y : Z of the white and R = G = B.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.colorimetry import (
    WHITES_2_DEG,
    WHITES_10_DEG,
    XYZ_TO_SRGB,
    bradford,
    xyz_of_white,
)
from raden_torch.errors import InputError
from raden_torch.measurement.illuminants import OBSERVERS, Illuminant
from raden_torch.measurement.readings import (
    FACTOR_PER_SR,
    RGB,
    XYZ,
    BrdfMeasurement,
)
from raden_torch.packages import require

_WHITES = {"CIE 1931 2 deg": WHITES_2_DEG, "CIE 1964 10 deg": WHITES_10_DEG}
_VISIBLE_NM = (400.0, 700.0)  # bands must reach this far (within 20 nm) to make a colour
_MAX_BAND_STEP_NM = 40.0


def as_xyz(measurement: BrdfMeasurement) -> BrdfMeasurement:
    """CIE XYZ reflectance factors under the measurement's white.

    Raises:
        InputError: bands that do not span the visible range; an unknown white or observer.
    """
    if measurement.channels == XYZ:
        return measurement
    return _transformed(measurement, matrix_to(measurement, XYZ), XYZ)


def as_rgb(measurement: BrdfMeasurement) -> BrdfMeasurement:
    """Linear RGB with sRGB primaries, unclipped: iridescent colours leave the gamut.

    XYZ of a white other than D65 is adapted by the Bradford transform.
    """
    if measurement.channels == RGB:
        return measurement
    return _transformed(measurement, matrix_to(measurement, RGB), RGB)


def matrix_to(measurement: BrdfMeasurement, channels: tuple[str, ...]) -> Floats:
    """`[3, C]` from the measurement's channels to XYZ or RGB.

    Raises:
        InputError: as `as_xyz`.
    """
    if measurement.channels == channels:
        return np.eye(len(channels))
    observer = _observer(measurement)
    if channels == XYZ and measurement.channels == RGB:
        return np.asarray(np.linalg.inv(xyz_to_rgb_matrix(measurement.metadata.white, observer)))
    to_xyz = np.eye(3) if measurement.channels == XYZ else bands_to_xyz_matrix(measurement)
    if channels == XYZ:
        return to_xyz
    return xyz_to_rgb_matrix(measurement.metadata.white, observer) @ to_xyz


def xyz_to_rgb_matrix(white: str = "D65", observer: str = "CIE 1931 2 deg") -> Floats:
    """`[3, 3]` matrix M with rgb = M @ xyz, both on the same scale; `white` maps to R = G = B.

    Source: IEC 61966-2-1 for the primaries, the Bradford transform for whites other than D65.
    """
    source, srgb = xyz_of_white(_white_xy(white, observer)), xyz_of_white(WHITES_2_DEG["D65"])
    return np.asarray(XYZ_TO_SRGB @ bradford(source, srgb))


def f_r_of_xyz(xyz: Floats) -> Floats:
    """XYZ reflectance factors `[…, 3]` → f_r in 1/sr, linear RGB."""
    return np.asarray(xyz @ xyz_to_rgb_matrix().T / FACTOR_PER_SR)


def xyz_of_f_r(f_r: Floats) -> Floats:
    """f_r in 1/sr, linear RGB `[…, 3]` → XYZ reflectance factors."""
    return np.asarray(f_r @ np.linalg.inv(xyz_to_rgb_matrix()).T * FACTOR_PER_SR)


def why_no_colour(measurement: BrdfMeasurement) -> str | None:
    """What keeps spectral bands from making a colour; None where nothing does."""
    if not measurement.is_spectral:
        return None
    bands, (low, high) = measurement.wavelengths_nm, _VISIBLE_NM
    if len(bands) < 2 or bands[0] > low + 20 or bands[-1] < high - 20:
        return (
            f"expected bands that span {low:g}…{high:g} nm, to make a colour, got "
            f"{bands[0]:g}…{bands[-1]:g} nm"
        )
    if np.diff(bands).max() > _MAX_BAND_STEP_NM:
        return (
            f"expected bands at most {_MAX_BAND_STEP_NM:g} nm apart, to make a colour, got "
            f"{np.diff(bands).max():g} nm"
        )
    return None


def _transformed(
    measurement: BrdfMeasurement, matrix: NDArray[Any], channels: tuple[str, ...]
) -> BrdfMeasurement:
    std = measurement.std
    return replace(
        measurement,
        values=measurement.values @ matrix.T,
        channels=channels,
        # independent channels: the variances add with the squared coefficients
        std=None if std is None else np.sqrt(std**2 @ (matrix.T**2)),
    )


def bands_to_xyz_matrix(measurement: BrdfMeasurement) -> Floats:
    """`[3, C]`: XYZ on the 0…100 scale of a reflectance factor on the 0…100 scale.

    See `illuminants` for how bands are joined and integrated.
    """
    bands = measurement.wavelengths_nm
    reason = why_no_colour(measurement)
    if reason:
        raise InputError(f"measurement: {reason}")
    require("colours of spectral bands", "spectral")
    import colour

    white, observer = measurement.metadata.white, _observer(measurement)
    _white_xy(white, observer)
    if white not in colour.SDS_ILLUMINANTS:
        raise InputError(
            f"measurement: expected a white whose spectrum is known, as D65, got {white}"
        )
    return Illuminant.of(white).xyz_weights(bands, observer).T


def _observer(measurement: BrdfMeasurement) -> str:
    name = measurement.metadata.observer
    if name not in OBSERVERS:
        raise InputError(
            f"measurement: observer: expected one of {', '.join(OBSERVERS)}, got {name!r}"
        )
    return name


def _white_xy(white: str, observer: str) -> Floats:
    if white in _WHITES[observer]:
        return np.array(_WHITES[observer][white])
    require(f"whites other than {', '.join(_WHITES[observer])}", "spectral")
    import colour

    known = colour.CCS_ILLUMINANTS[OBSERVERS[observer]]
    if white not in known:
        raise InputError(
            f"measurement: white: expected D65, D50, A, E or another that is known, got {white!r}"
        )
    return np.asarray(known[white], np.float64)
