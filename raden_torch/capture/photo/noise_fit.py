"""The sensor's noise, found in how an exposure stack scatters around its merged radiance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.exposure_weights import Noise, evenly_picked, exposure_weight
from raden_torch.capture.photo.photograph import Photograph

_FEWEST = 200
"""Values in a level of signal without which it says nothing."""
_FEWEST_LEVELS = 3


def fit_noise(
    photos: Sequence[Photograph],
    times: Sequence[float],
    usable: Sequence[NDArray[np.bool_]],
    before: Noise,
    expected: Floats32,
    weight: Floats32,
) -> Noise | None:
    """Read noise and gain from the scatter around the merged radiance; None without scatter."""
    from scipy.optimize import nnls

    signals, residuals, roundings = [], [], []
    for photo, t, use in zip(photos, times, usable, strict=True):
        own = exposure_weight(photo, t, use, before, expected)
        # a value pulls the mean towards itself: the others must have a say
        seen = (own > 0) & (own < 0.7 * weight)
        if not seen.any():
            continue
        signal, x, own_w, all_w, rounding = evenly_picked(
            expected[seen] * t, photo.linear[seen], own[seen], weight[seen], photo.rounding[seen]
        )
        signals.append(signal)
        residuals.append((x - signal) / np.sqrt(1 - own_w / all_w))
        roundings.append(rounding)
    if not signals:
        return None
    signal, residual, rounded = (np.concatenate(p) for p in (signals, residuals, roundings))
    edges = np.geomspace(1e-3, 1, 25)
    bins = np.digitize(signal, edges)
    rows, wanted = [], []
    for level in range(1, len(edges)):
        inside = bins == level
        if inside.sum() < _FEWEST:
            continue
        spread = 1.4826 * float(np.median(np.abs(residual[inside])))
        grain = float(np.mean(rounded[inside] ** 2))
        excess = max(spread**2 - grain, 0.0)
        # a rounding in the denominator: relative errors, so that each level counts alike
        scale = 1 / max(excess, grain, 1e-10)
        rows.append([scale, scale * float(np.median(signal[inside]))])
        wanted.append(scale * excess)
    if len(rows) < _FEWEST_LEVELS:
        return None
    (read, gain), _ = nnls(np.array(rows), np.array(wanted))
    return Noise(float(np.sqrt(read)), float(gain))
