"""How far a camera's signal is from proportional to the exposure time, by a stack of exposures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32, weighted_quantile
from raden_torch.capture.photo.exposure_weights import (
    Noise,
    evenly_picked,
    exposure_weight,
    weighted_mean,
)
from raden_torch.capture.photo.photograph import Photograph

DETECTION = 10.0
"""Signals below so many standard deviations are left out of the linearity: noise alone makes them
deviate by more than a tenth."""


@dataclass(frozen=True)
class Linearity:
    """How far the signal is from proportional to the exposure time, as relative deviations.

    Attributes:
        median: of |signal / (merged radiance · time) − 1|.
        weighted_95: the 95 % quantile, each value weighted by 1 / its relative noise variance.
        median_left_out, weighted_95_left_out: the same against radiance merged from the *other*
            exposures only, which is stricter.
        samples: values compared, all unsaturated and above the noise.
    """

    median: float
    weighted_95: float
    median_left_out: float
    weighted_95_left_out: float
    samples: int

    def __str__(self) -> str:
        return (
            f"signal against exposure time: median deviation {100 * self.median:.2f} %, "
            f"noise-weighted 95 % quantile {100 * self.weighted_95:.2f} % "
            f"({self.samples} values; against the other exposures alone "
            f"{100 * self.median_left_out:.2f} % and {100 * self.weighted_95_left_out:.2f} %)"
        )


def linearity_of(
    photos: Sequence[Photograph],
    times: Sequence[float],
    usable: Sequence[NDArray[np.bool_]],
    noise: Noise,
    total: Floats32,
    weight: Floats32,
) -> Linearity | None:
    """Of K photographs, against what they were merged to.

    Args:
        times: `[K]` seconds.
        usable: `[K]` of `[H, W]`.
        total, weight: `[H, W, C]` sums over all exposures of w x / t and of w.

    Returns:
        None where no pixel is usable in two exposures of different length.
    """
    merged = weighted_mean(total, weight)
    inside, left_out, weights = [], [], []
    for photo, t, use in zip(photos, times, usable, strict=True):
        own = exposure_weight(photo, t, use, noise, merged)
        others = weight - own
        signal = merged * t
        deviation = np.sqrt(np.maximum(noise.variance(signal, photo.rounding), 1e-12))
        seen = (own > 0) & (others > 1e-3 * weight) & (signal > DETECTION * deviation)
        if not seen.any():
            continue
        x, m, rest, w_rest, own_w, s = evenly_picked(
            photo.linear[seen],
            signal[seen],
            total[seen],
            others[seen],
            own[seen],
            deviation[seen],
        )
        without = (rest - own_w * x / t) / w_rest * t
        inside.append(np.abs(x / m - 1))
        left_out.append(np.abs(x / np.where(without > 0, without, np.nan) - 1))
        weights.append((m / s) ** 2)
    if not inside or len(set(times)) < 2:
        return None
    a, b, w = (np.concatenate(part) for part in (inside, left_out, weights))
    b = np.nan_to_num(b, nan=1.0)
    return Linearity(
        float(np.median(a)),
        weighted_quantile(a, w, 0.95),
        float(np.median(b)),
        weighted_quantile(b, w, 0.95),
        len(a),
    )
