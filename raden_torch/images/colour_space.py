"""What a file's numbers mean as colours: the way to linear light with sRGB's primaries."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.colorimetry import DISPLAY_P3, SRGB, bradford, primary_matrix, xyz_of_white
from raden_torch.errors import InputError
from raden_torch.images.header import ColourTags
from raden_torch.images.icc import (
    ICC_WHITE,
    Curve,
    IccProfile,
    UnknownProfile,
    has_lookup_tables,
    parse_icc,
    power,
)
from raden_torch.images.lookup_profile import LookupProfile

ADOBE_RGB = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290)
"""Adobe RGB (1998), whose curve is the power 563/256."""
_CICP_PRIMARIES = {
    1: SRGB,
    9: (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),  # BT.2020
    12: DISPLAY_P3,
}
_SAME_MATRIX, _SAME_CURVE = 2e-3, 5e-4
"""A profile this near to sRGB is sRGB, rounded otherwise."""


@dataclass(frozen=True)
class ColourSpace:
    """How stored RGB becomes linear RGB with sRGB's primaries.

    Attributes:
        curves: stored 0…1 → linear, for red, green and blue.
        matrix: `[3, 3]`, the file's linear RGB → sRGB's, or None where they are the same.
    """

    curves: tuple[Curve, Curve, Curve]
    matrix: Floats | None = None

    def table(self, levels: int, white: float | None = None) -> NDArray[np.float32]:
        """`[levels + 1, 3]`: what the curves make of each whole number; `white` stands for 1."""
        stored = np.arange(levels + 1) / (levels if white is None else white)
        return np.stack([curve(stored) for curve in self.curves], 1).astype(np.float32)

    @property
    def is_linear(self) -> bool:
        return all(_near(curve, _identity) for curve in self.curves)


def colour_space_of(
    tags: ColourTags, path: str | os.PathLike[str]
) -> ColourSpace | LookupProfile | None:
    """What a file says; None where it says nothing, or sRGB (`SRGB_SPACE`).

    The order of precedence is PNG's: cICP, an ICC profile, sRGB, then gAMA and cHRM.

    Raises:
        InputError: a profile that is neither grey nor RGB, or a curve that is made for HDR.
    """
    found: ColourSpace | LookupProfile | None = None
    if tags.cicp is not None:
        found = _by_cicp(tags.cicp, path)
    elif tags.icc is not None:
        found = _by_icc(tags.icc, path)
    elif tags.srgb:
        return None
    elif tags.adobe:
        found = ColourSpace(_three(_gamma(563 / 256)), to_srgb(ADOBE_RGB, path))
    elif tags.gamma is not None or tags.chromaticities is not None:
        coded = tags.gamma or 0
        is_srgb = coded <= 0 or abs(coded - 1 / 2.2) < 5e-3
        curve = srgb_curve if is_srgb else _gamma(1 / coded)
        found = ColourSpace(_three(curve), to_srgb(tags.chromaticities or SRGB, path))
    if isinstance(found, LookupProfile):
        return found
    is_srgb = found is None or (
        found.matrix is None and all(_near(curve, srgb_curve) for curve in found.curves)
    )
    return None if is_srgb else found


def to_srgb(chromaticities: tuple[float, ...], path: str | os.PathLike[str]) -> Floats | None:
    """`[3, 3]`: linear RGB of these primaries and white → sRGB's, adapted by Bradford; None where
    it is the identity.

    Args:
        chromaticities: x, y of red, green, blue and white, as OpenEXR's attribute has them.

    Raises:
        InputError: no primaries of a colour space.
    """
    place = np.array(chromaticities, np.float64)
    if (
        not np.isfinite(place).all()
        or place[7] <= 0
        or abs(np.linalg.det(np.column_stack([place[:6].reshape(3, 2), np.ones(3)]))) < 1e-6
    ):
        raise InputError(
            f"{path}: expected x, y of three primaries and a white, got "
            f"{', '.join(f'{v:g}' for v in place)}"
        )
    if np.allclose(chromaticities, SRGB, atol=5e-4):
        return None
    return _from_xyz(primary_matrix(chromaticities), xyz_of_white(chromaticities[6:]))


def in_srgb(linear: NDArray[np.float32], matrix: Floats | None) -> NDArray[np.float32]:
    """`[…, 3]` through the matrix, unclipped."""
    return linear if matrix is None else linear @ matrix.T.astype(np.float32)


def exr_matrix(path: str | os.PathLike[str]) -> Floats | None:
    """`[3, 3]` of an EXR's `chromaticities`, which all its parts share; None where it is sRGB."""
    from raden_torch.images.exr_file import ExrFile

    place = ExrFile(path).first.chromaticities
    return None if place is None else to_srgb(place, path)


