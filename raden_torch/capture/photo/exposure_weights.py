"""How much a value of one exposure counts: the sensor's noise, and means weighted by it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.photograph import Photograph

_SAMPLES = 500_000


@dataclass(frozen=True)
class Noise:
    """variance = read² + gain · signal + rounding², in units of the white level.

    The photon-transfer model (EMVA 1288): `gain` is 1 / full well in electrons.
    """

    read: float
    gain: float

    def variance(self, signal: Floats32, rounding: Floats32) -> Floats32:
        found = self.read**2 + self.gain * np.maximum(signal, 0) + rounding**2
        return np.asarray(found, np.float32)


def exposure_weight(
    photo: Photograph, t: float, use: NDArray[np.bool_], noise: Noise, expected: Floats32 | None
) -> Floats32:
    """t² / variance `[H, W, C]`, 0 where a value is not used.

    Args:
        t: exposure time in seconds.
        use: `[H, W]`.
        expected: `[H, W, C]` radiance, at which the variance is taken; None: at the value itself.
    """
    signal = photo.linear if expected is None else expected * t
    variance = np.maximum(noise.variance(signal, photo.rounding), 1e-12)
    return np.where(use[..., None], t * t / variance, 0).astype(np.float32)


def weighted_mean(total: Floats32, weight: Floats32) -> Floats32:
    """Sums over weights; 0 where there is no weight."""
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)


def evenly_picked(*arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """At most `_SAMPLES` of each, the same ones, evenly spread."""
    step = max(1, len(arrays[0]) // _SAMPLES)
    return [array[::step] for array in arrays]
