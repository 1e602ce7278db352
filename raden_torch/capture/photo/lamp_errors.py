"""How well chrome balls tell a lamp's direction: by the edge of each ball and of the lamp's image.

Each is moved by its standard deviation, the lamps are found again, and the squares of what changes
add up. An error of a ball is in all lamps alike, one of a highlight in its lamp alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.ball import Ball, outline_moves
from raden_torch.capture.photo.highlight import Highlight
from raden_torch.capture.photo.lamps import Lamps, lamps_from_balls


def direction_std_deg(
    lamps: Lamps, balls: Sequence[Ball], highlights: Sequence[Sequence[Highlight]]
) -> Floats:
    """`[K]` standard deviation (k = 1) of each lamp's direction, in each of two directions across.

    Args:
        lamps: as they were found.
        balls: B of them.
        highlights: `[K][B]`.
    """
    square = np.zeros(len(lamps))
    for moved_balls, moved_highlights in _moved(balls, highlights):
        found = lamps_from_balls(moved_balls, moved_highlights, unit=lamps.unit)
        square += ((found.direction - lamps.direction) ** 2).sum(axis=1) / 2
    return np.degrees(np.sqrt(square))


def highlight_std_px(area_px: int) -> float:
    """Of the centroid of a clipped disc, in each direction: the pixels along its edge, 2πρ of
    them, each take part or not, by 1/√12 of a pixel at most; √(πρ) ρ / (√12 πρ²)."""
    radius = np.sqrt(max(area_px, 1) / np.pi)
    return float(1 / np.sqrt(12 * np.pi * radius))


def _moved(
    balls: Sequence[Ball], highlights: Sequence[Sequence[Highlight]]
) -> Iterator[tuple[list[Ball], list[list[Highlight]]]]:
    whole = [list(row) for row in highlights]
    for b, ball in enumerate(balls):
        for there in _moved_ball(ball):
            yield [there if i == b else other for i, other in enumerate(balls)], whole
        for axis in ("x_px", "y_px"):
            moved = [
                [
                    replace(h, **{axis: getattr(h, axis) + highlight_std_px(h.area_px)})
                    if i == b
                    else h
                    for i, h in enumerate(row)
                ]
                for row in highlights
            ]
            yield list(balls), moved


def _moved_ball(ball: Ball) -> list[Ball]:
    """By its standard deviation."""
    is_near = ball.matrix is not None
    moves = outline_moves(ball.centre, ball.radius, ball.radius_px, ball.std_px, is_near=is_near)
    return [replace(ball, centre=centre, radius=radius) for centre, radius in moves]
