"""The white and the greys on the board: exposure, and what shows the tone curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats, Floats32
from raden_torch.capture.photo.brdf.board_region import board_pixels
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.handheld.handheld_setup import HandheldSetup
from raden_torch.capture.photo.handheld.lamp_sights import CLIPPED, Sights
from raden_torch.capture.photo.handheld.response_fit import Greys, Response, fit_response

_MOST_CLIPPED, _DARK, _OF_SQUARES = 0.1, 24.0, 0.6
"""Of the white: share of its pixels; stored value, and that over the white squares'."""
_GREY_M = 0.002
"""Half of the side of the square that is measured of a grey patch."""


@dataclass(frozen=True, eq=False)
class Places:
    """What one picture holds in the white and the greys.

    Attributes:
        white: `[3]` median stored value.
        greys: `[G, 3]` the same of each grey; NaN where it is clipped, or too small.
        refused: why the white does not tell the exposure; "" where it does.
    """

    white: Floats
    greys: Floats
    refused: str


def places_in(
    stored: NDArray[np.uint8], seen: Sights, camera: Camera, pose: Pose, setup: HandheldSetup
) -> Places:
    """Read a picture `[H, W, 3]`.

    Raises:
        InputError: a place that lies behind the camera.
    """
    region = board_pixels(setup.white_m, camera, pose, camera.size, "white")
    white = stored[region]
    level = np.median(white, axis=0) if len(white) else np.zeros(3)
    half = _GREY_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    greys = np.full((len(setup.greys), 3), np.nan)
    for k, grey in enumerate(setup.greys):
        at = np.array([grey.x_m, grey.y_m]) + half
        values = stored[board_pixels(at, camera, pose, camera.size, "grey")]
        if len(values) >= 4 and not (values >= CLIPPED).any():
            greys[k] = np.median(values, axis=0)
    return Places(level, greys, _refused(region, white, level, seen))


def _refused(region: Bools, white: NDArray[np.uint8], level: Floats, seen: Sights) -> str:
    edge = np.concatenate([region[0], region[-1], region[:, 0], region[:, -1]])
    if region.sum() < 100 or edge.any():
        return "the white is not whole in it"
    clipped = float((white >= CLIPPED).any(axis=1).mean())
    if clipped > _MOST_CLIPPED:
        return f"the white is clipped: {100 * clipped:.0f} % of it"
    if level[1] < max(_DARK, _OF_SQUARES * _median(seen.squares)):
        return "the white is dark beside the board's white squares"
    return ""


def response_of(
    places: Sequence[Places], lamps_m: Sequence[Floats], setup: HandheldSetup
) -> Response:
    """The tone curve.

    Args:
        lamps_m: `[3]` of each picture, on the board.
    """
    at = [np.array([grey.x_m, grey.y_m, 0.0]) for grey in setup.greys]
    seen = []
    for place, lamp in zip(places, lamps_m, strict=True):
        light = [
            np.log(grey.reflectance * _irradiance(lamp, where))
            for grey, where in zip(setup.greys, at, strict=True)
        ]
        seen.append(Greys(place.greys, np.array(light)))
    return fit_response(seen, locked=setup.locked)


def exposures_of(
    places: Sequence[Places], lamps_m: Sequence[Floats], setup: HandheldSetup, table: Floats32
) -> Floats:
    """`[n, 3]` light of the white over its irradiance, relative to the median."""
    middle = np.append(setup.white_m.mean(axis=0), 0.0)
    values = np.array([
        np.interp(place.white, np.arange(len(table)), table) / _irradiance(lamp, middle)
        for place, lamp in zip(places, lamps_m, strict=True)
    ])  # fmt: skip
    return np.asarray(values / np.median(values, axis=0))


def _median(values: Floats) -> float:
    """Of those that are known; 0 where none is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _irradiance(lamp_m: Floats, at_m: Floats) -> float:
    """cos θ / d² on the board."""
    to = lamp_m - at_m
    square = float(to @ to)
    return max(-float(to[2]) / np.sqrt(square), 1e-6) / square
