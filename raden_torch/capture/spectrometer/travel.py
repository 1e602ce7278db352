"""In which order should positions be visited, and how far does the rig travel?

Travel is counted as the sum over the three axes, in degrees: what wears the stages, and what the
time is where axes move one after another. Stages that move together take the time of their longest
axis, `longest_axis_deg`. The short overshoot that takes up backlash is not counted.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats

Order = NDArray[np.intp]

_MAX_FOR_TOUR = 1500  # positions; the search is quadratic


def travel_deg(positions: Floats) -> float:
    """Degrees from the first to the last of `[M, 3]` positions, summed over the axes."""
    return float(abs(np.diff(positions, axis=0)).sum())


def longest_axis_deg(positions: Floats) -> Floats:
    """`[M − 1]`: of each move, the degrees of the axis that moves furthest."""
    return np.asarray(abs(np.diff(positions, axis=0)).max(axis=1))


def short_order(positions: Floats) -> Order:
    """The order in which to visit `[M, 3]` positions so that little is travelled.

    To and fro along the rows of the grid (of slabs, where the positions are scattered), with the
    axes nested in the best of the six ways; few positions are also tried as a tour. On a full grid
    every move is one step of one axis, and no order is shorter.
    """
    candidates = [_to_and_fro(positions, axes) for axes in permutations(range(3))]
    if len(positions) <= _MAX_FOR_TOUR:
        candidates.append(_tour(positions))
    return min(candidates, key=lambda order: travel_deg(positions[order]))


def _to_and_fro(positions: Floats, axes: tuple[int, ...]) -> Order:
    """Rows along the last of the axes, each walked against the one before it."""
    outer, middle, inner = (positions[:, axis] for axis in axes)
    outer, middle = _slabs(outer), _slabs(middle)
    rows: list[Order] = []
    for i, plane in enumerate(np.unique(outer)):
        in_plane = np.flatnonzero(outer == plane)
        lines = np.unique(middle[in_plane])
        for line in lines if i % 2 == 0 else lines[::-1]:
            row = in_plane[middle[in_plane] == line]
            row = row[np.argsort(inner[row], kind="stable")]
            rows.append(row if len(rows) % 2 == 0 else row[::-1])
    return np.concatenate(rows)


def _slabs(angle: Floats) -> Floats:
    """The angles themselves where they repeat, as on a grid; else a coarse rounding of them."""
    most = max(1, round(len(angle) ** (1 / 3)))
    if len(np.unique(angle)) <= 3 * most:
        return angle
    width = np.ptp(angle) / most
    return np.asarray(np.floor((angle - angle.min()) / width))


def _tour(positions: Floats) -> Order:
    """The nearest position next, then 2-opt: turn stretches round while that shortens the way."""
    distance = abs(positions[:, None] - positions[None]).sum(axis=-1)
    order = _nearest_next(distance)
    count = len(order)
    improved = True
    while improved:
        improved = False
        for i in range(count - 2):
            here, after = order[i], order[i + 1]
            ends, beyond = order[i + 2 : count - 1], order[i + 3 : count]
            now = distance[here, after] + distance[ends, beyond]
            gain = now - distance[here, ends] - distance[after, beyond]
            if len(gain) and gain.max() > 1e-9:
                j = i + 2 + int(gain.argmax())
                order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1]
                improved = True
    return order


def _nearest_next(distance: Floats) -> Order:
    count = len(distance)
    order = np.zeros(count, np.intp)
    free = np.ones(count, bool)
    free[0] = False
    for i in range(1, count):
        order[i] = np.argmin(np.where(free, distance[order[i - 1]], np.inf))
        free[order[i]] = False
    return order
