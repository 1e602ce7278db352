"""Gold of maki-e: drawn lines, and powder strewn over lacquer, as maps of density.

Where a sample is smaller than a flake, powder is single flakes; where it is larger, their mean, so
that the density holds at any resolution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from raden_torch.artwork.pieces import Windows

_AT_ONCE = 6  # parts of a curve that are drawn in one window
_REACH = 1.5
_LAYERS = 3  # of flakes over each other
_RADIUS = (0.35, 0.70)  # smallest and largest, over the cell's side


@dataclass(frozen=True)
class Stroke:
    """A line of the brush: a smooth curve through points, its width from start to end."""

    points: Sequence[tuple[float, float]]
    start: float = 0.006
    end: float = 0.003


def drawn(strokes: Sequence[Stroke], x: Tensor, y: Tensor, pixel: float) -> Tensor:
    """`[H, W]` density 0…1 of drawn gold, anti-aliased; x and y as for `cutting.cut`."""
    density, windows = torch.zeros_like(x), Windows(x, y)
    for stroke in strokes:
        at = curve(stroke.points)
        width = torch.linspace(stroke.start, stroke.end, len(at), dtype=at.dtype)
        for k in range(0, len(at) - 1, _AT_ONCE):
            part = slice(k, k + _AT_ONCE + 1)
            margin = float(width[part].max()) + 2 * pixel
            window = windows.near(at[part], margin)
            inside = _inside(at[part].tolist(), width[part].tolist(), x[window], y[window])
            own = (inside / pixel + 0.5).clamp(0, 1)
            density[window] = torch.maximum(density[window], own)
    return density


def curve(points: Sequence[tuple[float, float]], steps: int = 12) -> Tensor:
    """`[N, 2]` a Catmull-Rom spline through the points."""
    p = torch.tensor(list(points), dtype=torch.float64)
    p = torch.cat([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = (torch.arange(steps, dtype=torch.float64) / steps).view(1, -1, 1)
    a, b, c, d = (p[k : len(p) - 3 + k, None] for k in range(4))
    spans = 0.5 * (
        2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3
    )
    return torch.cat([spans.reshape(-1, 2), p[-2:-1]])


def _inside(at: list[list[float]], width: list[float], x: Tensor, y: Tensor) -> Tensor:
    """Signed distance to the edge of a line through points, positive inside."""
    best = torch.full_like(x, -math.inf)
    for k, ((x0, y0), (x1, y1)) in enumerate(pairwise(at)):
        dx, dy = x1 - x0, y1 - y0
        square = max(dx * dx + dy * dy, 1e-18)
        t = (((x - x0) * dx + (y - y0) * dy) / square).clamp(0, 1)
        away = torch.hypot(x - x0 - t * dx, y - y0 - t * dy)
        best = torch.maximum(best, (width[k] + t * (width[k + 1] - width[k])) / 2 - away)
    return best


def powder(
    density: Tensor, x: Tensor, y: Tensor, pixel: float, *, flake: float, seed: int
) -> Tensor:
    """`[H, W]` coverage by flakes of a mean density 0…1, as a sample averages them.

    One flake may lie in each cell of a grid of side `flake`, anywhere in it, with a radius drawn
    for it; it does where a draw is below the density.

    Args:
        density: `[H, W]` wanted share of the area, 0…1.
        flake: side of a cell; a flake is about as large.
        seed: draws the flakes.
    """
    strewn = density > 0
    sharp = min(1.0, max(0.0, 1.25 - pixel / flake))
    bare = torch.ones_like(density[strewn])
    layer = 1 - (1 - density[strewn].clamp(0, 1)) ** (1 / _LAYERS)  # what each has to cover
    for k in range(_LAYERS):
        u, v = x[strewn] / flake + k / _LAYERS, y[strewn] / flake - k / _LAYERS
        bare *= 1 - _flakes(layer, u, v, pixel / flake, seed + 10 * k)
    covered = density.clone()
    covered[strewn] = sharp * (1 - bare) + (1 - sharp) * density[strewn]
    return covered


def _flakes(density: Tensor, u: Tensor, v: Tensor, pixel: float, seed: int) -> Tensor:
    """One layer of flakes over a grid of cells of side 1, each within 0.7 of its cell's middle."""
    column, row = torch.floor(u - 0.5), torch.floor(v - 0.5)
    covered, filled = torch.zeros_like(u), _filled(density)
    for down in (0, 1):
        for right in (0, 1):
            i, j = column + right, row + down
            shift_u, shift_v, size, chance = _draws(i, j, seed)
            radius = _RADIUS[0] + (_RADIUS[1] - _RADIUS[0]) * size
            away = torch.hypot(u - i - 0.2 - 0.6 * shift_u, v - j - 0.2 - 0.6 * shift_v)
            own = ((radius - away) / pixel + 0.5).clamp(0, 1)
            covered = torch.maximum(covered, own * (chance < filled))
    return covered


def _filled(density: Tensor) -> Tensor:
    """The share of cells that hold a flake, for a layer to cover this share of the area.

    A place lies within the reach of some m cells: 1 − d = (1 − share · area / m)^m. That m = 1.5 is
    found by counting: it holds within 0.01 from 0.05 to 0.9 for three layers.
    """
    low, high = _RADIUS
    mean_area = math.pi * (low * low + low * high + high * high) / 3
    return _REACH * (1 - (1 - density) ** (1 / _REACH)) / mean_area


def _draws(i: Tensor, j: Tensor, salt: int) -> list[Tensor]:
    """Four draws 0…1 for each whole i and j: bits of both, mixed."""
    n = (i.long() * 73856093) ^ (j.long() * 19349663) ^ (salt * 83492791)
    for _ in range(2):
        n = ((n ^ (n >> 31)) * 0x3F58476D1CE4E5B9) ^ (n << 7)
    return [((n >> shift) & 0xFFFF).to(i) / 2**16 for shift in (0, 16, 32, 47)]


def flake_slopes(x: Tensor, y: Tensor, pixel: float, *, flake: float, seed: int) -> Tensor:
    """`[2, H, W]` slopes of variance 1 that are one flake's each; their mean where samples are
    larger than a flake.

    Flakes lie otherwise each, so that powder glitters.
    """
    draws = _draws(torch.floor(x / flake), torch.floor(y / flake), seed)
    # the sum of two even draws, with mean 0 and variance 1
    slopes = [(draws[k] + draws[k + 2] - 1) * math.sqrt(6) for k in (0, 1)]
    return torch.stack(slopes) * min(1.0, flake / pixel)
