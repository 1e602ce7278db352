"""Fill the cells of a grid that were not measured, from the ones that were.

In this order: the equivalent geometry at perpendicular incidence, (0, r, t) ≡ (0, −r, −t); the
smoothest continuation of the measured neighbours; and, where no measured cell is near, nothing (the
caller falls back to the diffuse part).

The smoothest continuation minimises squared second differences along three directions: along the
mirror ridge (incidence and receiving together, so at constant r − a), along receiving, and along
tilt. The ridge counts most, since a highlight keeps its shape along it. At a = 0 the ridge goes on
into its own mirror image, f(−a, r, t) = f(a, −r, −t): a maximum at perpendicular incidence is
found, not cut off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import factorized

from raden_torch.arrays import Bools, Floats, Ints
from raden_torch.errors import InputError
from raden_torch.reflectance.grid import SAME_DEG, AngleGrid
from raden_torch.reflectance.symmetry import average_perpendicular, mirrored_nodes

RIDGE_WEIGHT, RECEIVING_WEIGHT, TILT_WEIGHT = 1.0, 0.1, 0.03
REACH = 3
"""Grid steps from the nearest measured cell."""


_MAX_UNKNOWN = 300_000
_TIE = 1e-9  # keeps a cell that no difference touches from being singular


@dataclass(frozen=True)
class Filled:
    """A grid without gaps.

    Attributes:
        values: `[A, R, T, C]`; NaN in the cells of `without_neighbour`.
        from_equivalent, from_neighbours, without_neighbour: `[A, R, T]`, the cells that were not
            measured, by what became of them.
        averaged: `[A, R, T]`, measured cells that were replaced by the mean over equivalents.
        asymmetry: mean |difference| of equivalent cells at a = 0 over their mean; NaN if none.
    """

    values: Floats
    from_equivalent: Bools
    from_neighbours: Bools
    without_neighbour: Bools
    averaged: Bools
    asymmetry: float


def fill(grid: AngleGrid, values: Floats) -> Filled:
    """Fill a uniform grid.

    Args:
        grid: evenly spaced.
        values: `[A, R, T, C]`, NaN where not measured.
    """
    measured = ~np.isnan(values).any(axis=-1)
    values, averaged, asymmetry = average_perpendicular(grid, values)
    known = np.asarray(~np.isnan(values).any(axis=-1))
    near = ndimage.binary_dilation(known, iterations=REACH) & ~known
    values = _continue_smoothly(grid, values, near)
    return Filled(
        values=values,
        from_equivalent=known & ~measured,
        from_neighbours=near,
        without_neighbour=~(known | near),
        averaged=averaged & measured,
        asymmetry=asymmetry,
    )


def _continue_smoothly(grid: AngleGrid, values: Floats, unknown: Bools) -> Floats:
    """Solve for the `unknown` cells; cells that are NaN and not unknown take no part."""
    if not unknown.any():
        return values
    if unknown.sum() > _MAX_UNKNOWN:
        raise InputError(
            f"measurement: expected at most {_MAX_UNKNOWN} missing cells beside measured ones, "
            f"got {int(unknown.sum())}; measure more of them or use a coarser grid"
        )
    missing = np.isnan(values).any(axis=-1) & ~unknown
    matrix = roughness(grid, missing)
    flat = values.reshape(missing.size, -1).copy()
    to_find = np.flatnonzero(unknown)
    given = np.flatnonzero(~(unknown | missing))
    of_unknown = matrix[:, to_find]
    normal_equations = (of_unknown.T @ of_unknown + _TIE * sparse.identity(len(to_find))).tocsc()
    right_side = -of_unknown.T @ (matrix[:, given] @ flat[given])
    solve = factorized(normal_equations)
    for c in range(flat.shape[1]):
        flat[to_find, c] = solve(right_side[:, c])
    return flat.reshape(values.shape)


def roughness(grid: AngleGrid, missing: Bools) -> sparse.csc_matrix:
    """`[D, cells]`: the weighted second differences that touch no missing cell."""
    triples, weights = _second_differences(grid, missing.shape)
    whole = ~missing.ravel()[triples].any(axis=1)
    triples, weights = triples[whole], weights[whole]
    rows = np.repeat(np.arange(len(triples)), 3)
    data = (weights[:, None] * np.array([1.0, -2.0, 1.0])).ravel()
    return sparse.csc_matrix((data, (rows, triples.ravel())), (len(triples), missing.size))


def _second_differences(grid: AngleGrid, shape: tuple[int, ...]) -> tuple[Ints, Floats]:
    """`[D, 3]` flat cell indices (before, at, after) and `[D]` weights of all differences."""
    index = np.arange(int(np.prod(shape))).reshape(shape)
    groups = [
        (RECEIVING_WEIGHT, index[:, :-2], index[:, 1:-1], index[:, 2:]),
        (TILT_WEIGHT, index[:, :, :-2], index[:, :, 1:-1], index[:, :, 2:]),
    ]
    if abs(grid.step[0] - grid.step[1]) < SAME_DEG:  # the ridge runs through nodes
        groups.append((RIDGE_WEIGHT, index[:-2, :-2], index[1:-1, 1:-1], index[2:, 2:]))
        groups.append((RIDGE_WEIGHT, *_across_perpendicular(index, grid)))
    else:
        groups.append((RIDGE_WEIGHT, index[:-2], index[1:-1], index[2:]))
    triples = [np.stack([cell.ravel() for cell in cells], axis=1) for _, *cells in groups]
    weights = [np.full(len(t), g[0]) for t, g in zip(triples, groups, strict=True)]
    return np.concatenate(triples), np.concatenate(weights)


def _across_perpendicular(index: Ints, grid: AngleGrid) -> tuple[Ints, Ints, Ints]:
    """The ridge difference at a = 0, whose cell before is the equivalent (a1, −(r − a1), −t)."""
    empty = np.zeros(0, np.intp)
    incidence, receiving, tilt = grid
    if abs(incidence[0]) > SAME_DEG:
        return empty, empty, empty
    j, j2 = mirrored_nodes(receiving)
    k, k2 = mirrored_nodes(tilt)
    inner = (j > 0) & (j < len(receiving) - 1) & (j2 < len(receiving) - 1)
    j, j2 = j[inner], j2[inner]
    # −(r_j − step) is one node above −r_j, which is node j2
    return index[1][np.ix_(j2 + 1, k2)], index[0][np.ix_(j, k)], index[1][np.ix_(j + 1, k)]
