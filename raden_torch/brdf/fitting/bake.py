"""Write an interpolator into a table that is read trilinearly.

The table's axes are incidence, r − a and tilt, so that the mirror ridge runs along the first. Each
measured cell is cut into 1, 2, 4, 8 or 16 pieces, where that helps most: one cut after another goes
to the cell and axis at which the error falls most for the growth of the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.brdf.model.reflectance_table import Pieces
from raden_torch.reflectance.continuation import Continued
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.interpolation import Interpolant
from raden_torch.reflectance.log_readings import LUMINANCE

NODES = 110_000
"""How many nodes a baked table may have: 1.3 MB in float32, near the size of a core's cache."""

_CUTS = np.array([1, 2, 4, 8, 16])
_SAMPLES = 20_000
_SCALE = 0.005  # of both errors, RMS over the 99.9 % quantile and mean |Δ log(1+Y)|
_VALUES_AT_ONCE = 1_000_000  # of all channels; meanwhile some 30 times as many are kept
_MARGIN = 2.0  # measured steps beyond the box along receiving that a cell at its edge may touch


@dataclass(frozen=True)
class BakedTable:
    """A table `[X, Y, Z, C]` of reflectance factors, and its cuts (see `ReflectanceTable`)."""

    values: Floats
    pieces: Pieces


def bake(
    function: Interpolant | Continued,
    nodes: int = NODES,
    seed: int = 0,
    *,
    like: Interpolant | None = None,
) -> BakedTable:
    """Cut the cells and write the function into the nodes.

    Args:
        function: one that is continued is cut in its box alone.
        like: a function that is read sooner and needs the same cuts.
        nodes: the most nodes the table may have in the box.
        seed: of the points at which the error of a cut is measured.
    """
    inner = function.inner if isinstance(function, Continued) else function
    pieces = _longer(allocate(like or inner, nodes, seed), inner.grid, function.grid)
    return BakedTable(at_nodes(function, pieces), pieces)


def at_nodes(function: Interpolant | Continued, pieces: Pieces) -> Floats:
    """`[X, Y, Z, C]`: the function at the nodes of a table with these cuts."""
    inner = function.inner if isinstance(function, Continued) else function
    axes = [_nodes(cuts) for cuts in pieces]
    step, first = function.grid.step, function.grid.low
    cells = len(pieces[0])
    x, across, z = np.meshgrid(*axes, indexing="ij")
    # in measured cells: receiving = incidence + (r − a), whose axis begins `cells` below
    angles = first + step * np.stack([x, x + across - cells, z], axis=-1)
    receiving = function.grid.receiving_deg
    margin = _MARGIN * step[1] + 1e-9
    used = (angles[..., 1] >= receiving[0] - margin) & (angles[..., 1] <= receiving[-1] + margin)
    values = np.zeros((*used.shape, inner.cap.shape[-1]))
    values[used] = in_parts(function, angles[used])
    if function.grid.is_mirrored:
        _average_equivalents(values, len(pieces[0]), pieces[1])
    return values


