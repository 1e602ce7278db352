"""What the errors that samples share do to the value at every node: of lamps, places and white.

A node's value is linear in its samples, b = Σ h y. An error of a lamp's direction moves all
samples of its photographs at once, by what `sample_moves` says, and b by Σ h Δy: the lamps' errors
are independent, so their squares add up, and a cell that several lamps fill has the less of each.
The errors of the sample's outline, or of where it lies on the board, move the samples of all
photographs; that of the board's pose in one photograph moves its samples (`pose_errors`). A lamp's
error, and a pose's, also changes what lights the white, and with it the scale of its photograph.

The samples are those that were chosen at random; each stands for all of its cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Ints
from raden_torch.capture.photo.brdf.cell_fit import REJECT, RobustFit, nearness, prior_precision
from raden_torch.capture.photo.brdf.cell_sums import NodeValues
from raden_torch.capture.photo.brdf.node_colour import NodeColour
from raden_torch.capture.photo.brdf.photo_cells import TERMS, CellGrid, basis
from raden_torch.capture.photo.brdf.photo_passes import AccumulatedCells
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries
from raden_torch.capture.photo.brdf.photo_white import Scale
from raden_torch.capture.photo.brdf.placement_errors import PlacementErrors
from raden_torch.capture.photo.brdf.pose_errors import (
    carried_lamp,
    carried_shape,
    change_on_white,
    pose_errors,
)
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample_moves import Moves, SamplesByShot, ShotSamples


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Standard deviations by the errors that samples share.

    Attributes:
        geometry, white: `[cells, 3]` of the reflectance factors; NaN in cells without a value.
        of_samples: `[n]` of the chosen samples, relative to the white, mean of the channels, by
            those of geometry.
    """

    geometry: Floats
    white: Floats
    of_samples: Floats


class NodeShares:
    """How much each chosen sample counts in its node's value.

    Attributes:
        row: `[n]` of the fit's cells, −1 where the sample counts nothing.
        weight: `[n]` h, with Σ h ≈ 1 in each cell.
        variance: `[n]` of the sample, mean of the channels, by all causes that `changed` was asked
            of.
    """

    def __init__(self, kept: Reservoir, fit: RobustFit, nodes: NodeValues) -> None:
        self._x = kept.x
        self._coefficients = np.nan_to_num(nodes.coefficients[fit.cell])
        self._cell_row = row = fit.index[kept.cell]
        self.variance: Floats = np.zeros(len(row))
        known = row >= 0
        safe = np.where(known, row, 0)
        terms = basis(kept.x)
        off = abs(kept.y - np.einsum("nk,nkc->nc", terms, fit.coefficients[safe]))
        known &= (off <= REJECT * fit.scale[safe]).all(axis=1)
        self.row: Ints = np.where(known, safe, -1)
        w = np.where(known, nearness(kept.x), 0)
        rows = len(fit.cell)
        there = np.bincount(safe[known], minlength=rows)
        more = np.maximum(nodes.count[fit.cell], 1) / np.maximum(there, 1)
        square = np.zeros((rows, TERMS, TERMS))
        for k in range(TERMS):
            for m in range(k, TERMS):
                added = np.bincount(safe, w * terms[:, k] * terms[:, m], rows)
                square[:, k, m] = square[:, m, k] = added
        whole = more[:, None, None] * square
        whole += prior_precision(fit.scale.mean(axis=1), fit.prior) + 1e-9 * np.eye(TERMS)
        at = basis(nodes.at[fit.cell].astype(np.float32))
        node = np.einsum("nk,nkl->nl", at, np.linalg.inv(whole)) * more[:, None]
        self.weight: Floats = w * np.einsum("nk,nk->n", terms, node[safe])

    def changed(self, part: ShotSamples, moves: Moves, times: float = 1.0) -> Floats:
        """`[rows, 3]`: by how much the camera's channels at the nodes are wrong, where the samples
        of a shot are wrong by so many times `moves`, one cause; it counts in `variance`."""
        row = self._cell_row[part.rows]
        by_sample = times * moves.change(self._coefficients[row], self._x[part.rows])
        self.variance[part.rows] += np.where(row < 0, 0, by_sample.mean(axis=1) ** 2)
        return self._at_nodes(part, by_sample)

    def brightened(self, part: ShotSamples) -> Floats:
        """The same, where the samples of a shot are twice as bright; it counts nowhere."""
        all_ = Moves.of_light(len(part.rows))
        row = self._cell_row[part.rows]
        return self._at_nodes(part, all_.change(self._coefficients[row], self._x[part.rows]))

    def _at_nodes(self, part: ShotSamples, by_sample: NDArray[np.floating[Any]]) -> Floats:
        row, h = self.row[part.rows], self.weight[part.rows]
        there, rows = row >= 0, len(self._coefficients)
        summed = [np.bincount(row[there], (h * c)[there], rows) for c in by_sample.T]
        return np.stack(summed, axis=1)


