"""A grid continued by a few nodes on every side, so that wide kernels find neighbours there."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats

PAD = 3
"""Nodes added on every side: a six-value kernel needs two, and receiving may lie one outside."""


def padded(values: Floats, *, mirrored: bool) -> Floats:
    """`[A, R, T, C]` → `[A + 2·PAD, R + 2·PAD, T + 2·PAD, C]`.

    Below incidence 0 the grid goes on into its equivalent, f(−a, r, t) = f(a, −r, −t), where
    `mirrored` (incidence starts at 0, receiving and tilt are symmetric). Elsewhere it goes on
    straight along the mirror ridge, what the ridge does not reach takes its neighbour's value, and
    the tilt goes on straight.
    """
    a, r, t, channels = values.shape
    grid = np.full((a + 2 * PAD, r + 2 * PAD, t, channels), np.nan)
    grid[PAD : PAD + a, PAD : PAD + r] = values
    if mirrored:
        for k in range(1, min(PAD, a - 1) + 1):
            grid[PAD - k, PAD : PAD + r] = values[k][::-1, ::-1]
    for turn in range(4 * PAD):
        _along_the_ridge(grid)
        if turn >= PAD:
            _from_neighbours(grid)
    steps = np.arange(1.0, PAD + 1)[:, None]
    low = grid[:, :, :1] + (grid[:, :, :1] - grid[:, :, 1:2]) * steps[::-1]
    high = grid[:, :, -1:] + (grid[:, :, -1:] - grid[:, :, -2:-1]) * steps
    return np.concatenate([low, grid, high], axis=2)


def _along_the_ridge(grid: Floats) -> None:
    """One more node at both ends of every line of constant r − a, straight on."""
    up, down = np.full_like(grid, np.nan), np.full_like(grid, np.nan)
    up[2:, 2:] = 2 * grid[1:-1, 1:-1] - grid[:-2, :-2]
    down[:-2, :-2] = 2 * grid[1:-1, 1:-1] - grid[2:, 2:]
    for new in (up, down):
        _take(grid, new)


def _from_neighbours(grid: Floats) -> None:
    """What has a neighbour along receiving or incidence takes its value."""
    for axis in (1, 0):
        for sign in (1, -1):
            line = np.moveaxis(grid, axis, 0)[::sign]
            new = np.full_like(line, np.nan)
            new[1:] = line[:-1]
            _take(line, new)


def _take(grid: Floats, new: Floats) -> None:
    missing = np.isnan(grid[..., 0, 0]) & ~np.isnan(new[..., 0, 0])
    grid[missing] = new[missing]
