"""Reflectance of a chart's patches in narrow bands, from what a camera saw through each filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.errors import InputError

_TERMS = (1, 3, 6)  # the light over the chart: even, a plane, a quadratic surface


@dataclass(frozen=True, eq=False)
class BandReflectance:
    """Reflectances, each patch predicted without its own reference reading.

    Attributes:
        reflectance: `[patches]`, 1 for the perfect diffuser.
        terms: of the surface that describes the light over the chart: 1, 3 or 6.
        rms, median, worst: of the difference from the reference.
    """

    reflectance: Floats
    terms: int
    rms: float
    median: float
    worst: float


def band_reflectance(
    signal: NDArray[Any], reference: NDArray[Any], centres: NDArray[Any]
) -> BandReflectance:
    """Reflectance from the signal in one band, without a flat field.

    signal = light(x, y) · reflectance, the light a polynomial over the chart. For each patch the
    light is fitted to the other patches' readings, and its own signal divided by it. The degree is
    the one that does best so.

    Args:
        signal: `[patches]` linear.
        reference: `[patches]` a spectrometer's readings, 1 for the perfect diffuser.
        centres: `[patches, 2]` pixels.

    Raises:
        InputError: no signal, or shapes that do not belong together.
    """
    s, r = np.asarray(signal, np.float64), np.asarray(reference, np.float64)
    xy = np.asarray(centres, np.float64)
    if not (s.shape == r.shape == xy.shape[:1] and len(s) >= 10):
        raise InputError(
            f"patches: expected one value each, for ten patches or more, got signal "
            f"{list(s.shape)}, reference {list(r.shape)}, centres {list(xy.shape)}"
        )
    if not (np.isfinite(s).all() and s.max() > 0 and (r > 0).all()):
        raise InputError(
            "patches: expected finite signals, not all 0, and a reference above 0, got others"
        )
    x, y = ((xy - xy.mean(axis=0)) / xy.std(axis=0)).T
    surface = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)
    tried = [_left_out(s, r, surface[:, :terms]) for terms in _TERMS]
    errors = [float(np.sqrt(np.mean((found - r) ** 2))) for found in tried]
    best = int(np.argmin(errors))
    off = np.abs(tried[best] - r)
    return BandReflectance(
        tried[best], _TERMS[best], errors[best], float(np.median(off)), float(off.max())
    )


def _left_out(signal: Floats, reference: Floats, surface: Floats) -> Floats:
    # relative errors count, down to a twentieth of the brightest patch
    weight = 1 / np.maximum(signal, 0.05 * signal.max())
    found = np.empty_like(signal)
    for i in range(len(signal)):
        others = np.arange(len(signal)) != i
        rows = surface[others] * (reference * weight)[others, None]
        light, *_ = np.linalg.lstsq(rows, (signal * weight)[others], rcond=None)
        found[i] = signal[i] / (surface[i] @ light)
    return found
