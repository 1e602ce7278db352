"""Samples of a cell → the value at its node: a quadratic in the place within the cell, robustly.

The mean of a cell's samples is the value at their mean angles, and averages over the cell, which
lowers a ridge: for a Gaussian lobe of 5° deviation by 4 %. So a quadratic
y = b0 + b·(Δa, Δr, Δt) + … is fitted, with weights that fall with the distance from the node, and
b0 is the value of the node. Photographs cut a cell in sheets, which leave some slopes unknown: each
coefficient has a Gaussian prior around 0, as wide as the differences to the neighbouring cells, and
the posterior variance of b0 holds what that costs.

Robust: Tukey's bisquare from the median and the median absolute deviation (an M-estimate; places
in a cell are bounded, so that there are no leverage points), on at most a hundred samples chosen at
random from each cell; then every sample within `REJECT` scales of that fit counts alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Floats32, Ints
from raden_torch.capture.photo.brdf.photo_cells import TERMS, CellGrid, basis
from raden_torch.capture.photo.brdf.reservoir import Reservoir, rank_in_group

REJECT = 4.0
"""Scales (of a Gaussian) from the robust fit at which a sample is left out."""
NEAR = 0.3
"""Deviation of the weight's Gaussian around the node, in steps."""
FEWEST = 6
"""Samples without which a cell has no value."""

_BISQUARE = 6.0
"""Scales at which the bisquare's weight reaches 0."""
_ROUNDS = 8
_SLOPE, _BEND = 1.5, 1.0
"""Deviations of the priors, over the largest difference a step to the next cells."""
_FARTHEST = 6
"""Steps to the next cell, at most."""
_LEAST = 0.01
"""Of that difference, relative to the cell's own level."""
GRAIN = 1e-4
"""Least scatter of the samples, over the cell's level: no scale is 0 where there is no noise."""
_CLOSEST = 15
"""Samples nearest to the node, whose median is the robust fit's start."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """The first fit of each cell.

    Attributes:
        cell: `[T]` the cells that have samples enough.
        index: `[cells]` their row here, or −1.
        coefficients: `[T, 10, 3]`.
        scale: `[T, 3]` robust standard deviation of single samples around the fit.
        prior: `[T, 10]` deviation of each coefficient of the terms in s, u and Δt (`_turn`).
        rejected: share of the chosen samples that lie beyond `REJECT` scales.
    """

    cell: Ints
    index: Ints
    coefficients: Floats32
    scale: Floats
    prior: Floats
    rejected: float


def robust_fit(kept: Reservoir, grid: CellGrid) -> RobustFit:
    """Fit each cell of a reservoir."""
    rank = rank_in_group(kept.cell)
    counts = np.bincount(kept.cell, minlength=grid.cells)
    cells = np.flatnonzero(counts >= FEWEST)
    index = np.full(grid.cells, -1, np.intp)
    index[cells] = np.arange(len(cells))
    row = index[kept.cell]
    used = row >= 0
    at = row[used], rank[used]
    depth = int(counts.max(initial=0))
    y = np.full((len(cells), depth, 3), np.nan, np.float32)
    x = np.zeros((len(cells), depth, 3), np.float32)
    y[at], x[at] = kept.y[used], kept.x[used]
    if not len(cells):
        empty = np.zeros((0, TERMS, 3), np.float32)
        return RobustFit(cells, index, empty, np.zeros((0, 3)), np.zeros((0, TERMS)), 0.0)
    terms = basis(x.reshape(-1, 3)).reshape(len(cells), depth, TERMS)
    prior = _prior(cells, np.nanmedian(y, axis=1).mean(axis=1), grid)
    near = nearness(x) * np.isfinite(y[..., 0])
    coefficients, scale, distance = _bisquare(terms, np.nan_to_num(y), near, prior)
    beyond = float((distance[near > 0] > REJECT).mean())
    return RobustFit(cells, index, coefficients.astype(np.float32), scale, prior, beyond)


def nearness(x: Floats32) -> Floats32:
    """A sample's weight by its place `[…, 3]`."""
    return np.exp((x**2).sum(axis=-1) * np.float32(-0.5 / NEAR**2))


def _shrunk() -> Floats:
    """1 for the coefficients that have a prior, 0 for b0."""
    return np.r_[0.0, np.ones(TERMS - 1)]


def prior_precision(spread: Floats, prior: Floats) -> Floats:
    """`[T, 10, 10]` of the prior, in units of 1 / spread²."""
    diagonal = (spread[:, None] / prior) ** 2 * _shrunk()
    return np.asarray(np.einsum("ki,nk,kj->nij", _TURN, diagonal, _TURN, optimize=True))


def _turn() -> Floats:
    """`[10, 10]`: the coefficients of terms in s = (Δa + Δr)/2, u = (Δa − Δr)/2 and Δt, by those in
    Δa, Δr and Δt."""
    found = np.zeros((TERMS, TERMS))
    found[0, 0] = found[3, 3] = found[6, 6] = 1  # 1, t, t²
    found[1, 1:3], found[2, 1:3] = (1, 1), (1, -1)  # s, u of a, r
    square, mixed = (4, 5, 9), (7, 8)  # of a², r², ar; of rt, at
    for row, by in ((4, (1, 1, 1)), (5, (1, 1, -1)), (9, (2, -2, 0))):  # s², u², su
        found[row, square] = by
    found[7, mixed], found[8, mixed] = (-1, 1), (1, 1)  # ut, st
    return found


