"""The shape of the highlights: an analytic model of the lobes, fitted to a measured grid.

On a coarse grid a narrow highlight is seen by one or two nodes per plane, but by many nodes
together along the mirror ridge. So its shape is fitted to all of them, and only what the shape
leaves over is interpolated. The logarithm of the reflectance is modelled as

    log(e^base + Σᵢ exp(Aᵢ(s) − k(s) ρ(((u − uᵢ)² + κ(s) (t − tᵢ)²) / c(s)², b(s))))

with u = (r − a)/2 and t the half vector's angles, s = (a + r)/2 the incidence on the facet, and ρ
Barron's (2019) family of profiles, which runs from a Gaussian (b = 2) over an exponential cusp (1)
to GGX-like tails (0). Amplitudes A have a knot per measured incidence; the shape k, c, b, κ four.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from raden_torch.arrays import Floats, Ints
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.lobe_formula import hats_of, log_sum, log_sum_slopes

SHAPE_KNOTS_DEG = np.array([0.0, 35.0, 55.0, 70.0])
MOST_LOBES = 3

_PRIORS = ((1.0, 0.3), (0.3, 1.0), (0.2, 3.0), (0.2, 30.0))
"""Peak radius c in degrees, and how strongly it is held: from round peaks to cusps."""
_TOLERANCE = 2.0  # the sharpest prior whose misfit is within this of the best is taken
_OFF_NODE = 0.15  # of a step: how far from a node a cusp may stand; nothing would contradict it
_WORST_MISFIT = 0.03  # RMS of the logarithm near the lobes; above it there are no lobes
_WINDOW, _REACH = 4.0, 16.0  # degrees from a lobe's centre: where weight has halved, and ends
_HUBER, _HOLD = 0.03, 0.05  # outliers of the logarithm; the strength of all priors
_PROFILES = (0.5, 1.7)  # values of b to start from
_VALLEY = 0.1  # of the logarithm: two maxima with less between them are one lobe
_PROMINENT = 0.35  # of the range: how high a maximum must be


@dataclass(frozen=True)
class Lobes:
    """A fitted model of the highlights.

    Attributes:
        knots_deg: incidences of the amplitude knots, `[n]`.
        amplitude: `[K, n]`, the logarithm of each lobe's peak.
        shape: `[4, m]`: log k, log c, b and log κ at `SHAPE_KNOTS_DEG`.
        centre_deg: `[K, 2]`: (u, t) of each lobe.
        base: the logarithm of the floor.
        misfit: RMS of the logarithm near the lobes.
    """

    knots_deg: Floats
    amplitude: Floats
    shape: Floats
    centre_deg: Floats
    base: float
    misfit: float

    def __call__(self, incidence: Floats, receiving: Floats, tilt: Floats) -> Floats:
        """The logarithm of the reflectance at angles in degrees."""
        s, u = (incidence + receiving) / 2, (receiving - incidence) / 2
        hats = hats_of(abs(s), self.knots_deg), hats_of(abs(s), SHAPE_KNOTS_DEG)
        return log_sum(self.amplitude, self.shape, self.centre_deg, self.base, s, u, tilt, *hats)


def fit_lobes(grid: AngleGrid, logs: Floats) -> Lobes | None:
    """Fit lobes to the logarithm of a grid.

    Args:
        grid: evenly spaced, with equal steps of incidence and receiving.
        logs: `[A, R, T]`.

    Returns:
        None where no lobe describes the grid.
    """
    centres = _find_centres(grid, logs)
    # many small solves: BLAS threads would only wait for each other
    with threadpool_limits(limits=1, user_api="blas"):
        fits = [_Problem(grid, logs, centres, prior).solve() for prior in _PRIORS]
    best = min(fit.misfit for fit in fits)
    step = float(grid.step[0])
    believable = [
        fit
        for i, fit in enumerate(fits)
        if i == 0
        or (fit.misfit <= _TOLERANCE * best and (i == 1 or _off_node(fit, step) < _OFF_NODE))
    ]
    chosen = believable[-1]
    return chosen if chosen.misfit < _WORST_MISFIT else None


def _off_node(lobes: Lobes, step: float) -> float:
    """How far the lobes' centres lie from nodes, in steps (half a step along u)."""
    x = lobes.centre_deg / [step / 2, step]
    return float(abs(x - np.rint(x)).max())


