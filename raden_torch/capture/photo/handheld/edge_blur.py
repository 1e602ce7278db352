"""How sharp a picture of a board is, in pixels, along its rows and its columns.

The squares' edges are steps of known place and direction: how far the light of a white square
reaches into the black one beside it, in which nothing else is printed, is the blur across the edge.
A moving camera blurs edges across its way more than those along it, a lens out of focus all alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board import BoardView

_FEWEST = 8
_FRACTIONS = (0.3, 0.7)
"""Of an edge between two corners: its middle, as far from other edges as can be."""
_REACH = 0.45
"""Of an edge's length: how far into the black square the profile goes."""
_POINTS, _STEPS = 5, 40
_LEAST_STEP = 20.0
"""Of 255: a step lower than this is no edge of the print."""
_SHORTEST_PX = 8.0


@dataclass(frozen=True)
class Blur:
    """Standard deviations of the blur, pixels: the median over the edges, across those that the
    board's rows and columns run along. A sharp picture's are 0.4 to 0.8."""

    across_rows: float
    across_columns: float

    @property
    def worst_px(self) -> float:
        return max(self.across_rows, self.across_columns)

    @property
    def is_motion(self) -> bool:
        """Whether one way is blurred much more than the other."""
        least = min(self.across_rows, self.across_columns)
        return self.worst_px > 1.6 * max(least, 0.4)


def edge_blur(grey: NDArray[np.uint8], view: BoardView) -> Blur | None:
    """Of a picture `[H, W]` in which the board was found; None where too few edges are seen."""
    board = view.board
    per_row = board.columns - 1
    place = {int(number): k for k, number in enumerate(view.ids)}
    widths: list[list[float]] = [[], []]
    for number, k in place.items():
        column = number % per_row
        for axis, other in ((0, number + 1 if column + 1 < per_row else -1), (1, number + per_row)):
            if other in place:
                widths[axis] += _widths(grey, view.pixels[[k, place[other]]])
    if min(len(w) for w in widths) < _FEWEST:
        return None
    return Blur(*(float(np.median(w)) for w in widths))


def _widths(grey: NDArray[np.uint8], ends: Floats) -> list[float]:
    """Of profiles across the edge between two neighbouring corners: with a step that is blurred by
    a Gaussian, the slope's mean distance from it on one side is √(2/π) of the standard deviation.
    """
    import cv2

    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    if length < _SHORTEST_PX:
        return []
    way = np.array([-along[1], along[0]]) / length
    where = ends[0] + np.linspace(*_FRACTIONS, _POINTS)[:, None] * along
    offset = np.linspace(0, _REACH * length, _STEPS)
    found = []
    sides = []
    for side in (-1, 1):
        points = where[:, None] + side * offset[:, None] * way
        u, v = points.astype(np.float32).transpose(2, 0, 1)
        values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        sides.append(values.astype(np.float64))
    dark = int(sides[1][:, _STEPS // 4 :].mean() < sides[0][:, _STEPS // 4 :].mean())
    for profile, other in zip(sides[dark], sides[1 - dark], strict=True):
        if other.max() - profile.min() < _LEAST_STEP:
            continue
        slope = -np.diff(profile)
        slope = slope - np.median(slope[-_STEPS // 3 :])
        total = slope.sum()
        if total > 0:
            mean = float((slope * (offset[1:] + offset[:-1]) / 2).sum() / total)
            found.append(float(np.sqrt(np.pi / 2)) * max(mean, 0.0))
    return found
