"""Fit S and n of the diffuse formula to the low envelope of a measurement.

The loss is the pinball loss at a low quantile (Koenker and Bassett 1978, regression quantiles): a
reading far above the curve pulls no harder than one just above it, so that the mirror ridge cannot
lift the fit, and the curve settles where `ENVELOPE` of the readings lie below it. For a given n the
best S is a weighted quantile of the ratios reading / basis: exact, without iteration. What remains
is a search over n alone. Readings within `RIDGE_DEG` of the mirror direction are left out all the
same, since the paper fits the diffuse part without them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from raden_torch.arrays import Floats
from raden_torch.errors import InputError

ENVELOPE = 0.05
RIDGE_DEG = 20.0
EXPONENT_BOUNDS = (0.5, 50.0)
"""Below 0.5 the formula jumps at a = 0 and ruins the interpolation of the residual beside it."""
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class DiffuseParameters:
    """S (1/sr) and n of eqs (3)–(6), one per channel.

    Hand-set exponents may lie outside the fit's bounds, as long as they are positive.
    """

    scale: tuple[float, float, float]
    exponent: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("scale", "exponent"):
            values = getattr(self, name)
            if len(values) != 3 or not np.isfinite(values).all() or min(values) < 0:
                raise InputError(
                    f"diffuse {name}: expected three finite numbers >= 0, got {values}"
                )
        if min(self.exponent) <= 0:
            raise InputError(f"diffuse exponent: expected above 0, got {self.exponent}")


def fit_diffuse(angles: tuple[Floats, Floats, Floats], f_r: Floats) -> DiffuseParameters:
    """The low envelope of readings.

    Args:
        angles: incidence, receiving, tilt, `[M]` each, in radians.
        f_r: `[M, 3]` in 1/sr.

    Returns:
        S ≥ 0 and n within `EXPONENT_BOUNDS`; S = 0 where nothing but the ridge was measured, or
        where the envelope is not positive.
    """
    a, r, t = angles
    use = (a > 0) & (angle_from_mirror(a, r, t) > np.deg2rad(RIDGE_DEG))
    if not use.any():
        return DiffuseParameters((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    angular, x = np.cos(t[use]) * np.cos(r[use]), 2 * np.sin(a[use] / 2) ** 2
    fitted = [_fit_channel(angular, x, f_r[use, c]) for c in range(3)]
    s, n = zip(*fitted, strict=True)
    return DiffuseParameters(s, n)


def angle_from_mirror(a: Floats, r: Floats, t: Floats) -> Floats:
    """The angle between the viewer and the mirror direction of the light, in radians."""
    cosine = np.sin(a) * np.sin(r) + np.cos(a) * np.cos(r) * np.cos(2 * t)
    cosine = np.clip(cosine, -1, 1)
    return np.asarray(2 * np.arctan2(np.sqrt(1 - cosine), np.sqrt(1 + cosine)))


def _fit_channel(angular: Floats, x: Floats, y: Floats) -> tuple[float, float]:
    def best_scale(log_n: float) -> tuple[float, float]:
        basis = angular * x ** np.exp(log_n)
        counts = basis > _NEGLIGIBLE * basis.max()  # the rest weighs nothing, and would overflow
        ratio = y[counts] / basis[counts]
        scale = max(_weighted_quantile(ratio, basis[counts], ENVELOPE), 0.0)
        above = y - scale * basis
        return scale, float(np.mean(np.maximum(ENVELOPE * above, (ENVELOPE - 1) * above)))

    low, high = np.log(EXPONENT_BOUNDS)
    coarse = np.linspace(low, high, 24)
    i = int(np.argmin([best_scale(log_n)[1] for log_n in coarse]))
    bracket = (coarse[max(i - 1, 0)], coarse[min(i + 1, len(coarse) - 1)])
    found = minimize_scalar(
        lambda log_n: best_scale(log_n)[1],
        bounds=bracket,
        method="bounded",
        options={"xatol": 1e-4},
    ).x
    log_n = min((found, *bracket), key=lambda candidate: best_scale(candidate)[1])
    return best_scale(log_n)[0], float(np.exp(log_n))


def _weighted_quantile(values: Floats, weights: Floats, q: float) -> float:
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, q * below[-1])])
