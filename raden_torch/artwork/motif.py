"""A raden motif made by code: chrysanthemums, leaves and a border, cut as separate pieces of shell.

Every piece is a signed distance on the plate (positive inside), so that its edge can be
anti-aliased at any resolution. Neighbouring pieces leave a gap of lacquer, as cut shell does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

Distance = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class ShellPiece:
    """One piece of shell: its signed distance (positive inside), and a circle that holds it."""

    distance: Distance
    x: float
    y: float
    reach: float


_LEAN_DEG = 3.0  # how far the film planes of one piece lean against those of the next


def inlay(x: Tensor, y: Tensor, pixel: float, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Coverage and lean of the shell pieces on a plate that spans −1…1.

    Args:
        x, y: `[H, W]` coordinates on the plate.
        pixel: size of a sample in the same unit; edges are a sample wide.
        seed: draws the lean of the pieces.

    Returns:
        `[H, W]` coverage 0…1, and `[2, H, W]` slopes by which the piece's planes lean.
    """
    generator = torch.Generator().manual_seed(seed)
    coverage = torch.zeros_like(x)
    lean = torch.zeros(2, *x.shape, dtype=x.dtype, device=x.device)
    spans = [(c.amin(dim), c.amax(dim)) for c, dim in ((x, 1), (y, 1), (x, 0), (y, 0))]
    for piece in pieces():
        slope = torch.randn(2, 1, 1, generator=generator, dtype=torch.float64).to(lean)
        slope = slope * math.tan(math.radians(_LEAN_DEG))
        near = [
            (low < at + piece.reach + pixel) & (high > at - piece.reach - pixel)
            for (low, high), at in zip(spans, (piece.x, piece.y) * 2, strict=True)
        ]
        rows, columns = _extent(near[0] & near[1]), _extent(near[2] & near[3])
        part = (piece.distance(x[rows, columns], y[rows, columns]) / pixel + 0.5).clamp(0, 1)
        on_top = part > coverage[rows, columns]
        lean[:, rows, columns] = torch.where(on_top, slope, lean[:, rows, columns])
        coverage[rows, columns] = torch.maximum(coverage[rows, columns], part)
    return coverage, lean


def _extent(near: Tensor) -> slice:
    """The slice from the first to the last True."""
    found = near.nonzero()
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, 0)


def pieces() -> Iterator[ShellPiece]:
    """All pieces of the motif."""
    yield from _chrysanthemum(-0.18, 0.12, 0.46, petals=16)
    yield from _chrysanthemum(0.48, -0.38, 0.25, petals=14)
    yield from _chrysanthemum(0.46, 0.50, 0.15, petals=12)
    for x, y, length, angle in (
        (-0.50, -0.48, 0.30, 215),
        (-0.30, -0.60, 0.26, 262),
        (-0.66, -0.26, 0.22, 178),
        (0.20, 0.66, 0.20, 120),
        (0.70, 0.18, 0.20, 60),
        (0.12, -0.62, 0.20, 300),
    ):
        yield from _leaf(x, y, length, math.radians(angle))
    yield from _border()


def _chrysanthemum(cx: float, cy: float, radius: float, petals: int) -> Iterator[ShellPiece]:
    for ring, (inner, outer, turn) in enumerate(((0.56, 1.0, 0.0), (0.22, 0.54, 0.5))):
        count = petals if ring == 0 else petals * 3 // 4
        middle, half = (outer + inner) / 2 * radius, (outer - inner) / 2 * radius
        width = 0.86 * math.pi / count * middle
        for k in range(count):
            angle = 2 * math.pi * (k + turn) / count
            x, y = cx + middle * math.cos(angle), cy + middle * math.sin(angle)
            yield _ellipse(x, y, half, width, angle)
    yield _ellipse(cx, cy, 0.17 * radius, 0.17 * radius, 0.0)


def _leaf(cx: float, cy: float, length: float, angle: float) -> Iterator[ShellPiece]:
    """Two halves, parted at the midrib."""
    for side in (-1.0, 1.0):
        yield _half_lens(cx, cy, length, angle, side)


def _border(count: int = 22, at: float = 0.90, width: float = 0.018) -> Iterator[ShellPiece]:
    """Slips of shell along the four sides."""
    pitch = 2 * at / count
    for k in range(count):
        along = -at + (k + 0.5) * pitch
        for x, y in ((along, at), (along, -at), (at, along), (-at, along)):
            wide, high = (0.42 * pitch, width) if abs(y) == at else (width, 0.42 * pitch)
            yield _box(x, y, wide, high)


def _ellipse(cx: float, cy: float, a: float, b: float, angle: float) -> ShellPiece:
    def distance(x: Tensor, y: Tensor) -> Tensor:
        u, v = _turned(x - cx, y - cy, angle)
        return (1 - torch.sqrt((u / a) ** 2 + (v / b) ** 2)) * min(a, b)

    return ShellPiece(distance, cx, cy, max(a, b))


def _half_lens(cx: float, cy: float, length: float, angle: float, side: float) -> ShellPiece:
    bulge, gap = 0.34 * length, 0.008

    def distance(x: Tensor, y: Tensor) -> Tensor:
        u, v = _turned(x - cx, y - cy, angle)
        edge = bulge * (1 - (u / (length / 2)) ** 2) / 1.6
        return torch.minimum(edge - side * v, side * v - gap)

    return ShellPiece(distance, cx, cy, length)


def _box(cx: float, cy: float, a: float, b: float) -> ShellPiece:
    return ShellPiece(
        lambda x, y: torch.minimum(a - (x - cx).abs(), b - (y - cy).abs()), cx, cy, math.hypot(a, b)
    )


def _turned(x: Tensor, y: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    c, s = math.cos(angle), math.sin(angle)
    return c * x + s * y, c * y - s * x
