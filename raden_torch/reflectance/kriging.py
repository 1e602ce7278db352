"""A function of the angles through scattered readings: kriging among the nearest of them.

The readings are taken for a sample of a Gaussian process with the Matérn covariance of order 7/2
(Rasmussen & Williams, "Gaussian Processes for Machine Learning", eq. (4.16)) and an unknown mean
(ordinary kriging). A highlight keeps its shape along the mirror ridge, so distance is counted in
u = (r − a)/2, the tilt and, much more loosely, s = (a + r)/2. Readings near incidence 0 stand for
their equivalents (−a, −r, −t), too. All queries in one small block of angles share one
neighbourhood and its inverse covariance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints

NEIGHBOURS = 96
_UNIT_DEG = np.array([10.0, 5 / 1.4, 5.0])  # of s, u and t: one unit of distance
_RANGE = 5.0  # the covariance's, in these units
_MIRRORED_BELOW_DEG = 20.0  # of incidence: whose equivalents are neighbours
_BLOCK = 1.0  # the side of a block, in units
_NUGGET = 1e-6  # of the process' variance: keeps neighbours that almost touch apart
_AT_ONCE = 400  # blocks
_QUERIES_AT_ONCE = 4000


class Kriging:
    """The interpolant of readings.

    Args:
        angles_deg: `[M, 3]` incidence, receiving, tilt, `canonical`; no geometry twice.
        values: `[M, C]`.
        noise: `[M]` or one number: variance of the values over the process' own.
    """

    def __init__(self, angles_deg: Floats, values: Floats, noise: Floats | float = 0.0) -> None:
        from scipy.spatial import cKDTree

        near = (angles_deg[:, 0] < _MIRRORED_BELOW_DEG) & (abs(angles_deg) > 1e-9).any(axis=1)
        own = np.arange(len(angles_deg))
        self._reading = np.concatenate([own, own[near]])
        self._points = ridge_coordinates(np.concatenate([angles_deg, -angles_deg[near]]))
        self._values = np.asarray(values, np.float64)
        self._noise = np.broadcast_to(np.asarray(noise, np.float64), (len(own),)) + _NUGGET
        self._tree = cKDTree(self._points)
        self._k = min(NEIGHBOURS, len(self._points))

    def __call__(self, angles_deg: Floats) -> Floats:
        """`[N, 3]` → `[N, C]`."""
        found = np.empty((len(angles_deg), self._values.shape[1]))
        for part in self._blocks(ridge_coordinates(angles_deg)):
            found[part.query] = part.prediction()
        return found

    def with_std(self, angles_deg: Floats) -> tuple[Floats, Floats]:
        """`[N, C]` and its standard deviation over the process' own, `[N]`."""
        points = ridge_coordinates(angles_deg)
        found, variance = np.empty((len(points), self._values.shape[1])), np.empty(len(points))
        for part in self._blocks(points):
            found[part.query] = part.prediction()
            variance[part.query] = part.variance()
        return found, np.sqrt(np.maximum(variance, _NUGGET))

    def nearest(self, angles_deg: Floats, count: int) -> tuple[Floats, Ints]:
        """`[N]` the distance to the nearest reading, in units of the metric; and `[N, count]` which
        are the nearest ones."""
        count = min(count, len(self._points))
        far, near = self._tree.query(ridge_coordinates(angles_deg), count)
        shape = len(angles_deg), count
        return far.reshape(shape)[:, 0], self._reading[near.reshape(shape)]

    def leave_one_out(self, rows: Ints | None = None) -> tuple[Floats, Floats]:
        """What each reading would have been taken for without it, less what it is.

        Args:
            rows: which readings; all where None.

        Returns:
            `[N, C]` the errors and `[N]` their standard deviation over the process' own.
        """
        rows = np.arange(len(self._values)) if rows is None else rows
        error, std = np.empty((len(rows), self._values.shape[1])), np.empty(len(rows))
        for start in range(0, len(rows), _AT_ONCE):
            some = slice(start, start + _AT_ONCE)
            near = self._tree.query(self._points[rows[some]], self._k)[1].reshape(-1, self._k)
            part = self._solved(near)
            # Dubrule (1983): from the inverse alone; the reading is its own nearest neighbour
            own = part.inverse[:, 0, 0] - part.weight[:, 0] ** 2 / part.weight.sum(axis=1)
            error[some] = -part.dual[:, 0] / own[:, None]
            std[some] = 1 / np.sqrt(own)
        return error, std

    def _blocks(self, points: Floats) -> Iterator[_Part]:
        """The queries, a few blocks at a time."""
        lattice = np.floor(points / _BLOCK)
        corners, block = np.unique(lattice, axis=0, return_inverse=True)
        block = block.ravel()
        order = np.argsort(block, kind="stable")
        near = self._tree.query((corners + 0.5) * _BLOCK, self._k)[1].reshape(-1, self._k)
        for start in range(0, len(corners), _AT_ONCE):
            low, high = np.searchsorted(block[order], [start, start + _AT_ONCE])
            part = self._solved(near[start : start + _AT_ONCE])
            for first in range(low, high, _QUERIES_AT_ONCE):
                query = order[first : min(first + _QUERIES_AT_ONCE, high)]
                part.query, part.block = query, block[query] - start
                neighbours = self._points[near[block[query]]]
                offset = neighbours - points[query][:, None]
                part.covariance = _matern((offset**2).sum(axis=-1))
                yield part

    def _solved(self, near: Ints) -> _Part:
        """The inverse covariance of neighbourhoods `[B, k]`, and what follows from it."""
        points = self._points[near] - self._points[near[:, :1]]
        square = (points**2).sum(axis=-1)
        between = square[:, :, None] + square[:, None] - 2 * points @ points.swapaxes(1, 2)
        covariance = _matern(np.maximum(between, 0))
        diagonal = np.arange(self._k)
        covariance[:, diagonal, diagonal] = 1 + self._noise[self._reading[near]]
        inverse = np.asarray(np.linalg.inv(covariance), np.float64)
        values = self._values[self._reading[near]]
        weight: Floats = inverse.sum(axis=2)
        total = weight.sum(axis=1)
        mean = np.einsum("bk,bkc->bc", weight, values) / total[:, None]
        dual = inverse @ (values - mean[:, None])
        return _Part(inverse, weight, mean, dual)


