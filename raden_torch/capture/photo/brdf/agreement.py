"""Do the photographs agree where they saw the same cells?

A cell that several photographs filled has a median of each. Against the others' the difference has
a standard deviation: the scatter of the samples over the root of their number, the white under
either lamp, and the errors of geometry: of lamps, the sample's place and the board's poses. χ² of a
photograph is the mean square of the differences over their variances; a factor common to all cells
is told from a difference that changes its sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.cell_fit import RobustFit
from raden_torch.capture.photo.brdf.photo_cells import basis
from raden_torch.capture.photo.brdf.photo_white import Scale
from raden_torch.capture.photo.brdf.reservoir import Reservoir

CHI2_LIMIT = 9.0
"""Differences three times as large as they should be, over all cells of a photograph."""
WORTH = 0.03
"""And at least so large, relative: less is below what any photograph is good for."""

_FEWEST = 4
_FEWEST_CELLS = 20
_OF_MEDIAN = 1.2533
"""Standard deviation of a median over that of a mean, for a Gaussian."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """How each of K shots agrees with the others; NaN where they share too few cells.

    Attributes:
        brighter: `[K]` median relative difference from the others, signed.
        spread: `[K]` median absolute relative difference.
        chi2: `[K]` robust: median of the squares over the variances, as of a mean.
        cells: `[K]` compared.
    """

    brighter: Floats
    spread: Floats
    chi2: Floats
    cells: NDArray[np.int64]

    def worst(self) -> int | None:
        """The shot that contradicts the others beyond its uncertainty the most; None if none."""
        wrong = (self.chi2 > CHI2_LIMIT) & (self.spread > WORTH)
        if not wrong.any():
            return None
        return int(np.where(wrong, np.nan_to_num(self.spread), 0).argmax())

    def contradiction(self, names: Sequence[str]) -> str | None:
        """One line that names the photograph and the likely reason; None where all agree."""
        worst = self.worst()
        if worst is None:
            return None
        wrong = np.flatnonzero((self.chi2 > CHI2_LIMIT) & (self.spread > WORTH))
        size, sign = self.spread[worst], self.brighter[worst]
        text = (
            f"{names[worst]}: it contradicts the other photographs: by {100 * size:.0f} % in the "
            f"median of {self.cells[worst]} shared cells, {np.sqrt(self.chi2[worst]):.0f} times "
            "its uncertainty; "
        )
        if len(wrong) > max(2, len(names) // 2):
            return text + (
                f"so do {len(wrong) - 1} others: the sample is not even, or does not look the same "
                "when it is turned, or the shape, the lights file or the order is wrong"
            )
        if abs(sign) > 0.7 * size:
            more = "brighter" if sign > 0 else "darker"
            return text + (
                f"it is {more} by {100 * abs(sign):.0f} % all over: another exposure, the lamp's "
                "brightness, or a shadow or reflection on the white in it"
            )
        return text + "brighter here and darker there: its lamp or the sample moved"


def agreement(
    kept: Reservoir,
    fit: RobustFit,
    scale: Scale,
    geometry: Floats,
) -> Agreement:
    """Compare the chosen samples of each shot with those of the others, cell by cell.

    Args:
        geometry: `[n]` standard deviation of each sample by the errors of geometry, mean of the
            channels; alike in all samples of a shot and cell.
    """
    shots = len(scale.rgb)
    row = _groups(kept, fit, geometry)
    level, cells_of = row.median, len(fit.cell)
    size = np.abs(fit.coefficients[:, 0]).mean(axis=1).astype(np.float64)
    # the scatter within each shot, not that of all, which a contradiction itself makes wide
    pooled = np.bincount(row.cell, row.spread * row.count, cells_of)
    own = (pooled / np.maximum(np.bincount(row.cell, row.count, cells_of), 1))[row.cell]
    systematic = np.hypot(row.geometry, size[row.cell] * scale.std.mean(axis=1)[row.shot])
    variance = (_OF_MEDIAN * own) ** 2 / row.count + systematic**2 + (2e-3 * size[row.cell]) ** 2
    # the others' weighted mean, by taking the own out of the sums
    weight = 1 / np.maximum(variance, 1e-300)
    total, whole = (np.bincount(row.cell, w, cells_of) for w in (weight, weight * level))
    alone = np.bincount(row.cell, minlength=cells_of)[row.cell] < 2
    rest = np.where(alone, 1.0, total[row.cell] - weight)
    others = (whole[row.cell] - weight * level) / rest
    difference = level - others
    relative = difference / np.maximum(size[row.cell], 1e-12)
    square = difference**2 / (variance + 1 / rest)
    out = np.full((3, shots), np.nan)
    cells = np.zeros(shots, np.int64)
    for k in range(shots):
        mine = (row.shot == k) & ~alone
        cells[k] = mine.sum()
        if cells[k] >= _FEWEST_CELLS:
            out[:, k] = (
                np.median(relative[mine]),
                np.median(abs(relative[mine])),
                np.median(square[mine]) / 0.4549,  # the median of chi² with one degree
            )
    return Agreement(out[0], out[1], out[2], cells)


@dataclass(frozen=True, eq=False)
class _Groups:
    """The cells of each shot: rows of the fit, the shot, how many samples, and their differences
    from the fit, mean of the channels: the median, the robust deviation around it, and the
    deviation by the errors of geometry."""

    cell: NDArray[np.intp]
    shot: NDArray[np.intp]
    count: NDArray[np.intp]
    median: Floats
    spread: Floats
    geometry: Floats


def _groups(kept: Reservoir, fit: RobustFit, geometry: Floats) -> _Groups:
    row = fit.index[kept.cell]
    used = row >= 0
    row, shot = row[used], kept.shot[used].astype(np.intp)
    predicted = np.einsum("nk,nkc->nc", basis(kept.x[used]), fit.coefficients[row])
    off = (kept.y[used] - predicted).mean(axis=1).astype(np.float64)
    order = np.lexsort((off, shot, row))
    key = row[order] * (int(shot.max(initial=0)) + 1) + shot[order]
    starts = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    counts = np.diff(np.r_[starts, len(key)])
    middle = off[order][starts + counts // 2]
    group = np.repeat(np.arange(len(starts)), counts)
    away = np.abs(off[order] - middle[group])
    ranked = away[np.lexsort((away, group))]
    spread = 1.4826 * ranked[starts + counts // 2]
    enough = counts >= _FEWEST
    first = order[starts[enough]]
    shared = np.sqrt(np.add.reduceat(geometry[used][order] ** 2, starts) / counts)
    return _Groups(
        row[first], shot[first], counts[enough], middle[enough], spread[enough], shared[enough]
    )
