"""Interpolation along one axis, between the third and fourth of six equidistant values."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from raden_torch.arrays import Floats

Kernel = Callable[[Sequence[Floats], Floats], Floats]

_FLAT = 1e-12


def linear(v: Sequence[Floats], f: Floats) -> Floats:
    """Straight between v[2] and v[3]; f is 0 at v[2], 1 at v[3]."""
    return v[2] * (1 - f) + v[3] * f


def akima(v: Sequence[Floats], f: Floats) -> Floats:
    """Akima's cubic (1970) with the modified weights that keep flat parts flat.

    It follows the shape of the data: a step or a peak does not ring over several nodes, as a spline
    does.
    """
    slopes = [v[i + 1] - v[i] for i in range(5)]
    before, after = _akima_slope(*slopes[:4]), _akima_slope(*slopes[1:])
    g = 1 - f
    ends = v[2] * (1 + 2 * f) * g * g + v[3] * f * f * (3 - 2 * f)
    return ends + f * g * (g * before - f * after)


def _akima_slope(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """The slope between b and c: their mean, each weighted by how calm the other side is."""
    for_c = abs(b - a) + abs(a + b) / 2
    for_b = abs(d - c) + abs(c + d) / 2
    total = for_b + for_c
    calm = total <= _FLAT
    return np.where(calm, 0.0, (for_b * b + for_c * c) / np.where(calm, 1.0, total))
