"""All samples that agree with the first fit → the value at every node, in sums of bounded size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Floats32, Ints
from raden_torch.capture.photo.brdf.cell_fit import (
    FEWEST,
    GRAIN,
    REJECT,
    RobustFit,
    nearness,
    prior_precision,
)
from raden_torch.capture.photo.brdf.photo_cells import TERMS, CellGrid, basis

_PAIRS = np.triu_indices(TERMS)
_LEAST_FREEDOM = 0.2
"""Of the samples' number: what is left of it after the terms that were fitted to them, at least."""


@dataclass(frozen=True, eq=False)
class NodeValues:
    """The result, a row a cell of the grid; NaN in cells without samples enough.

    Attributes:
        value: `[cells, 3]` at the node.
        noise: `[cells, 3]` its standard deviation by the scatter of the samples.
        place: `[cells, 3]` the same by what is not known of the slopes within the cell.
        coefficients: `[cells, 10, 3]` of the quadratic, in steps of the grid.
        at: `[cells, 3]` where in the cell the value holds, in steps: 0, or amid the samples.
        count: `[cells]` samples that took part.
    """

    value: Floats
    noise: Floats
    place: Floats
    coefficients: Floats
    at: Floats
    count: NDArray[np.int64]


class CellSums:
    """Weighted sums of the terms' products, of terms times values, and of squares, cell by cell.

    Values are differences from the first fit, so that nothing cancels in the squares.

    Attributes:
        fit: the first fit.
        seen: `[T]` samples of each of its cells.
        count: `[T]` those that agree with it.
    """

    def __init__(self, fit: RobustFit) -> None:
        rows = len(fit.cell)
        self.fit = fit
        self.seen = np.zeros(rows, np.int64)
        self.count = np.zeros(rows, np.int64)
        self._sums = np.zeros((rows, len(_PAIRS[0]) + 3 * TERMS + 5))

    def add(self, cell: Ints, x: Floats32, y: Floats32) -> None:
        """Add samples: cells `[n]`, places `[n, 3]`, values `[n, 3]`."""
        row = self.fit.index[cell]
        known = row >= 0
        row, x, y = row[known], x[known], y[known]
        self.seen += np.bincount(row, minlength=len(self.seen))
        terms = basis(x)
        off = y - np.einsum("nk,nkc->nc", terms, self.fit.coefficients[row])
        good = (np.abs(off) <= REJECT * self.fit.scale[row]).all(axis=1)
        row, terms, off = row[good], terms[good], off[good]
        self.count += np.bincount(row, minlength=len(self.count))
        w = nearness(x[good])[:, None]
        weighted = w * terms
        of_values = [weighted * off[:, c : c + 1] for c in range(3)]
        columns = [weighted[:, _PAIRS[0]] * terms[:, _PAIRS[1]], *of_values, w * off**2, w, w**2]
        self._sums += _summed(row, np.concatenate(columns, axis=1), len(self.count))

    def nodes(self, grid: CellGrid, *, amid_samples: bool = False) -> NodeValues:
        """The value at every node, or amid each cell's samples, and how well it is known."""
        moments = self._moments()
        spread = np.sqrt(moments.squares / moments.weight).mean(axis=1)
        spread = np.maximum(spread, GRAIN * np.abs(moments.first[:, 0]).mean(axis=1))
        precision = prior_precision(spread, moments.prior)
        whole = moments.terms + precision
        # the sums are of differences from the first fit; the prior is around 0 all the same
        moved = np.linalg.solve(whole, moments.values - precision @ moments.first)
        found = moments.first + moved
        inverse = np.linalg.inv(whole)
        scatter = moments.scatter(moved, inverse)
        at = (
            moments.terms[:, 0, 1:4] / moments.weight if amid_samples else np.zeros((len(whole), 3))
        )
        there = basis(at.astype(np.float32))
        node = np.einsum("nk,nkl->nl", there, inverse)
        from_noise = np.einsum("nk,nkl,nl->n", node, moments.terms, node) * moments.share
        from_place = np.einsum("nk,nkl,nl->n", node, precision, node)
        place = np.repeat((spread * np.sqrt(from_place))[:, None], 3, axis=1)
        count = np.zeros(grid.cells, np.int64)
        count[moments.cell] = moments.count

        def on_grid(column: Floats) -> Floats:
            out = np.full((grid.cells, *column.shape[1:]), np.nan)
            out[moments.cell] = column
            return out

        return NodeValues(
            value=on_grid(np.einsum("nk,nkc->nc", there, found)),
            noise=on_grid(scatter * np.sqrt(from_noise.clip(min=0))[:, None]),
            place=on_grid(place),
            coefficients=on_grid(found),
            at=np.nan_to_num(on_grid(at)),
            count=count,
        )

    def _moments(self) -> _Moments:
        good = (self.count >= FEWEST) & (self._sums[:, -2] > 1e-3)
        sums, pairs = self._sums[good], len(_PAIRS[0])
        terms = np.zeros((len(sums), TERMS, TERMS))
        terms[:, _PAIRS[0], _PAIRS[1]] = sums[:, :pairs]
        terms[:, _PAIRS[1], _PAIRS[0]] = sums[:, :pairs]
        values = sums[:, pairs:-5].reshape(-1, 3, TERMS).transpose(0, 2, 1)
        return _Moments(
            cell=self.fit.cell[good],
            count=self.count[good],
            first=self.fit.coefficients[good].astype(np.float64),
            prior=self.fit.prior[good],
            terms=terms,
            values=values,
            squares=sums[:, -5:-2],
            weight=sums[:, -2:-1],
            share=sums[:, -1] / sums[:, -2],
        )


@dataclass(frozen=True, eq=False)
class _Moments:
    """Of the cells with samples enough, `[T, …]`: Σ w x xᵀ, Σ w x y, Σ w y², Σ w, Σ w² / Σ w."""

    cell: Ints
    count: NDArray[np.int64]
    first: Floats
    prior: Floats
    terms: Floats
    values: Floats
    squares: Floats
    weight: Floats
    share: Floats

    def scatter(
        self, moved: NDArray[np.floating[Any]], inverse: NDArray[np.floating[Any]]
    ) -> Floats:
        """`[T, 3]` standard deviation of single samples around the fit, less what was fitted."""
        explained = 2 * np.einsum("nkc,nkc->nc", moved, self.values)
        explained -= np.einsum("nkc,nkl,nlc->nc", moved, self.terms, moved)
        left = (self.squares - explained).clip(min=0) / self.weight
        fitted = np.einsum("nkl,nlk->n", inverse, self.terms)  # effective number of terms
        freedom = 1 - fitted * self.share / self.weight[:, 0]
        return np.sqrt(left / np.maximum(freedom, _LEAST_FREEDOM)[:, None])


def _summed(row: Ints, columns: Floats32, rows: int) -> Floats:
    """`[rows, C]`: columns `[n, C]` summed by their row."""
    from scipy import sparse

    ones = np.ones(len(row), np.float64)
    return np.asarray(
        sparse.csr_matrix((ones, (row, np.arange(len(row)))), (rows, len(row))) @ columns
    )