class _Problem:
    """The least-squares problem of one prior."""

    def __init__(
        self, grid: AngleGrid, logs: Floats, centres: Floats, prior: tuple[float, float]
    ) -> None:
        self.axes, self.centres = grid, centres
        a, r, t = np.moveaxis(grid.nodes_deg(), -1, 0)
        s, u, step = (a + r) / 2, (r - a) / 2, float(grid.step[0])
        distance = np.min([np.hypot(u - c[0], t - c[1]) for c in centres], axis=0)
        near = (distance <= _REACH * step / 5) & (s >= 0)
        self.s, self.u, self.t, self.goal = s[near], u[near], t[near], logs[near]
        self.weight = 1 / (1 + (distance[near] / (_WINDOW * step / 5)) ** 2)
        self.hats = hats_of(self.s, grid.incidence_deg), hats_of(self.s, SHAPE_KNOTS_DEG)
        self.low = float(np.quantile(logs, 0.1))
        self.step = step
        m = len(SHAPE_KNOTS_DEG)
        self.shape_prior = np.repeat([[0.0], [np.log(prior[0])], [0.5], [0.0]], m, axis=1)
        self.shape_hold = np.repeat([[0.3], [prior[1]], [1.0], [1.0]], m, axis=1)
        self.prior_slopes = self._prior_slopes()

    def solve(self) -> Lobes:
        fits = [
            least_squares(
                self._residual,
                self._start(profile),
                jac=self._jacobian,
                bounds=self._bounds(),
                loss="soft_l1",
                f_scale=_HUBER,
                max_nfev=80,
                x_scale="jac",
            )
            for profile in _PROFILES
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        amplitude, shape, centres, base = self._split(best.x)
        misfit = float(np.sqrt(np.mean(self._residual(best.x)[: len(self.s)] ** 2)))
        return Lobes(self.axes[0], amplitude, shape, centres, base, misfit)

    def _split(self, p: Floats) -> tuple[Floats, Floats, Floats, float]:
        k, n, m = len(self.centres), len(self.axes[0]), len(SHAPE_KNOTS_DEG)
        amplitude, shape, centres, base = np.split(p, np.cumsum([k * n, 4 * m, 2 * k]))
        return amplitude.reshape(k, n), shape.reshape(4, m), centres.reshape(k, 2), float(base[0])

    def _residual(self, p: Floats) -> Floats:
        amplitude, shape, centres, base = self._split(p)
        model = log_sum(amplitude, shape, centres, base, self.s, self.u, self.t, *self.hats)
        return np.concatenate([self.weight * (model - self.goal), self._prior_residual(p)])

    def _prior_residual(self, p: Floats) -> Floats:
        """Linear in the parameters."""
        amplitude, shape, centres, base = self._split(p)
        return np.concatenate(
            [
                _HOLD * (self.shape_hold * (shape - self.shape_prior)).ravel(),
                2 * _HOLD * np.diff(shape, axis=1).ravel(),
                _HOLD * np.diff(amplitude, 2, axis=1).ravel(),
                _HOLD * (centres - self.centres).ravel(),
                [0.05 * _HOLD * (base - self.low)],
            ]
        )

    def _prior_slopes(self) -> Floats:
        k, n, m = len(self.centres), len(self.axes[0]), len(SHAPE_KNOTS_DEG)
        one = np.eye(k * n + 4 * m + 2 * k + 1)
        zero = self._prior_residual(np.zeros(len(one)))
        return np.stack([self._prior_residual(p) - zero for p in one], axis=1)

    def _jacobian(self, p: Floats) -> Floats:
        """`[residuals, parameters]`: the derivative of `_residual`."""
        slopes = log_sum_slopes(*self._split(p), self.s, self.u, self.t, *self.hats)
        return np.concatenate([self.weight[:, None] * slopes, self.prior_slopes])

    def _start(self, profile: float) -> Floats:
        half = 0.52 * self.step
        amplitude = [
            self.goal[
                (np.hypot(self.u - c[0], self.t - c[1]) <= half) & (abs(self.s - knot) <= half)
            ].max(initial=self.low)
            for c in self.centres
            for knot in self.axes[0]
        ]
        shape = np.repeat([0.0, np.log(2.0), profile, 0.0], len(SHAPE_KNOTS_DEG))
        return np.concatenate([amplitude, shape, self.centres.ravel(), [self.low - 1]])

    def _bounds(self) -> tuple[Floats, Floats]:
        m, amplitudes = len(SHAPE_KNOTS_DEG), len(self.centres) * len(self.axes[0])
        drift = np.tile([2.5, 3.0], len(self.centres))
        low = np.repeat([-7.0, np.log(0.15), -6.0, -4.0], m)
        high = np.repeat([7.0, np.log(30.0), 2.0, 4.0], m)
        centre = self.centres.ravel()
        return (
            np.concatenate([np.full(amplitudes, -30.0), low, centre - drift, [self.low - 12]]),
            np.concatenate([np.full(amplitudes, 30.0), high, centre + drift, [self.low + 3]]),
        )


def _find_centres(grid: AngleGrid, logs: Floats) -> Floats:
    """`[K, 2]`: (u, t) of the maxima of the grid averaged along the ridge."""
    incidence, receiving, tilt = grid
    step = grid.step[0]
    reach = int(50 // step)
    shift = np.rint((incidence[:, None] - receiving[0]) / step).astype(int)
    j = shift + np.arange(-reach, reach + 1)  # [A, 2·reach + 1], receiving at constant r − a
    there = (j >= 0) & (j < len(receiving))
    rows = logs[np.arange(len(incidence))[:, None], np.clip(j, 0, len(receiving) - 1)]
    counts = there.sum(axis=0)
    ridge = np.where(there[..., None], rows, 0).sum(axis=0) / np.maximum(counts, 1)[:, None]
    ridge[counts == 0] = ridge.min()
    kept: list[list[tuple[int, int]]] = []
    for cell in _maxima(ridge):
        for group in kept:
            if _along(ridge, cell, group[0]).min() > ridge[cell] - _VALLEY:
                group.append(cell)
                break
        else:
            kept.append([cell])
    centres = [np.mean(group, axis=0) for group in kept[:MOST_LOBES]] or [
        np.array([reach, len(tilt) // 2])
    ]
    return np.array(
        [((c[0] - reach) * step / 2, tilt[0] + (tilt[1] - tilt[0]) * c[1]) for c in centres]
    )


def _maxima(ridge: Floats) -> list[tuple[int, int]]:
    """Prominent local maxima, the highest first."""
    from scipy.ndimage import maximum_filter

    low, top = np.quantile(ridge, 0.1), ridge.max()
    peak = (ridge >= maximum_filter(ridge, 3)) & (ridge > low + _PROMINENT * (top - low))
    peak[[0, -1]] = peak[:, [0, -1]] = False
    cells: Ints = np.argwhere(peak)
    order = np.argsort(-ridge[peak], kind="stable")
    return [(int(j), int(k)) for j, k in cells[order]]


def _along(ridge: Floats, a: tuple[int, int], b: tuple[int, int]) -> Floats:
    """The values on the straight line between two cells."""
    n = max(abs(a[0] - b[0]), abs(a[1] - b[1])) + 1
    j, k = (np.rint(np.linspace(a[i], b[i], n)).astype(int) for i in (0, 1))
    return ridge[j, k]
