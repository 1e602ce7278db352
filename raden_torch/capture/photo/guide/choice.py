"""Which stances tell most: the hemisphere's expected error, photograph by photograph.

What readings tell of a geometry that nobody read is the standard deviation of the process in
`reflectance.symmetric_kriging`, which depends on the readings' angles alone where its lengths and
variance are given. The stance whose readings lower its mean over the hemisphere most is taken, then
the next (greedy). Stances are ranked by a few geometries that stand for them; the best are tried
with more of their readings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.reflectance.symmetric_kriging import Lengths

HEMISPHERE_DEG = 80.0
_QUERIES, _TRIED, _SHOWN = 500, 16, 8
"""Pairs of directions; stances tried with all readings; geometries that stand for a stance."""
_THINNED = 24
"""Readings of a photograph, at most."""
_NOISE = 1e-3
"""Of a reading, over the process' variance: a shell is not even, nor is a lamp's place known."""


def hemisphere_deg(count: int = _QUERIES, seed: int = 0) -> Floats:
    """`[count, 3]` geometries of random directions to light and view, uniform by solid angle within
    80 degrees of the normal."""
    random = np.random.default_rng(seed)
    ways = []
    for _ in range(2):
        z = random.uniform(np.cos(np.radians(HEMISPHERE_DEG)), 1, count)
        turn, flat = random.uniform(0, 2 * np.pi, count), np.sqrt(1 - z * z)
        ways.append(np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1))
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), ways[0].shape)
    return angles_deg(normal, *ways).astype(np.float64)


class Knowledge:
    """What is known of geometries that were not read.

    The columns of L⁻¹ K(readings, geometries), L the readings' Cholesky factor, grow by rows with
    each photograph; the variance that is left is what their squares leave.

    Args:
        shown: `[N, 3]` geometries that may be read, each a column of `shared`.
        most: readings that may be added, in all.
    """

    def __init__(
        self, lengths: Lengths, assume: str | None, queries: Floats, shown: Floats, most: int
    ) -> None:
        self._lengths, self._assume = lengths, assume
        self._places = np.concatenate([queries, shown])
        self._count = len(queries)
        self._size = 0
        self._all_read = np.zeros((most, 3))
        self._all_rows = np.zeros((most, len(self._places)))
        self._whole_factor = np.zeros((most, most))
        self.left = lengths.variance(self._places, assume)
        self.shared = lengths(queries, shown, assume)

    @property
    def std(self) -> Floats:
        """`[Q]` of the queries, over the process' own."""
        return np.sqrt(np.maximum(self.left[: self._count], 0))

    def add(self, angles: Floats) -> None:
        """Readings `[P, 3]`."""
        new, own = self._columns(angles)
        rows = self._told(angles, new, own, len(self._places))
        self.left = self.left - (rows**2).sum(axis=0)
        self.shared = self.shared - rows[:, : self._count].T @ rows[:, self._count :]
        before, after = self._size, self._size + len(angles)
        self._all_rows[before:after] = rows
        self._all_read[before:after] = angles
        self._whole_factor[before:after, :before] = new.T
        self._whole_factor[before:after, before:after] = own
        self._size = after

    def gain(self, angles: Floats) -> float:
        """By how much the queries' mean standard deviation would fall with readings `[P, 3]`."""
        rows = self._told(angles, *self._columns(angles), self._count)
        after = self.left[: self._count] - (rows**2).sum(axis=0)
        return float((self.std - np.sqrt(np.maximum(after, 0))).mean())

    def gains(self) -> Floats:
        """`[N]` the same of each geometry that may be read, alone."""
        before = np.maximum(self.left[: self._count], 0)[:, None]
        fall = self.shared**2 / np.maximum(self.left[self._count :] + _NOISE, _NOISE)
        return np.asarray((np.sqrt(before) - np.sqrt(np.maximum(before - fall, 0))).mean(axis=0))

    def _columns(self, angles: Floats) -> tuple[Floats, Floats]:
        """L⁻¹ K(readings, angles), and the Cholesky factor of what these leave of the angles."""
        from scipy.linalg import solve_triangular

        inner = self._lengths(angles, angles, self._assume) + _NOISE * np.eye(len(angles))
        if not self._size:
            return np.zeros((0, len(angles))), np.asarray(np.linalg.cholesky(inner), np.float64)
        read, factor = self._all_read[: self._size], self._whole_factor[: self._size, : self._size]
        new = solve_triangular(factor, self._lengths(read, angles, self._assume), lower=True)
        return new, np.asarray(np.linalg.cholesky(inner - new.T @ new), np.float64)

    def _told(self, angles: Floats, new: Floats, own: Floats, places: int) -> Floats:
        """The rows that readings add, at the first of the places; `new` and `own` of `_columns`."""
        between = self._lengths(angles, self._places[:places], self._assume)
        known = new.T @ self._all_rows[: self._size, :places]
        return np.asarray(np.linalg.solve(own, between - known), np.float64)


def most_telling(
    readings: Sequence[Floats],
    known: Floats,
    count: int,
    *,
    lengths: Lengths,
    assume: str | None,
    progress: Callable[[float], None] | None = None,
) -> tuple[list[int], Floats]:
    """The stances to take, the most telling first.

    Args:
        readings: `[K, 3]` of each stance that is possible; K may be 0.
        known: `[M, 3]` what was read already.
        count: of stances.

    Returns:
        Their numbers, fewer than `count` where no more tell anything; and `[1 + that many]` the
        standard deviation, median over the hemisphere, over the process' own: before, and after
        each.
    """
    useful = np.array([k for k, angles in enumerate(readings) if len(angles)], np.intp)
    shown, owner = _shown([readings[k] for k in useful])
    most = len(known) + _THINNED * min(count, len(useful))
    state = Knowledge(lengths, assume, hemisphere_deg(), shown, most)
    if len(known):
        state.add(known)
    chosen: list[int] = []
    left = [float(np.median(state.std))]
    for number in range(min(count, len(useful))):
        ranked = np.bincount(owner, state.gains(), len(useful))
        ranked[chosen] = -1
        tried = np.argsort(-ranked)[:_TRIED]
        gains = [state.gain(_thinned(readings[useful[k]])) for k in tried]
        best = int(tried[int(np.argmax(gains))])
        state.add(_thinned(readings[useful[best]]))
        chosen.append(best)
        left.append(float(np.median(state.std)))
        if progress is not None:
            progress((number + 1) / count)
    return [int(useful[k]) for k in chosen], np.array(left)


def _shown(readings: Sequence[Floats]) -> tuple[Floats, Ints]:
    """Geometries that stand for each stance, the middle one of few, and whose they are."""
    parts = [angles[len(angles) // 2 :][:1] if len(angles) < 40 else _spread(angles, _SHOWN)
             for angles in readings]  # fmt: skip
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return np.concatenate([*parts, np.zeros((0, 3))]), owner


def _thinned(angles: Floats) -> Floats:
    """Some of a photograph's readings: neighbours tell the same."""
    return _spread(angles, _THINNED)


def _spread(angles: Floats, count: int) -> Floats:
    return angles[np.unique(np.linspace(0, len(angles) - 1, min(count, len(angles))).astype(int))]