_TURN = _turn()


def _prior(cells: Ints, level: Floats, grid: CellGrid) -> Floats:
    """`[T, 10]` of the terms in s, u and t, from the differences between the cells' medians `[T]`.

    A far lamp and a far camera hold a + r, so that a photograph tells of u and t, and only other
    photographs of s; along it a surface changes least.
    """
    flat = np.full(grid.cells, np.nan)
    flat[cells] = level
    table = flat.reshape(grid.shape)
    along_s, along_u, along_t = (
        _change(table, step).ravel()[cells] for step in ((1, 1, 0), (1, -1, 0), (0, 0, 1))
    )
    known = np.fmax(along_u, along_t)
    along_s, along_u, along_t = (
        np.where(np.isnan(change), known, change) for change in (along_s, along_u, along_t)
    )
    least = np.maximum(_LEAST * abs(level), 1e-9 + 1e-6 * float(np.abs(level).max()))
    s, u, t = (np.fmax(change, least) for change in (along_s, along_u, along_t))
    slopes, bends = [s, u, t], [s, u, t, np.sqrt(u * t), np.sqrt(s * t), np.sqrt(s * u)]
    columns = [np.ones_like(s), *(_SLOPE * c for c in slopes), *(_BEND * c for c in bends)]
    return np.stack(columns, axis=1)


def _change(table: Floats, step: tuple[int, int, int]) -> Floats:
    """The largest difference a step to the next cell that has a value, on either side, at most
    `_FARTHEST` steps away; NaN where there is none. Over n steps it is taken for the sum of n
    changes that are independent."""
    found = np.full(table.shape, np.nan)
    for sign in (1, -1):
        this = np.full(table.shape, np.nan)
        for count in range(1, _FARTHEST + 1):
            shifted = np.full(table.shape, np.nan)
            to, of = _overlap(table.shape, tuple(sign * count * k for k in step))
            if not table[of].size:
                break
            shifted[to] = table[of]
            change = abs(shifted - table) / np.sqrt(count)
            this = np.where(np.isnan(this), change, this)
        found = np.fmax(found, this)
    return found


def _overlap(shape: tuple[int, ...], by: tuple[int, ...]) -> tuple[Any, Any]:
    """Where a table is, and where what lies `by` further is."""
    to = tuple(slice(max(0, -k), max(0, n - max(0, k))) for n, k in zip(shape, by, strict=True))
    of = tuple(slice(max(0, k), max(0, n + min(0, k))) for n, k in zip(shape, by, strict=True))
    return to, of


def _bisquare(
    terms: Floats32, y: Floats32, near: Floats32, prior: Floats
) -> tuple[Floats, Floats, Floats]:
    """Coefficients `[T, 10, 3]`, scales `[T, 3]`, each sample's distance in scales `[T, S]`."""
    there = near > 0
    few = min(_CLOSEST, near.shape[1]) - 1
    least = -np.partition(-near, few, axis=1)[:, few, None]
    middle = _median(y, there & (near >= least))
    scale = np.maximum(1.4826 * _median(np.abs(y - middle[:, None]), there), _floor(middle))
    coefficients = np.zeros((len(y), TERMS, 3))
    coefficients[:, 0] = middle
    off: NDArray[np.floating[Any]] = y - middle[:, None]
    for _ in range(_ROUNDS):
        distance = (np.abs(off) / scale[:, None]).max(axis=2)
        weight = near * np.clip(1 - (distance / _BISQUARE) ** 2, 0, None) ** 2
        square = np.einsum("ns,nsk,nsl->nkl", weight, terms, terms, optimize=True)
        right = np.einsum("ns,nsk,nsc->nkc", weight, terms, y, optimize=True)
        tie = 1e-9 * np.eye(TERMS)
        whole = square + prior_precision(scale.mean(axis=1), prior) + tie
        coefficients = np.linalg.solve(whole, right)
        off = y - terms @ coefficients.astype(np.float32)
        scale = np.maximum(1.4826 * _median(np.abs(off), there), _floor(coefficients[:, 0]))
    return coefficients, scale, (np.abs(off) / scale[:, None]).max(axis=2)


def _floor(level: Floats) -> Floats:
    return np.maximum(GRAIN * abs(level), 1e-12)


def _median(values: NDArray[np.floating[Any]], there: NDArray[np.bool_]) -> Floats:
    """`[T, 3]` medians of `[T, S, 3]` over the samples that are there."""
    ordered = np.sort(np.where(there[..., None], values, np.inf), axis=1)
    count = there.sum(axis=1)
    low, high = (np.maximum(count - 1, 0) // 2, np.maximum(count, 1) // 2)
    row = np.arange(len(values))
    high = np.minimum(high, np.maximum(count - 1, 0))
    return np.asarray((ordered[row, low] + ordered[row, high]) / 2, np.float64)