@dataclass
class _Part:
    """Some neighbourhoods, and queries that belong to them."""

    inverse: Floats  # [B, k, k] of the covariance
    weight: Floats  # [B, k] its row sums
    mean: Floats  # [B, C]
    dual: Floats  # [B, k, C] inverse @ (values − mean)
    query: Ints = None  # type: ignore[assignment]  # [N] which queries
    block: Ints = None  # type: ignore[assignment]  # [N] in which neighbourhood
    covariance: Floats = None  # type: ignore[assignment]  # [N, k] with its readings

    def prediction(self) -> Floats:
        own = np.einsum("nk,nkc->nc", self.covariance, self.dual[self.block])
        return np.asarray(self.mean[self.block] + own)

    def variance(self) -> Floats:
        """Of the prediction: 1 − kᵀ K⁻¹ k, and what not knowing the mean adds."""
        known = (self.inverse[self.block] @ self.covariance[..., None])[..., 0]
        known = np.einsum("nk,nk->n", self.covariance, known)
        missing = 1 - np.einsum("nk,nk->n", self.covariance, self.weight[self.block])
        return np.asarray(1 - known + missing**2 / self.weight[self.block].sum(axis=1))


def s_u_t(angles_deg: Floats) -> Floats:
    """`[M, 3]` incidence, receiving and tilt → s = (a + r)/2, u = (r − a)/2 and t, in degrees."""
    a, r, t = np.asarray(angles_deg, np.float64).T
    return np.stack([(a + r) / 2, (r - a) / 2, t], axis=1)


def ridge_coordinates(angles_deg: Floats) -> Floats:
    """`[M, 3]`: s, u and t in units of the metric."""
    return s_u_t(angles_deg) / _UNIT_DEG


def _matern(square: Floats) -> Floats:
    """Matérn covariance of order 7/2 and variance 1, of squared distances."""
    q = np.sqrt(7 * square) / _RANGE
    return np.asarray((1 + q + 0.4 * q**2 + q**3 / 15) * np.exp(-q))
