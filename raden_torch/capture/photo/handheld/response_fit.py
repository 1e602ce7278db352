"""A camera's tone curve, from grey patches of known reflectance and a white, under a known lamp.

What a patch sends to the camera is known up to the exposure: its reflectance times cos θ / d². So
ln g(z) = ln reflectance + ln cos θ / d² + exposure for each stored value z, with one curve g for
all pictures and channels, and an exposure each (white balance included). g is sRGB's curve times
exp of a spline whose knots are found by least squares, which is linear in all unknowns.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from raden_torch.arrays import Floats, Floats32
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.errors import InputError
from raden_torch.images.colour_space import SRGB_SPACE
from raden_torch.schema import Finite, NotNegative

KIND = "response"
_LEVELS = 255
_KNOTS = np.array([0.0, 0.06, 0.12, 0.2, 0.3, 0.42, 0.55, 0.7, 0.85, 1.0])
"""Of the stored value's range."""
_BEND, _NEAR_SRGB = 0.15, 1.0
"""Standard deviations before anything is seen: of the spline's second differences, and of its
values."""
_NOISE = 0.02
_DARKEST, _BRIGHTEST = 4.0, 250.0
_ROUNDS = 6
_LEAST_RANGE = 4.0
"""Of light, between the darkest and the brightest that was seen: less tells of no curve."""


@dataclass(frozen=True, eq=False)
class Greys:
    """Grey things in one picture.

    Attributes:
        stored: `[n, 3]` means of their stored values, 0…255.
        log_light: `[n]` ln of their reflectance times the irradiance, up to a constant.
    """

    stored: Floats
    log_light: Floats


@dataclass(frozen=True, eq=False)
class Response:
    """A tone curve.

    Attributes:
        table: `[256]` stored value → linear light, 1 at 255.
        known: stored values between which it was seen.
        rms: of what was seen around it, relative.
    """

    table: Floats32
    known: tuple[float, float]
    rms: float


class ResponseFile(Struct):
    """What is read of a response file."""

    linear: tuple[NotNegative, ...]
    known_from: Finite
    known_to: Finite
    rms: NotNegative


def fit_response(pictures: Sequence[Greys], *, locked: bool = False) -> Response:
    """The curve that explains the greys of all pictures.

    Args:
        locked: the exposure and the white balance are the same in all; else each has its own.

    Raises:
        InputError: too little light and shade, or a curve that does not rise.
    """
    stored, light, level = _rows(pictures, locked=locked)
    weight = np.ones(len(stored))
    design, offset = _design(stored, level)
    prior = _prior(design.shape[1])
    spline = np.zeros(len(_KNOTS))
    residual = np.zeros(len(stored))
    for _ in range(_ROUNDS):
        row = weight[:, None] / _NOISE
        a = np.concatenate([design * row, prior])
        b = np.concatenate([(light - offset) * row[:, 0], np.zeros(len(prior))])
        solved = np.linalg.lstsq(a, b, rcond=None)[0]
        spline = solved[: len(_KNOTS)]
        residual = design @ solved + offset - light
        weight = 1 / np.sqrt(1 + (residual / (2 * _NOISE)) ** 2)
    table = _curve(np.arange(_LEVELS + 1) / _LEVELS, spline)
    table[0] = 0.0
    known = float(stored.min()), float(stored.max())
    inside = table[round(known[0]) : round(known[1]) + 1]
    if not (np.diff(inside) > 0).all():
        raise InputError(
            "response: no rising curve fits the greys: are their places and reflectances right, "
            "and in the same order?"
        )
    seen = table[round(known[1])] / max(table[round(known[0])], 1e-9)
    if seen < _LEAST_RANGE:
        raise InputError(
            f"response: expected greys whose light differs by {_LEAST_RANGE:g} times or more, got "
            f"{seen:.1f} times (stored values {known[0]:.0f} to {known[1]:.0f}); add darker patches"
        )
    table = np.maximum.accumulate(table)
    return Response(
        (table / table[-1]).astype(np.float32), known, float(np.sqrt(np.median(residual**2)) * 1.48)
    )


def write_response(
    response: Response,
    path: str | os.PathLike[str],
    *,
    made_from: Collection[str | os.PathLike[str]],
) -> None:
    """Write a response file, for `read_response`."""
    content = {
        "known_from": response.known[0],
        "known_to": response.known[1],
        "rms": response.rms,
        "linear": np.round(response.table.astype(np.float64), 7),
    }
    write_result(path, KIND, content, made_from=made_from)


def read_response(path: str | os.PathLike[str]) -> Floats32:
    """`[256]` stored value of 8 bits → linear light, 1 at 255.

    Raises:
        InputError: not such a file, or a curve that falls.
    """
    table = np.array(read_result(path, KIND, ResponseFile).linear, np.float32)
    if table.shape != (_LEVELS + 1,) or table[-1] != 1 or (np.diff(table) < 0).any():
        raise InputError(
            f"{path}: linear: expected 256 values that rise to 1, got {len(table)} values"
        )
    return table


def _rows(pictures: Sequence[Greys], *, locked: bool) -> tuple[Floats, Floats, Floats]:
    """Of each usable value: it, its log light, and the number of its exposure."""
    stored, light, level = [], [], []
    for k, greys in enumerate(pictures):
        for c in range(3):
            z = greys.stored[:, c]
            good = np.isfinite(z) & np.isfinite(greys.log_light)
            good &= (z > _DARKEST) & (z < _BRIGHTEST)
            stored.append(z[good])
            light.append(greys.log_light[good])
            level.append(np.full(good.sum(), (0 if locked else 3 * k) + c))
    found = np.concatenate(stored), np.concatenate(light), np.concatenate(level)
    if len(found[0]) < 12:
        raise InputError(
            f"response: expected twelve values or more of greys that are neither black nor "
            f"clipped, got {len(found[0])}"
        )
    numbers = np.unique(found[2], return_inverse=True)[1]
    return found[0], found[1], numbers.ravel().astype(float)


def _design(stored: Floats, level: Floats) -> tuple[Floats, Floats]:
    """The matrix of the spline's knots and the exposures, and the constant: log sRGB."""
    z = stored / _LEVELS
    exposures = np.zeros((len(z), int(level.max()) + 1))
    exposures[np.arange(len(z)), level.astype(int)] = -1.0
    return np.concatenate([_hats(z), exposures], axis=1), np.log(_srgb(z))


def _prior(columns: int) -> Floats:
    count = len(_KNOTS)
    rows = np.zeros((count - 2 + count, columns))
    gap = np.diff(_KNOTS)
    for k in range(count - 2):  # change of slope, over the typical gap
        rows[k, k : k + 3] = [1 / gap[k], -1 / gap[k] - 1 / gap[k + 1], 1 / gap[k + 1]]
    rows[: count - 2] *= gap.mean() / _BEND
    rows[count - 2 :, :count] = np.eye(count) / _NEAR_SRGB
    rows[-1, count - 1] = 1e3  # 0 at the white level
    return rows


def _hats(z: Floats) -> Floats:
    """`[n, knots]` of the piecewise linear spline."""
    return np.stack([np.interp(z, _KNOTS, row) for row in np.eye(len(_KNOTS))], axis=1)


def _srgb(z: Floats) -> Floats:
    table = SRGB_SPACE.table(_LEVELS)[:, 0].astype(np.float64)
    return np.maximum(np.interp(z * _LEVELS, np.arange(_LEVELS + 1), table), 1e-6)


def _curve(z: Floats, spline: Floats) -> Floats:
    return _srgb(z) * np.exp(np.interp(z, _KNOTS, spline))
