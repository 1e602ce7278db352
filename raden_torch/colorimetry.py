"""Whites and primaries: constants of the standards, and the matrices that are made of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raden_torch.arrays import Floats

SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""x, y of red, green, blue and white (IEC 61966-2-1)."""
DISPLAY_P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)
"""The same of Display P3 (SMPTE EG 432-1's primaries with D65)."""
ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
"""The same of ACEScg, whose primaries are AP1 (S-2014-004)."""
D65_XYZ = np.array([95.047, 100.0, 108.883])
"""XYZ of the perfect reflecting diffuser under D65, 2° observer: CIE 015:2018, rounded as IEC
61966-2-1 has it."""
XYZ_TO_SRGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
"""Linear; rounded as IEC 61966-2-1 has it."""
SRGB_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Y of linear sRGB's red, green and blue (IEC 61966-2-1)."""
WHITES_2_DEG = {
    "A": (0.44758, 0.40745),
    "C": (0.31006, 0.31616),
    "D50": (0.3457, 0.3585),
    "D55": (0.33243, 0.34744),
    "D65": (0.3127, 0.3290),
    "D75": (0.29903, 0.31488),
    "E": (1 / 3, 1 / 3),
}
"""x, y of illuminants for the 2° observer (CIE 015:2018)."""
WHITES_10_DEG = {
    "A": (0.45117, 0.40594),
    "C": (0.31039, 0.31905),
    "D50": (0.34773, 0.35952),
    "D55": (0.33412, 0.34877),
    "D65": (0.31382, 0.33100),
    "D75": (0.29968, 0.31740),
    "E": (1 / 3, 1 / 3),
}
"""The same for the 10° observer."""

_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def xyz_of_white(xy: Sequence[float] | Floats) -> Floats:
    """XYZ `(3,)` of a chromaticity, at Y = 1."""
    x, y = xy
    return np.array([x / y, 1.0, (1 - x - y) / y])


def bradford(source: Floats, target: Floats) -> Floats:
    """`[3, 3]`: XYZ seen under the white `source` → under the white `target`, both XYZ `(3,)`.

    Source: Lam (1985), linear, as the ICC's specification has it (annex E).
    """
    gain = (_BRADFORD @ target) / (_BRADFORD @ source)
    return np.asarray(np.linalg.solve(_BRADFORD, gain[:, None] * _BRADFORD))


def primary_matrix(chromaticities: Sequence[float]) -> Floats:
    """`[3, 3]`: linear RGB → XYZ with the white at Y = 1 (SMPTE RP 177).

    Args:
        chromaticities: x, y of red, green, blue and white.
    """
    x, y = np.reshape(chromaticities, (4, 2)).T[:, :3]
    primaries = np.stack([x, y, 1 - x - y])
    return np.asarray(primaries * np.linalg.solve(primaries, xyz_of_white(chromaticities[6:])))


def between(source: Sequence[float], target: Sequence[float]) -> Floats:
    """`[3, 3]`: linear RGB of one set of primaries → of another, adapted by Bradford.

    Args:
        source, target: x, y of red, green, blue and white.
    """
    adapted = bradford(xyz_of_white(source[6:]), xyz_of_white(target[6:]))
    return np.asarray(np.linalg.solve(primary_matrix(target), adapted @ primary_matrix(source)))


def lab_of(xyz: Floats, white: Floats) -> Floats:
    """XYZ `[..., 3]` → CIELAB `[..., 3]`: L*, a*, b* (CIE 15:2018, 8.2.1).

    Args:
        white: XYZ `(3,)` of the white, on the same scale; its L* is 100.
    """
    ratio = np.asarray(xyz) / white
    linear = (841 / 108) * ratio + 4 / 29
    x, y, z = np.moveaxis(np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), linear), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def xyz_of(lab: Floats, white: Floats) -> Floats:
    """The inverse of `lab_of`."""
    lightness, a, b = np.moveaxis(np.asarray(lab, float), -1, 0)
    y = (lightness + 16) / 116
    root = np.stack([y + a / 500, y, y - b / 200], axis=-1)
    return np.asarray(white * np.where(root > 6 / 29, root**3, (root - 4 / 29) * (108 / 841)))
