"""The hemisphere from few readings anywhere in it: kriging under declared symmetries.

In s = (a + r)/2, u = (r − a)/2 and t every symmetry turns signs: the two names of one geometry
(a, r, t) ≡ (−a, −r, −t) those of all three; isotropy that of t; reciprocity (a, r, t) ↔ (r, a, −t)
those of u and t. log(`FLOOR` + f) is taken for a sample of a Gaussian process whose covariance is
the sum of a Matérn covariance of order 5/2 (Rasmussen & Williams, "Gaussian Processes for Machine
Learning", eq. (4.17)) over the images of one of the two geometries (their section 4.2.4: a sum over
a group makes every sample invariant), with an unknown mean (ordinary kriging). A highlight is
narrow and the rest is not, so (u, t) is counted along asinh from the mirror direction. One process
spans the hemisphere, and its lengths are those that make the readings most likely; its standard
deviation says how much is known of a geometry that nobody read.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.errors import InputError
from raden_torch.reflectance.grid import distinct
from raden_torch.reflectance.kriging import s_u_t
from raden_torch.reflectance.log_readings import LUMINANCE, LogReadings

ISOTROPIC, RECIPROCAL = "isotropic", "isotropic+reciprocal"
ASSUMPTIONS = (ISOTROPIC, RECIPROCAL)
"""What may be declared of a sample."""
FEWEST, MOST = 6, 2500
"""Readings: fewer tell nothing; of more, those beside another are left out."""

_ALL = tuple(np.array(signs) for signs in itertools.product((1.0, -1.0), repeat=3))
_IMAGES = {
    None: tuple(s for s in _ALL if len(set(s)) == 1),
    ISOTROPIC: tuple(s for s in _ALL if s[0] == s[1]),
    RECIPROCAL: _ALL,
}
"""Signs of (s, u, t) under which a reflectance stays the same."""
_DOUBT = 0.5  # of the logarithms of the usual lengths: one standard deviation
_BOUNDS = ((2.0, 5.7), (1.0, 5.0), (1.0, 5.0), (0.7, 5.0), (-12.0, 0.0))
_LEARNT_FROM = 300  # readings: enough for five numbers
_NUGGET = 1e-8
_AT_ONCE = 500  # queries
_THINNED_FROM_DEG, _GROWING = 1.0, 1.1


@dataclass(frozen=True)
class Lengths:
    """Of the covariance, over the process' variance where they are no lengths; as given here, those
    that simulated shells have.

    Attributes:
        along: `[3]` of s, and of u and t beside the mirror direction, degrees.
        narrow_deg: how far off the mirror direction (u, t) is counted whole.
        noise: variance that no reading states.
    """

    along: tuple[float, float, float] = (50.0, 16.0, 16.0)
    narrow_deg: float = 15.0
    noise: float = 1e-4

    def __call__(self, first: Floats, second: Floats, assume: str | None) -> Floats:
        """`[M, N]` covariance of angles `[M, 3]` and `[N, 3]` in degrees."""
        one, other = self._places(first), self._places(second)
        square = (one**2).sum(axis=1)[:, None] + (other**2).sum(axis=1)
        total = np.zeros_like(square)
        for signs in _IMAGES[assume]:
            total += _matern(np.maximum(square - 2 * one @ (other * signs).T, 0))
        return total

    def variance(self, angles_deg: Floats, assume: str | None) -> Floats:
        """`[M]` of the process itself."""
        places = self._places(angles_deg)
        apart = [(places * (1 - signs)) ** 2 for signs in _IMAGES[assume]]
        return np.asarray(sum(_matern(square.sum(axis=1)) for square in apart), np.float64)

    def _places(self, angles_deg: Floats) -> Floats:
        s, u, t = s_u_t(angles_deg).T
        off = np.hypot(u, t)
        shorter = self.narrow_deg * np.arcsinh(off / self.narrow_deg) / np.maximum(off, 1e-9)
        return np.stack([s, u * shorter, t * shorter], axis=1) / self.along


@dataclass(frozen=True, eq=False)
class SymmetricKriging:
    """A function of the angles through readings.

    Attributes:
        assume: None, or one of `ASSUMPTIONS`.
        lengths: of the process.
        angles_deg: `[M, 3]` of the readings.
        variance: of the process, of the logarithm of Y.
    """

    assume: str | None
    lengths: Lengths
    angles_deg: Floats
    variance: float
    _factor: Floats
    _mean: Floats
    _dual: Floats
    _ones: Floats

    @classmethod
    def of(
        cls, readings: LogReadings, assume: str | None, lengths: Lengths | None = None
    ) -> SymmetricKriging:
        """Through readings of distinct geometries.

        Args:
            lengths: None: those that make the readings most likely.

        Raises:
            InputError: fewer than `FEWEST` readings.
        """
        from scipy.linalg import solve_triangular

        if len(readings.logs) < FEWEST:
            raise InputError(
                f"measurement: expected at least {FEWEST} readings at different angles, got "
                f"{len(readings.logs)}"
            )
        thinned = _thinned(readings)
        lengths = lengths or likely_lengths(thinned, assume)
        factor = _factor(thinned, lengths, assume)
        logs = solve_triangular(factor, thinned.logs, lower=True)
        ones = solve_triangular(factor, np.ones(len(thinned.logs)), lower=True)
        mean = ones @ logs / (ones @ ones)
        left = logs - ones[:, None] * mean
        variance = float((left[:, LUMINANCE] ** 2).mean())
        dual = solve_triangular(factor.T, left, lower=False)
        return cls(assume, lengths, thinned.angles_deg, variance, factor, mean, dual, ones)

    def __call__(self, angles_deg: Floats) -> Floats:
        """`[N, 3]` → logarithms `[N, C]`."""
        parts = [self._mean + shared @ self._dual for _, shared in self._shared(angles_deg)]
        return np.concatenate(parts)

    def std(self, angles_deg: Floats) -> Floats:
        """`[N]`: the expected standard deviation of the logarithm of Y."""
        from scipy.linalg import solve_triangular

        found = []
        for part, shared in self._shared(angles_deg):
            known = solve_triangular(self._factor, shared.T, lower=True)
            missing = 1 - self._ones @ known
            own = self.lengths.variance(part, self.assume) - (known**2).sum(axis=0)
            found.append(own + missing**2 / (self._ones @ self._ones))
        return np.sqrt(self.variance * np.maximum(np.concatenate(found), 0))

    def _shared(self, angles_deg: Floats) -> Iterator[tuple[Floats, Floats]]:
        for start in range(0, len(angles_deg), _AT_ONCE):
            part = angles_deg[start : start + _AT_ONCE]
            yield part, self.lengths(part, self.angles_deg, self.assume)


def likely_lengths(readings: LogReadings, assume: str | None) -> Lengths:
    """The lengths that make the readings most likely, near those that shells have."""
    from scipy.optimize import minimize

    some = _some(readings)

    usual = Lengths()
    typical = np.log([*usual.along, usual.narrow_deg])

    def unlikely(logs: Floats) -> float:
        away = (logs[:4] - typical) / _DOUBT
        return _minus_log_likelihood(some, _lengths(logs), assume) + 0.5 * float(away @ away)

    start = np.append(typical, np.log(usual.noise))
    found = minimize(
        unlikely, start, method="L-BFGS-B", bounds=_BOUNDS, options={"maxiter": 20, "ftol": 1e-4}
    )
    return _lengths(found.x)


def symmetric_images(angles_deg: Floats, assume: str | None) -> Floats:
    """`[N, 3]`: every name of geometries `[M, 3]` under the declared symmetries."""
    places = s_u_t(angles_deg)
    s, u, t = np.concatenate([places * signs for signs in _IMAGES[assume]]).T
    return np.stack([s - u, s + u, t], axis=1)


def _lengths(logs: Floats) -> Lengths:
    s, u, t, narrow, noise = np.exp(logs).tolist()
    return Lengths((s, u, t), narrow, noise)


def _minus_log_likelihood(readings: LogReadings, lengths: Lengths, assume: str | None) -> float:
    """Of the logarithm of Y, the variance being the likeliest one (their eq. (2.30))."""
    from scipy.linalg import LinAlgError, solve_triangular

    try:
        factor = _factor(readings, lengths, assume)
    except LinAlgError:
        return 1e9
    logs = readings.logs[:, LUMINANCE]
    white = solve_triangular(factor, np.stack([logs, np.ones_like(logs)], 1), lower=True)
    left = white[:, 0] - white[:, 1] * (white[:, 0] @ white[:, 1]) / (white[:, 1] @ white[:, 1])
    variance = max(float((left**2).mean()), 1e-12)
    return 0.5 * len(logs) * float(np.log(variance)) + float(np.log(np.diag(factor)).sum())


def _factor(readings: LogReadings, lengths: Lengths, assume: str | None) -> Floats:
    """`[M, M]`, the Cholesky factor of the readings' covariance."""
    from scipy.linalg import cholesky

    covariance = lengths(readings.angles_deg, readings.angles_deg, assume)
    own = readings.noise + lengths.noise + _NUGGET
    covariance[np.diag_indices(len(own))] += own
    return np.asarray(cholesky(covariance, lower=True, overwrite_a=True))


def _thinned(readings: LogReadings) -> LogReadings:
    """At most `MOST`: of those that lie within a small cube of angles the surest one."""
    side = _THINNED_FROM_DEG
    while len(readings.logs) > MOST:
        _, index = distinct(np.floor(readings.angles_deg / side))
        surest = np.lexsort((readings.noise, index))
        first = np.flatnonzero(np.diff(index[surest], prepend=-1))
        readings = _rows(readings, surest[first])
        side *= _GROWING
    return readings


def _some(readings: LogReadings) -> LogReadings:
    """`_LEARNT_FROM` of them at most, at random."""
    return _rows(readings, np.random.default_rng(0).permutation(len(readings.logs))[:_LEARNT_FROM])


def _rows(readings: LogReadings, rows: Ints) -> LogReadings:
    return replace(
        readings,
        angles_deg=readings.angles_deg[rows],
        logs=readings.logs[rows],
        noise=readings.noise[rows],
    )


def _matern(square: Floats) -> Floats:
    """Matérn covariance of order 5/2 and variance 1, of squared distances."""
    q = np.sqrt(5 * square)
    return np.asarray((1 + q + q**2 / 3) * np.exp(-q))
