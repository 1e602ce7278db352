"""The white's place in a chart and its reflectance factor, as a person gives them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.capture_settings import WhiteFactorSpec
from raden_torch.capture.photo.brdf.photo_white import WhiteFactor
from raden_torch.capture.photo.chart_reference import PATCH_NAMES, reference_xyz
from raden_torch.capture.photo.colour import ColourFile
from raden_torch.capture.photo.result_file import read_result
from raden_torch.colorimetry import D65_XYZ
from raden_torch.errors import InputError

_WHITE = PATCH_NAMES.index("white 9.5")
_MEASURED = 0.6
"""Share of the patch that is taken."""
_MOST = 300.0


def chart_white(colour: Path | None, said: WhiteFactorSpec) -> tuple[Floats | None, WhiteFactor]:
    """The corners of a chart's white patch `[4, 2]` in pixels, and how much the white reflects.

    Args:
        colour: a colour file whose photograph had the chart where these have it; None: the white
            is elsewhere.
        said: of the factor; where it holds none, the chart's own is taken.

    Raises:
        InputError: no factor, or one that no white has.
    """
    relative = said.std_percent / 100
    corners, edition = (None, None) if colour is None else _patch(colour)
    if said.file is not None:
        if not said.file.is_file():
            raise InputError(f"{said.file}: expected a measurement of the white, got no such file")
        return corners, WhiteFactor(D65_XYZ, said.file, relative, said.name)
    if said.factor is not None:
        return corners, WhiteFactor(_xyz(said.factor), None, relative, said.name)
    if edition is None:
        raise InputError(
            "white: expected its reflectance factor, got none: give `white_factor` (the perfect "
            "diffuser is 100), or `white_file`, a measurement of it"
        )
    return corners, WhiteFactor(100 * reference_xyz(edition)[_WHITE], None, relative, said.name)


def _patch(path: str | os.PathLike[str]) -> tuple[Floats, str]:
    import cv2

    found = read_result(path, "colour", ColourFile)
    if found.chart_corners_px is None:
        raise InputError(f"{path}: chart_corners_px: expected the chart's corners, got none")
    corners = np.array(found.chart_corners_px, np.float32)
    chart = np.array([[0, 0], [6, 0], [6, 4], [0, 4]], np.float32)
    row, column = divmod(_WHITE, 6)
    half = _MEASURED / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    square = np.array([column + 0.5, row + 0.5]) + half
    mapped = np.c_[square, np.ones(4)] @ cv2.getPerspectiveTransform(chart, corners).T
    edition = found.chart.rpartition("edition ")[2]
    return mapped[:, :2] / mapped[:, 2:], edition


def _xyz(text: str) -> Floats:
    try:
        given = np.array([float(part) for part in text.split(",")])
    except ValueError:
        given = np.zeros(0)
    if len(given) == 1:
        given = given * D65_XYZ / 100
    if len(given) != 3 or not ((given > 0) & (given <= _MOST)).all():
        raise InputError(
            "white: reflectance factor: expected one number or X,Y,Z, above 0, with the perfect "
            f"diffuser 100, got {text}"
        )
    return given
