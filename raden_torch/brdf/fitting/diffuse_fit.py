"""Fit S and n of the diffuse formula to the floor or to the surface of a measurement.

The paper fits by hand. Over the tilt the curve follows the low values, below the mirror ridge
(fig. 6); over receiving angle and incidence, at a tilt of 55°, where no ridge is, it follows the
measured surface (figs 7 and 8). Here both have one loss, the pinball loss at a quantile (Koenker
and Bassett 1978, regression quantiles): the curve settles where that share of the readings lies
below it, and a reading far above it pulls no harder than one just above it. The surface is the
median: least absolute deviations. For a given n the best S is a weighted quantile of the ratios
reading / basis: exact, without iteration. What remains is a search over n alone.

Left out of both are the readings within `RIDGE_DEG` of the mirror direction, which are the
highlight, and those at incidence 0, where the formula is 0 whatever its parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from raden_torch.arrays import Floats, weighted_quantile
from raden_torch.errors import InputError

RIDGE_DEG = 20.0
_LEAST_READINGS = 10
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class DiffuseFit:
    """What a fit follows: the quantile of the readings, and the bounds of n.

    Near incidence 0 the formula rises steeply where n < 0.5. With both gains at 1 that changes
    nothing in the measured box; with others it draws a dark line there. From 70 degrees to 90 it
    grows eightfold with n = 5; where half of the readings are black, the median alone would allow
    any growth.
    """

    quantile: float
    exponent_bounds: tuple[float, float]


FITS = {"floor": DiffuseFit(0.05, (0.5, 50.0)), "surface": DiffuseFit(0.5, (0.1, 5.0))}


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


def fit_diffuse(
    angles: tuple[Floats, Floats, Floats], f_r: Floats, to: str = "floor"
) -> DiffuseParameters:
    """S and n of readings.

    Args:
        angles: incidence, receiving, tilt, `[M]` each, in radians.
        f_r: `[M, 3]` in 1/sr.
        to: a key of `FITS`.

    Returns:
        S ≥ 0 and n within its bounds; S = 0 where the quantile is not positive. "floor": S = 0
        also where nothing but the ridge was measured.

    Raises:
        InputError: "surface" of fewer than ten readings off the highlight, or of one incidence.
    """
    a, r, t = angles
    use = (a > 0) & (angle_from_mirror(a, r, t) > np.deg2rad(RIDGE_DEG))
    if to == "surface":
        _check_surface(a[use])
    elif not use.any():
        return DiffuseParameters((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    angular, x = np.cos(t[use]) * np.cos(r[use]), 2 * np.sin(a[use] / 2) ** 2
    fitted = [_fit_channel(angular, x, f_r[use, c], FITS[to]) for c in range(3)]
    s, n = zip(*fitted, strict=True)
    return DiffuseParameters(s, n)


def _check_surface(incidence: Floats) -> None:
    """Raise InputError unless readings at these incidences determine S and n."""
    incidences = len(np.unique(np.round(incidence, 6)))
    if len(incidence) < _LEAST_READINGS or incidences < 2:
        raise InputError(
            f"diffuse: expected at least {_LEAST_READINGS} readings over {RIDGE_DEG:g} deg off the "
            "mirror direction, at two incidences above 0, to fit the surface to, got "
            f'{len(incidence)} at {incidences}; measure more, or use `diffuse="floor"`'
        )


def angle_from_mirror(a: Floats, r: Floats, t: Floats) -> Floats:
    """The angle between the viewer and the mirror direction of the light, in radians."""
    cosine = np.sin(a) * np.sin(r) + np.cos(a) * np.cos(r) * np.cos(2 * t)
    cosine = np.clip(cosine, -1, 1)
    return np.asarray(2 * np.arctan2(np.sqrt(1 - cosine), np.sqrt(1 + cosine)))


def _fit_channel(angular: Floats, x: Floats, y: Floats, to: DiffuseFit) -> tuple[float, float]:
    q = to.quantile

    def best_scale(log_n: float) -> tuple[float, float]:
        basis = angular * x ** np.exp(log_n)
        counts = basis > _NEGLIGIBLE * basis.max()  # the rest weighs nothing, and would overflow
        ratio = y[counts] / basis[counts]
        scale = max(weighted_quantile(ratio, basis[counts], q), 0.0)
        above = y - scale * basis
        return scale, float(np.mean(np.maximum(q * above, (q - 1) * above)))

    low, high = np.log(to.exponent_bounds)
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
