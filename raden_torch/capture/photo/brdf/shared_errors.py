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

import numpy as np

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
    """Standard deviations `[cells, 3]` of the reflectance factors, by the errors that samples
    share; NaN in cells without a value."""

    geometry: Floats
    white: Floats


class NodeShares:
    """How much each chosen sample counts in its node's value.

    Attributes:
        row: `[n]` of the fit's cells, −1 where the sample counts nothing.
        weight: `[n]` h, with Σ h ≈ 1 in each cell.
    """

    def __init__(self, kept: Reservoir, fit: RobustFit, nodes: NodeValues) -> None:
        self._x = kept.x
        row = fit.index[kept.cell]
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

    def changed(self, part: ShotSamples, moves: Moves, coefficients: Floats) -> Floats:
        """`[rows, 3]`: by how much the camera's channels at the nodes are wrong, where the samples
        of a shot are by `moves`.

        Args:
            coefficients: `[rows, 10, 3]` of the cells.
        """
        row, h = self.row[part.rows], self.weight[part.rows]
        there = row >= 0
        by_sample = moves.change(coefficients[row], self._x[part.rows])
        rows = len(coefficients)
        return np.stack(
            [np.bincount(row[there], (h * c)[there], rows) for c in by_sample.T], axis=1
        )


def shared_errors(
    by_shot: SamplesByShot,
    leans: list[list[Moves]],
    found: AccumulatedCells,
    series: PhotoSeries,
    colour: NodeColour,
    grid: CellGrid,
    placement: PlacementErrors,
) -> SharedErrors:
    """Of the lamps' directions, the sample's place, the board's poses and the white.

    Args:
        leans: of each shot, a degree of its lamp along each of its two directions.
        placement: of the sample.
    """
    fit, nodes, scale = found.fit, found.nodes, found.scale
    shares = NodeShares(found.kept, fit, nodes)
    rows, to = len(fit.cell), np.nan_to_num(colour.slopes(nodes.value[fit.cell]))
    coefficients = np.nan_to_num(nodes.coefficients[fit.cell])
    lamps: dict[int, Floats] = {}
    place: list[Floats] = []
    white = np.zeros((rows, 3))
    for number in range(len(by_shot)):
        part, lamp = by_shot.of(number), series.lamps[number]
        for j, moves in enumerate(leans[number]):
            there = lamps.setdefault(lamp.number, np.zeros((2, rows, 3)))
            moves = moves.brighter(-float(scale.lean[number, j]))
            there[j] += lamp.std_deg * shares.changed(part, moves, coefficients)
        shapes = placement.moved(part.shape, series.camera, series.shots[number].pose)
        place = place or [np.zeros((rows, 3)) for _ in shapes]
        for total, shape in zip(place, shapes, strict=True):
            total += shares.changed(part, part.on(shape, grid.step_deg), coefficients)
        brighter = shares.changed(part, Moves.of_light(len(part.rows)), coefficients)
        white += np.einsum("mkc,mc->mk", to**2, (brighter * scale.std[number]) ** 2)
    geometry = np.zeros((rows, 3))
    of_poses = _by_poses(by_shot, shares, coefficients, scale, series, grid, placement)
    columns = (column for lamp in lamps.values() for column in lamp)
    for column in chain(columns, place, of_poses):
        geometry += np.einsum("mkc,mc->mk", to, column) ** 2
    common = abs(np.nan_to_num(nodes.value[fit.cell])) * scale.common_std
    white += np.einsum("mkc,mc->mk", to, common) ** 2
    return SharedErrors(_on_grid(geometry, fit, nodes), _on_grid(white, fit, nodes))


def _by_poses(
    by_shot: SamplesByShot,
    shares: NodeShares,
    coefficients: Floats,
    scale: Scale,
    series: PhotoSeries,
    grid: CellGrid,
    placement: PlacementErrors,
) -> Iterator[Floats]:
    """`[rows, 3]` each: what each error of a pose of the board does."""
    for errors in pose_errors(series):
        totals = np.zeros((len(errors), len(coefficients), 3))
        for number, shot in enumerate(series.shots):
            if shot.pose is None or not any(e.concerns(series, number) for e in errors):
                continue
            part = by_shot.of(number)
            before = part.lamp, part.shape.middle
            for total, error in zip(totals, errors, strict=True):
                pose = error.of(shot.pose)
                shape = part.shape
                if placement.on_board:
                    shape = carried_shape(shape, shot.pose, pose)
                lamp = carried_lamp(part.lamp, error, shot.pose, series.seen_in)
                after = lamp, shape.middle
                on_white = change_on_white(scale.sights[number], before, after, (shot.pose, pose))
                moves = part.carried(shape, lamp, grid.step_deg).brighter(-on_white)
                total += shares.changed(part, moves, coefficients)
        yield from totals


def _on_grid(variance: Floats, fit: RobustFit, nodes: NodeValues) -> Floats:
    out = np.full(nodes.value.shape, np.nan)
    out[fit.cell] = np.sqrt(variance)
    return np.where(np.isfinite(nodes.value), out, np.nan)
