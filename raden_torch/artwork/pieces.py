"""Pieces of shell and strokes of gold as signed distances on a plate, so that any size has edges.

A shape is an implicit function, positive inside; `outline` makes the distance to its edge of it, to
first order: f / |∇f|. Lengths are in the plate's unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

Distance = Callable[[Tensor, Tensor], Tensor]

_STEP = 1e-4  # for the differences in `outline`


@dataclass(frozen=True)
class ShellPiece:
    """One piece of shell.

    Attributes:
        distance: signed distance to its edge at x, y, positive inside.
        x, y, reach: a circle that holds it.
        shell: of which shell it is cut, a name of `optics.SPECIMENS`.
        engraved: distance to the nearest line engraved in it, at least 0; None: there is none.
    """

    distance: Distance
    x: float
    y: float
    reach: float
    shell: str = "yakogai"
    engraved: Distance | None = None


def outline(f: Distance) -> Distance:
    """The distance to the edge f = 0, to first order; exact on the edge."""

    def distance(x: Tensor, y: Tensor) -> Tensor:
        here = f(x, y)
        slope_x, slope_y = f(x + _STEP, y) - here, f(x, y + _STEP) - here
        return here / (torch.hypot(slope_x, slope_y) / _STEP).clamp(min=1e-3)

    return distance


def placed(f: Distance, cx: float, cy: float, angle: float) -> Distance:
    """`f` of u, v with its origin at cx, cy and u along `angle`."""
    return lambda x, y: f(*turned(x - cx, y - cy, angle))


def turned(x: Tensor, y: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    """Coordinates along and across `angle`."""
    c, s = math.cos(angle), math.sin(angle)
    return c * x + s * y, c * y - s * x


def ellipse(
    cx: float, cy: float, a: float, b: float, angle: float, shell: str = "yakogai"
) -> ShellPiece:
    def inside(u: Tensor, v: Tensor) -> Tensor:
        return 1 - torch.sqrt((u / a) ** 2 + (v / b) ** 2)

    return ShellPiece(outline(placed(inside, cx, cy, angle)), cx, cy, max(a, b), shell)


def box(
    cx: float, cy: float, a: float, b: float, angle: float = 0.0, shell: str = "yakogai"
) -> ShellPiece:
    """A rectangle of half sides a and b."""

    def distance(u: Tensor, v: Tensor) -> Tensor:
        return torch.minimum(a - u.abs(), b - v.abs())

    return ShellPiece(placed(distance, cx, cy, angle), cx, cy, math.hypot(a, b), shell)


def polygon(corners: list[tuple[float, float]], shell: str = "yakogai") -> ShellPiece:
    """A convex polygon, its corners counter-clockwise."""
    cx = sum(x for x, _ in corners) / len(corners)
    cy = sum(y for _, y in corners) / len(corners)
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))

    def distance(x: Tensor, y: Tensor) -> Tensor:
        nearest = torch.full_like(x, math.inf)
        for (x0, y0), (x1, y1) in sides:
            length = math.hypot(x1 - x0, y1 - y0)
            inward = ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length
            nearest = torch.minimum(nearest, inward)
        return nearest

    reach = max(math.hypot(x - cx, y - cy) for x, y in corners)
    return ShellPiece(distance, cx, cy, reach, shell)


class Windows:
    """Finds the part of x, y `[H, W]` that something small can touch.

    Rows lie nearly along x and columns along y: what a row or a column spans is compared.
    """

    def __init__(self, x: Tensor, y: Tensor) -> None:
        self._rows = [(c.amin(1), c.amax(1)) for c in (x, y)]
        self._columns = [(c.amin(0), c.amax(0)) for c in (x, y)]

    def near(self, points: Tensor, margin: float) -> tuple[slice, slice]:
        """The rows and columns that come within a margin of points `[N, 2]`."""
        low, high = points.amin(0) - margin, points.amax(0) + margin

        def extent(spans: list[tuple[Tensor, Tensor]]) -> slice:
            (x_first, x_last), (y_first, y_last) = spans
            over_x = (x_first < high[0]) & (x_last > low[0])
            return _extent(over_x & (y_first < high[1]) & (y_last > low[1]))

        return extent(self._rows), extent(self._columns)


def _extent(found: Tensor) -> slice:
    """The slice from the first to the last True."""
    at = found.nonzero()
    return slice(int(at[0]), int(at[-1]) + 1) if len(at) else slice(0, 0)