def shared_errors(
    by_shot: SamplesByShot,
    found: AccumulatedCells,
    series: PhotoSeries,
    colour: NodeColour,
    grid: CellGrid,
    placement: PlacementErrors,
) -> SharedErrors:
    """Of the lamps' directions, the sample's place, the board's poses and the white.

    Args:
        placement: of the sample.
    """
    fit, nodes, scale = found.fit, found.nodes, found.scale
    shares = NodeShares(found.kept, fit, nodes)
    rows, to = len(fit.cell), np.nan_to_num(colour.slopes(nodes.value[fit.cell]))
    lamps: dict[int, Floats] = {}
    place: list[Floats] = []
    white = np.zeros((rows, 3))
    for number in range(len(by_shot)):
        part, lamp = by_shot.of(number), series.lamps[number]
        there = lamps.setdefault(lamp.number, np.zeros((2, rows, 3)))
        for total, moves, on_white in zip(
            there, part.leans(grid.step_deg), scale.lean[number], strict=True
        ):
            total += shares.changed(part, moves.brighter(-float(on_white)), lamp.std_deg)
        shapes = placement.moved(part.shape, series.camera, series.shots[number].pose)
        place = place or [np.zeros((rows, 3)) for _ in shapes]
        for total, shape in zip(place, shapes, strict=True):
            total += shares.changed(part, part.on(shape, grid.step_deg))
        brighter = shares.brightened(part) * scale.std[number]
        white += np.einsum("mkc,mc->mk", to**2, brighter**2)
    geometry = np.zeros((rows, 3))
    of_lamps = (column for lamp in lamps.values() for column in lamp)
    of_poses = _by_poses(by_shot, shares, scale, series, grid, on_board=placement.on_board)
    for column in chain(of_lamps, place, of_poses):
        geometry += np.einsum("mkc,mc->mk", to, column) ** 2
    common = abs(np.nan_to_num(nodes.value[fit.cell])) * scale.common_std
    white += np.einsum("mkc,mc->mk", to, common) ** 2
    return SharedErrors(
        _on_grid(geometry, fit, nodes), _on_grid(white, fit, nodes), np.sqrt(shares.variance)
    )


def _by_poses(
    by_shot: SamplesByShot,
    shares: NodeShares,
    scale: Scale,
    series: PhotoSeries,
    grid: CellGrid,
    *,
    on_board: bool,
) -> Iterator[Floats]:
    """`[rows, 3]` each: what each error of a pose of the board does."""
    for errors in pose_errors(series):
        totals: list[Floats] = []
        for number, shot in enumerate(series.shots):
            if shot.pose is None or not any(e.concerns(series, number) for e in errors):
                continue
            part = by_shot.of(number)
            before = part.lamp, part.shape.middle
            changes = []
            for error in errors:
                pose = error.of(shot.pose)
                shape = carried_shape(part.shape, shot.pose, pose) if on_board else part.shape
                lamp = carried_lamp(part.lamp, error, shot.pose, series.seen_in)
                after = lamp, shape.middle
                on_white = change_on_white(scale.sights[number], before, after, (shot.pose, pose))
                moves = part.carried(shape, lamp, grid.step_deg).brighter(-on_white)
                changes.append(shares.changed(part, moves))
            totals = [a + b for a, b in zip(totals, changes, strict=True)] if totals else changes
        yield from totals


def _on_grid(variance: Floats, fit: RobustFit, nodes: NodeValues) -> Floats:
    out = np.full(nodes.value.shape, np.nan)
    out[fit.cell] = np.sqrt(variance)
    return np.where(np.isfinite(nodes.value), out, np.nan)