def in_parts(function: Callable[[Floats], Floats], angles_deg: Floats) -> Floats:
    """The function at `[M, 3]` angles, so many at a time that what it keeps meanwhile is small."""
    first = function(angles_deg[:1])
    count = max(1, _VALUES_AT_ONCE // first.shape[1])
    parts = np.split(angles_deg, range(count, len(angles_deg), count))
    return (
        np.concatenate([function(part) for part in parts])
        if len(parts) > 1
        else function(angles_deg)
    )


def _longer(pieces: Pieces, inner: AngleGrid, whole: AngleGrid) -> Pieces:
    """The pieces of a larger grid's cells: one, where the smaller grid has no cell."""
    parts = whole.part(inner)
    before = [part.start for part in parts]
    after = [n - part.stop for n, part in zip(whole.shape, parts, strict=True)]
    along = (
        (before[0], after[0]),
        (before[1] + after[0], after[1] + before[0]),
        (before[2], after[2]),
    )
    a, across, t = (
        (*(1,) * low, *cuts, *(1,) * high) for cuts, (low, high) in zip(pieces, along, strict=True)
    )
    if whole.is_mirrored:  # at incidence 0, r − a runs over the last of its cells: alike both ways
        even = map(max, across[len(a) :], across[: len(a) - 1 : -1])
        across = (*across[: len(a)], *even)
    return a, across, t


def _average_equivalents(values: Floats, cells: int, across: tuple[int, ...]) -> None:
    """(0, r, t) ≡ (0, −r, −t): the plane at incidence 0 is made exactly even, as its nodes are."""
    plane = values[0, sum(across[:cells]) :]
    plane[:] = (plane + plane[::-1, ::-1]) / 2


def allocate(function: Interpolant, nodes: int, seed: int) -> Pieces:
    """Choose the pieces of every cell, greedily; a cell and its mirror image are cut alike."""
    errors = _errors_of_cuts(function, seed)
    mirror = _mirror_cells([len(error) for error in errors], function.grid.is_mirrored)
    errors = [(error + error[m]) / 2 for error, m in zip(errors, mirror, strict=True)]
    level = [np.zeros(len(error), int) for error in errors]
    total = np.sum([error[:, 0].sum(axis=0) for error in errors], axis=0)
    while True:
        sizes = [1 + int(_CUTS[chosen].sum()) for chosen in level]
        best, choice = 0.0, (0, 0, 0)
        for axis in range(3):
            for jump in (1, 2):
                to = np.minimum(level[axis] + jump, len(_CUTS) - 1)
                both = np.where(mirror[axis] == np.arange(len(to)), 1, 2)
                growth = 1 + both * (_CUTS[to] - _CUTS[level[axis]]) / sizes[axis]
                fits = np.prod(sizes, dtype=float) * growth <= nodes
                gain = _gains(errors[axis], level[axis], to, both, total, growth)
                gain[~fits | (level[axis] + jump >= len(_CUTS))] = 0
                cell = int(gain.argmax())
                if gain[cell] > best:
                    best, choice = float(gain[cell]), (axis, cell, int(to[cell]))
        if best <= 0:
            a, across, t = (tuple(int(n) for n in _CUTS[chosen]) for chosen in level)
            return a, across, t
        axis, cell, new = choice
        for c in {cell, int(mirror[axis][cell])}:
            total = total + errors[axis][c, new] - errors[axis][c, level[axis][c]]
            level[axis][c] = new


def _mirror_cells(cells: list[int], mirrored: bool) -> list[Ints]:
    """Per axis, which cell is each cell's equivalent at incidence 0: (r, t) ≡ (−r, −t)."""
    same = [np.arange(n) for n in cells]
    if mirrored:
        receiving = cells[1] - cells[0]  # at incidence 0, r − a runs over the last of its cells
        same[1][-receiving:] = same[1][-receiving:][::-1].copy()
        same[2] = same[2][::-1].copy()
    return same


def _gains(
    error: Floats, level: Ints, to: Ints, both: Ints, total: Floats, growth: Floats
) -> Floats:
    """For every cell of an axis: the fall of the cost per logarithm of the table's growth."""
    cell = np.arange(len(level))
    after = total + both[:, None] * (error[cell, to] - error[cell, level])
    fall = _cost(total) - _cost(after)
    return np.asarray(fall / np.log(np.maximum(growth, 1 + 1e-9)))


def _cost(moments: Floats) -> Floats:
    rms, log = np.sqrt(np.maximum(moments[..., 0], 0)), moments[..., 1]
    return np.asarray(rms + log) / _SCALE


def _errors_of_cuts(function: Interpolant, seed: int) -> list[Floats]:
    """Per axis `[cells, cuts, 2]`: what linear reading of n pieces costs in that cell.

    The two numbers are sums over all sample points in the cell, over their whole number: of the
    squared error over the 99.9 % quantile, and of |Δ log(1+Y)|.
    """
    step, low = function.grid.step, function.grid.low
    cells = [len(axis) - 1 for axis in function.grid]
    points = np.random.default_rng(seed).uniform(low, function.grid.high, (_SAMPLES, 3))

    def luminance(at: Floats) -> Floats:
        return function(at, slice(LUMINANCE, LUMINANCE + 1))[:, 0]

    truth = luminance(points)
    level = max(float(np.quantile(truth, 0.999)), 1e-9)
    node = function.grid.positions(points)
    position = np.stack([node[:, 0], node[:, 1] - node[:, 0] + cells[0], node[:, 2]], axis=1)
    found = []
    for axis, count in enumerate((cells[0], cells[0] + cells[1], cells[2])):
        cell = np.clip(np.floor(position[:, axis]).astype(int), 0, count - 1)
        error = np.zeros((count, len(_CUTS), 2))
        for option, n in enumerate(_CUTS):
            read = _read_linearly(luminance, points, step, axis, position[:, axis] - cell, int(n))
            square = ((read - truth) / level) ** 2
            log = abs(np.log1p(np.maximum(read, 0)) - np.log1p(truth))
            for kind, value in enumerate((square, log)):
                error[:, option, kind] = np.bincount(cell, value, count) / len(points)
        found.append(np.minimum.accumulate(error, axis=1))
    return found


def _read_linearly(
    luminance: Callable[[Floats], Floats],
    points: Floats,
    step: Floats,
    axis: int,
    fraction: Floats,
    n: int,
) -> Floats:
    """The function read linearly along one axis of the table, whose cell is cut into n pieces."""
    piece = np.clip(np.floor(fraction * n), 0, n - 1)
    f = fraction * n - piece
    total = np.zeros(len(points))
    for end, weight in ((piece, 1 - f), (piece + 1, f)):
        moved = points.copy()
        shift = step[axis] * (end / n - fraction)
        moved[:, axis] += shift
        if axis == 0:  # along incidence at constant r − a
            moved[:, 1] += shift
        total += weight * luminance(moved)
    return total


def _nodes(pieces: tuple[int, ...]) -> Floats:
    """The nodes of an axis, in measured cells."""
    return np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(pieces))])