def float_matrix(
    tags: ColourTags, path: str | os.PathLike[str], *, is_linear: bool
) -> Floats | None:
    """`[3, 3]` of a floating-point file, whose values are linear light; None where it is sRGB's.

    Args:
        is_linear: the user says so, whatever the file's profile says.

    Raises:
        InputError: as for `colour_space_of`; a profile of lookup tables; one with a curve, and
            nobody says which of both is right.
    """
    space = colour_space_of(tags, path)
    if isinstance(space, LookupProfile):
        raise no_primaries(path)
    if tags.icc is not None and not is_linear and (space is None or not space.is_linear):
        raise InputError(
            f"{path}: expected linear light in floats, got a profile with a curve; save it with a "
            "linear profile, or say that it is linear"
        )
    return None if space is None else space.matrix


def srgb_curve(coded: Floats) -> Floats:
    """sRGB 0…1 → linear (IEC 61966-2-1)."""
    return np.where(coded <= 0.04045, coded / 12.92, power((coded + 0.055) / 1.055, 2.4))


def no_primaries(path: str | os.PathLike[str]) -> InputError:
    """For values that are said to be linear, or sRGB, beside a profile of tables."""
    return InputError(
        f"{path}: expected a profile with primaries for values that are known to be linear or "
        "sRGB's, got one of lookup tables; say nothing of them, or convert it to sRGB first"
    )


def _by_icc(data: bytes, path: str | os.PathLike[str]) -> ColourSpace | LookupProfile:
    try:
        if has_lookup_tables(data):
            return LookupProfile(data, path)
        profile: IccProfile = parse_icc(data)
    except UnknownProfile as error:
        raise InputError(
            f"{path}: expected an RGB or grey profile (a grey one without lookup tables), or none, "
            f"got {error}; convert it to sRGB first"
        ) from None
    curves = profile.curves * 3 if len(profile.curves) == 1 else profile.curves
    first, second, third = curves
    matrix = None if profile.to_xyz is None else _from_xyz(profile.to_xyz, np.array(ICC_WHITE))
    return ColourSpace((first, second, third), matrix)


def _by_cicp(cicp: tuple[int, int, int, int], path: str | os.PathLike[str]) -> ColourSpace:
    curves = {4: _gamma(2.2), 5: _gamma(2.8), 8: _identity, 13: srgb_curve}
    primaries, transfer, matrix, is_full = cicp
    if primaries not in _CICP_PRIMARIES or transfer not in curves or (matrix, is_full) != (0, 1):
        raise InputError(
            f"{path}: expected the colours of sRGB, Display P3 or BT.2020 with sRGB's curve, a "
            f"power or none, got cICP {'-'.join(map(str, cicp))} (HDR?); convert it to sRGB first"
        )
    return ColourSpace(_three(curves[transfer]), to_srgb(_CICP_PRIMARIES[primaries], path))


def _from_xyz(to_xyz: Floats, white: Floats) -> Floats | None:
    srgb = primary_matrix(SRGB)
    matrix = np.asarray(np.linalg.solve(srgb, bradford(white, srgb.sum(axis=1)) @ to_xyz))
    return None if np.abs(matrix - np.eye(3)).max() < _SAME_MATRIX else matrix


def _gamma(exponent: float) -> Curve:
    return lambda x: power(x, exponent)


def _identity(x: Floats) -> Floats:
    return x


def _near(one: Curve, other: Curve) -> bool:
    x = np.linspace(0, 1, 1025)
    return bool(np.abs(one(x) - other(x)).max() < _SAME_CURVE)


def _three(curve: Curve) -> tuple[Curve, Curve, Curve]:
    return curve, curve, curve


SRGB_SPACE = ColourSpace(_three(srgb_curve))
