"""The white and the greys on the board: exposure, and what shows the tone curve."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raden_torch.arrays import Floats, Floats32
from raden_torch.capture.photo.brdf.board_region import board_pixels
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.handheld.footage import Picture
from raden_torch.capture.photo.handheld.handheld_setup import HandheldSetup
from raden_torch.capture.photo.handheld.judging import Judged
from raden_torch.capture.photo.handheld.lamp_fit import FoundLamp
from raden_torch.capture.photo.handheld.lamp_sights import CLIPPED, Sights
from raden_torch.capture.photo.handheld.response_fit import Greys, Response, fit_response

_MOST_CLIPPED, _DARK, _OF_SQUARES = 0.1, 24.0, 0.6
"""Of the white: share of its pixels; stored value, and that over the white squares'."""
_GREY_M = 0.002
"""Half of the side of the square that is measured of a grey patch."""


def white_checked(
    looked: list[Judged],
    chosen: Sequence[int],
    poses: dict[int, Pose],
    seen: dict[int, Sights],
    camera: Camera,
    setup: HandheldSetup,
    read: dict[int, Picture],
) -> list[Judged]:
    """The same, those of which the white does not tell the exposure refused."""
    looked = list(looked)
    for k in chosen:
        region = board_pixels(setup.white_m, camera, poses[k], camera.size, looked[k].name)
        edge = np.concatenate([region[0], region[-1], region[:, 0], region[:, -1]])
        if region.sum() < 100 or edge.any():
            looked[k] = looked[k].because("the white is not whole in it")
            continue
        white = read[k].pixels[region]
        clipped = float((white >= CLIPPED).any(axis=1).mean())
        if clipped > _MOST_CLIPPED:
            looked[k] = looked[k].because(f"{100 * clipped:.0f} % of the white is clipped")
        elif np.median(white[:, 1]) < max(_DARK, _OF_SQUARES * _median(seen[k].squares)):
            looked[k] = looked[k].because("the white is dark beside the board's white squares")
    return looked


def response_of(
    frames: Sequence[Picture],
    poses: Sequence[Pose],
    groups: Sequence[int],
    lamps: Sequence[FoundLamp],
    camera: Camera,
    setup: HandheldSetup,
) -> Response:
    seen = []
    half = _GREY_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for picture, pose, group in zip(frames, poses, groups, strict=True):
        stored, light = [], []
        lamp = _on_board(lamps[group].at_m, pose, setup)
        for grey in setup.greys:
            at = np.array([grey.x_m, grey.y_m])
            region = board_pixels(at + half, camera, pose, camera.size, picture.name)
            values = picture.pixels[region].astype(np.float64)
            usable = len(values) >= 4 and not (values >= CLIPPED).any()
            stored.append(np.median(values, axis=0) if usable else np.full(3, np.nan))
            light.append(np.log(grey.reflectance * _irradiance(lamp, np.append(at, 0.0))))
        seen.append(Greys(np.array(stored), np.array(light)))
    return fit_response(seen, locked=setup.locked)


def exposures_of(
    frames: Sequence[Picture],
    poses: Sequence[Pose],
    groups: Sequence[int],
    lamps: Sequence[FoundLamp],
    camera: Camera,
    setup: HandheldSetup,
    table: Floats32,
) -> Floats:
    middle = np.append(setup.white_m.mean(axis=0), 0.0)
    found = []
    for picture, pose, group in zip(frames, poses, groups, strict=True):
        region = board_pixels(setup.white_m, camera, pose, camera.size, picture.name)
        light = np.median(table[picture.pixels[region]], axis=0)
        found.append(light / _irradiance(_on_board(lamps[group].at_m, pose, setup), middle))
    values = np.array(found)
    return np.asarray(values / np.median(values, axis=0))


def _median(values: Floats) -> float:
    """Of those that are known; 0 where none is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _on_board(at_m: Floats, pose: Pose, setup: HandheldSetup) -> Floats:
    return pose.rotation.T @ (at_m - pose.translation_m) if setup.lamp_on_camera else at_m


def _irradiance(lamp_m: Floats, at_m: Floats) -> float:
    """cos θ / d² on the board."""
    to = lamp_m - at_m
    square = float(to @ to)
    return max(-float(to[2]) / np.sqrt(square), 1e-6) / square
