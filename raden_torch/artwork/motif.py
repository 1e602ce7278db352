"""The plate's motif: chrysanthemums, leaves and a border, cut as separate pieces of shell."""

from __future__ import annotations

import math
from collections.abc import Iterator

from torch import Tensor

from raden_torch.artwork.cutting import PieceMaps, cut
from raden_torch.artwork.flowers import chrysanthemum, leaf, slips
from raden_torch.artwork.pieces import ShellPiece

_LEAVES = (
    # root, length, angle in degrees
    (-0.36, -0.30, 0.34, 215),
    (-0.20, -0.42, 0.32, 252),
    (-0.58, -0.12, 0.28, 190),
    (0.02, 0.56, 0.28, 62),
    (0.62, 0.34, 0.26, -62),
    (0.16, -0.46, 0.28, 238),
)


def inlay(x: Tensor, y: Tensor, pixel: float, seed: int = 0) -> PieceMaps:
    """The maps of the shell pieces on a plate that spans −1…1.

    Args:
        x, y: `[H, W]` coordinates on the plate.
        pixel: size of a sample in the same unit; edges are a sample wide.
        seed: draws the shell that the pieces are cut from.
    """
    return cut(list(pieces()), x, y, pixel, seed=seed)


def pieces(shell: str = "yakogai") -> Iterator[ShellPiece]:
    """All pieces of the motif, the first on top."""
    for x, y, radius, petals in ((-0.18, 0.12, 0.46, 17), (0.48, -0.38, 0.27, 15)):
        yield from chrysanthemum(x, y, radius, petals, shell=shell, heart=shell)
    yield from chrysanthemum(0.46, 0.50, 0.19, 13, shell=shell, heart=shell)
    for x, y, length, degrees in _LEAVES:
        yield from leaf(x, y, length, math.radians(degrees), shell=shell)
    at, end = 0.90, 0.88
    for sign in (-1.0, 1.0):
        yield from slips((-end, sign * at), (end, sign * at), 22, 0.036, (shell,))
        yield from slips((sign * at, -end), (sign * at, end), 22, 0.036, (shell,))
