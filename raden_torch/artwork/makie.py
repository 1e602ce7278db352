"""The lid of a maki-e box: chrysanthemums by a stream, butterflies and cherry petals over them.

Black urushi, raden of four shells, gold lines, and gold powder that thins out from the lower left
to the upper right. The layout is that of lids in museums: flowers from below, a free field above,
one thing alive in it (docs/shells.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.artwork.cutting import PieceMaps, cut
from raden_torch.artwork.flowers import (
    butterfly,
    cherry_blossom,
    cherry_petal,
    chrysanthemum,
    crushed,
    leaf,
    sideways_chrysanthemum,
    slips,
)
from raden_torch.artwork.gold import Stroke, drawn, powder
from raden_torch.artwork.pieces import ShellPiece

LID = (1.4, 1.0)
"""Half the lid's width and height."""

_LEAVES = (
    # root, length, angle in degrees, shell
    (-0.93, -0.30, 0.30, 205, "awabi"),
    (-0.86, 0.42, 0.30, 125, "awabi"),
    (-0.40, 0.52, 0.27, 68, "mexican"),
    (-0.20, -0.44, 0.30, 238, "awabi"),
    (0.33, -0.18, 0.28, 48, "awabi"),
    (0.42, -0.50, 0.25, -8, "mexican"),
    (0.10, 0.30, 0.20, 20, "awabi"),
    (-0.62, -0.52, 0.26, 262, "mexican"),
)
_PETALS = (
    # loose cherry petals in the wind: root, size, angle in degrees
    (0.42, 0.20, 0.095, 200),
    (0.60, 0.00, 0.080, 120),
    (0.88, -0.06, 0.090, 250),
    (1.10, 0.30, 0.080, 30),
    (0.98, -0.32, 0.085, 160),
    (0.74, -0.26, 0.070, 310),
    (0.30, 0.80, 0.080, 240),
    (0.52, 0.60, 0.070, 20),
)


@dataclass(frozen=True, eq=False)
class LidMaps:
    """The lid's decoration at every sample.

    Attributes:
        shell: the pieces of raden.
        gold: `[1, H, W]` density of gold 0…1 on what is not shell.
    """

    shell: PieceMaps
    gold: Tensor


def lid(x: Tensor, y: Tensor, pixel: float, *, seed: int = 7) -> LidMaps:
    """The decoration at x, y on the lid, |x| ≤ 1.4 and |y| ≤ 1.

    Args:
        x, y: `[H, W]` floating-point coordinates, y up; rows and columns nearly along them.
        pixel: size of a sample in the same unit.
        seed: draws the shell, the powder and what is strewn; the drawing is fixed.
    """
    shell = cut(list(lid_pieces(seed)), x, y, pixel, seed=seed)
    lines = drawn(list(_strokes()), x, y, pixel)
    mist = _mist(x, y)
    strewn = powder(mist, x, y, pixel, flake=0.0034, seed=seed)
    coarse = powder(0.2 * mist**1.5, x, y, pixel, flake=0.009, seed=seed + 100)
    gold = 1 - (1 - lines) * (1 - strewn) * (1 - coarse)
    return LidMaps(shell, gold[None])


def lid_pieces(seed: int = 7) -> Iterator[ShellPiece]:
    """All pieces of shell, the first on top."""
    yield from butterfly(0.80, 0.56, 0.30, math.radians(155), shell="mexican")
    yield from butterfly(1.10, 0.02, 0.17, math.radians(115), shell="awabi", spots="mexican")
    yield from chrysanthemum(-0.55, 0.06, 0.45, 17)
    yield from chrysanthemum(0.10, -0.36, 0.31, 15, shell="mexican", heart="akoya", turn=0.2)
    yield from sideways_chrysanthemum(-0.08, 0.44, 0.30, math.radians(72), shell="yakogai")
    yield from sideways_chrysanthemum(-1.12, 0.10, 0.20, math.radians(120), shell="akoya")
    for x, y, length, degrees, shell in _LEAVES:
        yield from leaf(x, y, length, math.radians(degrees), shell=shell)
    yield from cherry_blossom(0.52, 0.30, 0.125, turn=0.5)
    for x, y, size, degrees in _PETALS:
        yield cherry_petal(x, y, size, math.radians(degrees), "akoya")
    yield from crushed(_along_the_stream(seed), 0.0065, shell="mexican", seed=seed)
    yield from _border()


def _border(at: float = 0.045) -> Iterator[ShellPiece]:
    wide, high = LID[0] - at, LID[1] - at
    corners = ((-wide, -high), (wide, -high), (wide, high), (-wide, high))
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        inset = 0.012 / math.dist(start, end)
        a = tuple(p + inset * (q - p) for p, q in zip(start, end, strict=True))
        b = tuple(q + inset * (p - q) for p, q in zip(start, end, strict=True))
        count = round(math.dist(start, end) / 0.045)
        yield from slips(
            (a[0], a[1]), (b[0], b[1]), count, 0.014, ("yakogai", "mexican", "yakogai", "awabi")
        )


