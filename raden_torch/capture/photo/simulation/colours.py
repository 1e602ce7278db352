"""The simulation's channels, and the colours of the things in its pictures.

Mitsuba's three channels carry CIE X, Y and Z (1931 2°, D65), each over that of the perfect
reflecting diffuser: white is (1, 1, 1), and every colour that can be printed lies within 0…1, which
it does not in linear sRGB.
"""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats

CAMERA_FROM_XYZ = np.array([[0.72, -0.06, -0.06], [-0.30, 1.18, 0.10], [0.04, -0.14, 0.81]])
"""A camera's raw RGB of (X, Y, Z over white's): white is (0.60, 0.98, 0.71), red weak as in a raw
file, and no primaries of sRGB."""


def white_xyz() -> Floats:
    """`[3]` of the perfect reflecting diffuser under D65, Y = 1."""
    import colour

    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    return np.asarray(colour.xy_to_XYZ(xy), np.float64)


def chart_colours() -> Floats:
    """`[24, 3]` of a ColorChecker Classic made after November 2014, in the simulation's channels.

    X-Rite's xyY under D50, through colour-science, adapted to D65 by the Bradford transform.
    """
    import colour

    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    xyz = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
    matrix = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        colour.xy_to_XYZ(np.asarray(chart.illuminant)), white_xyz(), transform="Bradford"
    )
    return np.asarray(xyz @ matrix.T / white_xyz(), np.float64)
