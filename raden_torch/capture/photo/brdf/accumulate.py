"""Photographs → node values, one photograph in memory at a time, each read twice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.brdf.cell_fit import RobustFit, robust_fit
from raden_torch.capture.photo.brdf.cell_sums import CellSums, NodeValues
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_white import Scale, WhiteReading, scale_of
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.samples import SeenSurface, samples
from raden_torch.capture.photo.brdf.series import Frame, Shot
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class AccumulatedCells:
    """What the photographs hold together.

    Attributes:
        nodes: relative to the white, in camera RGB.
        scale: of each shot.
        kept: the chosen samples, relative to the white.
        fit: the robust fit to these.
        shots: `[K, cells]` samples of each shot in each cell.
        samples: how many there were.
        left_out: share of them that the robust fit left out.
    """

    nodes: NodeValues
    scale: Scale
    kept: Reservoir
    fit: RobustFit
    shots: NDArray[np.int32]
    samples: int
    left_out: float


def accumulate(
    shots: Sequence[Shot],
    lamps: Sequence[Lamp],
    see: Callable[[int], SeenSurface],
    read: Callable[[Shot], Frame],
    read_white: Callable[[int, Frame], WhiteReading | None],
    grid: CellGrid,
    *,
    progress: Callable[[float], None] | None = None,
    check: Callable[[Reservoir, RobustFit, Scale], None] | None = None,
) -> AccumulatedCells:
    """Read every photograph, choose samples, fit them robustly; read again and sum.

    Args:
        lamps: of each shot.
        see: what the pixels of shot k see of the sample.
        read: develops a shot.
        read_white: the white in a shot that was read.
        check: is shown the chosen samples and their fit before the second round; it may raise.

    Raises:
        InputError: as for reading; no lit sample at all; mixed exposure times.
    """
    done = progress or (lambda share: None)
    kept, readings = Reservoir.of(grid.cells), []
    timed: list[bool] = []
    for k, (shot, lamp) in enumerate(zip(shots, lamps, strict=True)):
        frame = read(shot)
        timed.append(frame.timed)
        if frame.timed != timed[0]:
            raise InputError(
                f"{shot.files[0]}: {'an' if frame.timed else 'no'} exposure time, but "
                f"{shots[0].name} has {'one' if timed[0] else 'none'}; state them for all"
            )
        readings.append(read_white(k, frame))
        for angles, value in samples(frame, see(k), lamp, lamp.rgb):
            rows, cell, x = grid.sort(angles)
            kept.add(cell, k, x, value[rows])
        done(0.5 * (k + 1) / len(shots))
    if not len(kept.cell):
        raise InputError(
            f"{shots[0].files[0]} … {shots[-1].name}: no lit, unsaturated pixel of the sample; "
            "over-exposed, or lamps behind it? Check the mask and the lights file"
        )
    scale = scale_of(readings, lamps, [shot.name for shot in shots])
    expected = np.array([lamp.rgb for lamp in lamps])
    kept.y *= (expected / scale.rgb)[kept.shot].astype(np.float32)
    fit = robust_fit(kept, grid)
    if check is not None:
        check(kept, fit, scale)
    sums = CellSums(fit)
    per_shot = np.zeros((len(shots), grid.cells), np.int32)
    for k, (shot, lamp) in enumerate(zip(shots, lamps, strict=True)):
        for angles, value in samples(read(shot), see(k), lamp, scale.rgb[k]):
            rows, cell, x = grid.sort(angles)
            sums.add(cell, x, value[rows])
            per_shot[k] += np.bincount(cell, minlength=grid.cells).astype(np.int32)
        done(0.5 + 0.5 * (k + 1) / len(shots))
    seen = max(int(sums.seen.sum()), 1)
    left_out = 1 - float(sums.count.sum()) / seen
    return AccumulatedCells(
        sums.nodes(grid), scale, kept, fit, per_shot, int(per_shot.sum()), left_out
    )