def _strokes() -> Iterator[Stroke]:
    """Stems, tendrils, the stream, feelers, and the lines along the border."""
    yield Stroke([(-1.18, -0.95), (-0.98, -0.62), (-0.82, -0.30), (-0.74, -0.16)], 0.013, 0.007)
    yield Stroke([(-1.02, -0.70), (-1.12, -0.35), (-1.11, 0.0), (-1.12, 0.09)], 0.009, 0.005)
    yield Stroke([(-0.9, -0.95), (-0.55, -0.72), (-0.2, -0.55), (-0.05, -0.46)], 0.011, 0.006)
    yield Stroke([(-0.40, 0.24), (-0.34, 0.34), (-0.22, 0.42), (-0.09, 0.43)], 0.009, 0.005)
    for x, y, length, degrees, _ in _LEAVES:
        a = math.radians(degrees)
        back, far = -0.22 * length, 1.04 * length
        yield Stroke(
            [
                (x + back * math.cos(a + 0.3), y + back * math.sin(a + 0.3)),
                (x, y),
                (x + far * math.cos(a), y + far * math.sin(a)),
            ],
            0.0055,
            0.002,
        )
    yield from _stream()
    for bx, by, size, a in (
        (0.80, 0.56, 0.30, math.radians(155)),
        (1.10, 0.02, 0.17, math.radians(115)),
    ):
        for side in (-1, 1):
            yield Stroke(
                [
                    (
                        bx + size * (f * math.cos(a) - s * math.sin(a)),
                        by + size * (f * math.sin(a) + s * math.cos(a)),
                    )
                    for f, s in (
                        (0.28, 0.0),
                        (0.48, 0.07 * side),
                        (0.66, 0.20 * side),
                        (0.68, 0.28 * side),
                    )
                ],
                0.0025,
                0.004,
            )
    for inset in (0.026, 0.066):
        w, h = LID[0] - inset, LID[1] - inset
        for p, q in (
            ((-w, -h), (w, -h)),
            ((w, -h), (w, h)),
            ((w, h), (-w, h)),
            ((-w, h), (-w, -h)),
        ):
            yield Stroke([p, q], 0.0035, 0.0035)


def _stream() -> Iterator[Stroke]:
    """Flowing water: lines that swell and thin out, and an eddy."""
    for k, (left, right) in enumerate(
        ((0.12, 1.20), (0.34, 1.29), (0.22, 0.98), (0.52, 1.30), (0.44, 1.12), (0.74, 1.29))
    ):
        points = []
        for step in range(15):
            x = left + (right - left) * step / 14
            lift = 0.034 * math.sin(5.2 * x + 0.45 * k) + 0.10 * (x - 0.1) ** 2
            points.append((x, -0.87 + 0.052 * k + lift))
        yield Stroke(points[:8], 0.0015, 0.0075)
        yield Stroke(points[7:], 0.0075, 0.0015)
    spiral = []
    for step in range(24):
        angle, r = 0.3 + 0.42 * step, 0.062 * (1 - 0.85 * step / 23)
        spiral.append((1.10 + 1.35 * r * math.cos(angle), -0.37 + 0.8 * r * math.sin(angle)))
    yield Stroke([(0.86, -0.52), (1.02, -0.47), (1.16, -0.42), *spiral], 0.003, 0.003)


def _mist(x: Tensor, y: Tensor) -> Tensor:
    """Density of strewn gold: thick at the lower left, a drifting band above, none at the right."""
    toward = (
        0.55 * (x / LID[0]) + 0.85 * y + 0.10 * torch.sin(2.6 * x + 0.6) + 0.05 * torch.sin(6.1 * x)
    )
    ground = torch.sigmoid(-(toward + 0.78) / 0.16)
    band = torch.exp(-(((toward - 0.62) / 0.13) ** 2)) * torch.sigmoid(-(x - 0.05) / 0.28)
    density = (0.62 * ground + 0.26 * band).clamp(0, 1)
    return torch.where(density > 0.004, density, 0.0)


def _along_the_stream(seed: int, count: int = 260) -> Tensor:
    """`[N, 2]` places of crushed shell: dense between the stream's lines, thinning upward."""
    generator = torch.Generator().manual_seed(seed)
    a, b, c = torch.rand(3, count, generator=generator, dtype=torch.float64)
    x = 0.42 + 0.86 * a
    y = -0.86 + 0.02 * (x - 0.4) + 0.34 * b * c
    return torch.stack([x, y], dim=1)
