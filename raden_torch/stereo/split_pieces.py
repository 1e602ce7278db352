"""Pieces of different shells that touch, told apart by which shell explains their pixels.

Each pixel, with its own layers, is compared with every shell; what is left is averaged over a
neighbourhood, and the shell that leaves least is that pixel's. A piece is cut where a coherent part
of it is explained clearly better by another shell than the piece's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.arrays import Floats
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.stereo.photographed import Photographed
from raden_torch.stereo.pieces import numbered
from raden_torch.stereo.solve import learnt, solve_by_model

_MOST = 20_000
"""Pixels that are compared, on a grid over the whole."""
_AROUND = 5
"""Of the grid's nodes across, over which a residual is averaged."""
_LEAST_NODES = 16
_CLEARLY = 0.7
"""A part's residual with its own shell, over that with the piece's."""


@torch.no_grad()
def split_pieces(
    seen: Photographed,
    shells: Sequence[Reflection],
    pieces: NDArray[np.int32],
    surface: Tensor,
    smallest_px: int,
    done: Callable[[float], None],
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The pieces, numbered anew by falling area, and the shell that fits each best, from 0.

    Args:
        pieces: `[H, W]` numbers from 1, 0 for the ground.
        surface: `[3, H·W]` unit normals of the polished surface.
        smallest_px: a part of fewer pixels is none.
        done: called with the share that is done, 0…1.
    """
    step = max(1, math.ceil(math.sqrt((pieces > 0).sum() / _MOST)))
    coarse = np.ascontiguousarray(pieces[::step, ::step])
    left = _residuals(seen, shells, coarse, pieces.shape[1], step, surface, done)
    best = np.argmin(left, axis=0)
    shell = np.zeros(coarse.shape, np.int64)
    fewest = max(_LEAST_NODES, smallest_px / step**2)
    own = np.zeros(int(pieces.max()) + 1, np.int64)
    for number in range(1, len(own)):
        of = coarse == number
        if not of.any():
            continue
        usual = own[number] = int(np.argmin(left[:, of].mean(1)))
        shell[of] = usual
        for other in set(np.unique(best[of])) - {usual}:
            for part in _parts(of & (best == other)):
                clearly = left[other, part].mean() < _CLEARLY * left[usual, part].mean()
                if part.sum() >= fewest and clearly:
                    shell[part] = other
    whole = np.repeat(np.repeat(shell, step, 0), step, 1)[: pieces.shape[0], : pieces.shape[1]]
    beside = np.repeat(np.repeat(coarse, step, 0), step, 1)[: pieces.shape[0], : pieces.shape[1]]
    whole = np.where(beside == pieces, whole, own[pieces])
    # neighbours of two pieces that are of one shell stay one, as they would on a map
    return numbered(np.where(pieces > 0, whole + 1, 0))


def _residuals(
    seen: Photographed,
    shells: Sequence[Reflection],
    coarse: NDArray[np.int32],
    width: int,
    step: int,
    surface: Tensor,
    done: Callable[[float], None],
) -> Floats:
    """`[shells, h, w]`, in standard deviations, averaged over a neighbourhood."""
    import cv2

    row, column = coarse.nonzero()
    index = torch.from_numpy(row * step * width + column * step)
    light = replace(seen.at(index), surface=surface[:, index])
    known = learnt(shells, light)
    inside = (coarse > 0).astype(np.float64)
    share = cv2.blur(inside, (_AROUND, _AROUND)).clip(1e-9)
    found = []
    for place, material in enumerate(shells):
        fit = solve_by_model([material], light, known=known)
        left = np.zeros(coarse.shape)
        left[row, column] = (2 * fit.cost / light.counted.clamp(min=1)).sqrt().numpy()
        found.append(cv2.blur(left, (_AROUND, _AROUND)) / share)
        done((place + 1) / len(shells))
    return np.stack(found)


def _parts(of: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    import cv2

    count, labels = cv2.connectedComponents(of.astype(np.uint8), connectivity=4)
    return [labels == k for k in range(1, count)]
