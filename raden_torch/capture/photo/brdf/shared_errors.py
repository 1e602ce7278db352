"""What the errors that samples share do to the value at every node: of lamps, outline and white.

A node's value is linear in its samples, b = Σ h y. An error of a lamp's direction moves all
samples of its photographs at once, by what `sample_moves` says, and b by Σ h Δy: the lamps' errors
are independent, so their squares add up, and a cell that several lamps fill has the less of each.
The outline's errors move the samples of all photographs. A lamp's error also changes what lights
the white, and with it the scale of its photograph.

The samples are those that were chosen at random; each stands for all of its cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.capture.photo.brdf.cell_fit import REJECT, RobustFit, nearness, prior_precision
from raden_torch.capture.photo.brdf.cell_sums import NodeValues
from raden_torch.capture.photo.brdf.node_colour import NodeColour
from raden_torch.capture.photo.brdf.outline_errors import moved_shapes
from raden_torch.capture.photo.brdf.photo_cells import TERMS, CellGrid, basis
from raden_torch.capture.photo.brdf.photo_passes import AccumulatedCells
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries
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


def shared_errors(
    by_shot: SamplesByShot,
    leans: list[list[Moves]],
    found: AccumulatedCells,
    series: PhotoSeries,
    colour: NodeColour,
    grid: CellGrid,
    *,
    outline_px: float,
) -> SharedErrors:
    """Of the lamps' directions, the sample's outline and the white.

    Args:
        leans: of each shot, a degree of its lamp along each of its two directions.
        outline_px: standard deviation of the sample's outline.
    """
    kept, fit, nodes, scale = found.kept, found.fit, found.nodes, found.scale
    shares = NodeShares(kept, fit, nodes)
    rows, to = len(fit.cell), np.nan_to_num(colour.slopes(nodes.value[fit.cell]))
    coefficients = np.nan_to_num(nodes.coefficients[fit.cell])
    lamps: dict[int, Floats] = {}
    outline: list[Floats] = []
    white = np.zeros((rows, 3))

    def moved(part: ShotSamples, moves: Moves, more: float = 0.0) -> Floats:
        """`[rows, 3]` change of the camera's channels at the nodes."""
        row, h = shares.row[part.rows], shares.weight[part.rows]
        x = kept.x[part.rows]
        changed = Moves(moves.place, moves.light + np.float32(more)).change(coefficients[row], x)
        summed = [np.bincount(row[row >= 0], (h * c)[row >= 0], rows) for c in changed.T]
        return np.stack(summed, axis=1)

    for number in range(len(by_shot)):
        part, lamp = by_shot.of(number), series.lamps[number]
        for j, moves in enumerate(leans[number]):
            there = lamps.setdefault(lamp.number, np.zeros((2, rows, 3)))
            there[j] += lamp.std_deg * moved(part, moves, -float(scale.lean[number, j]))
        shapes = moved_shapes(part.shape, series.camera, outline_px)
        outline = outline or [np.zeros((rows, 3)) for _ in shapes]
        for total, shape in zip(outline, shapes, strict=True):
            total += moved(part, part.on(shape, grid.step_deg))
        brighter = moved(part, Moves.of_light(len(part.rows)))
        white += np.einsum("mkc,mc->mk", to**2, (brighter * scale.std[number]) ** 2)
    columns = [column for lamp in lamps.values() for column in lamp] + outline
    geometry = np.zeros((rows, 3))
    for column in columns:
        geometry += np.einsum("mkc,mc->mk", to, column) ** 2
    common = abs(np.nan_to_num(nodes.value[fit.cell])) * scale.common_std
    white += np.einsum("mkc,mc->mk", to, common) ** 2
    return SharedErrors(_on_grid(geometry, fit, nodes), _on_grid(white, fit, nodes))


def _on_grid(variance: Floats, fit: RobustFit, nodes: NodeValues) -> Floats:
    out = np.full(nodes.value.shape, np.nan)
    out[fit.cell] = np.sqrt(variance)
    return np.where(np.isfinite(nodes.value), out, np.nan)
