"""What the maki-e box shows on its lid and its sides, as maps of materials."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.artwork.box import LID, Box
from raden_torch.artwork.cutting import cut
from raden_torch.artwork.flowers import cherry_petal, chrysanthemum, leaf, slips
from raden_torch.artwork.gold import Stroke, drawn, flake_slopes, powder
from raden_torch.artwork.makie import lid
from raden_torch.artwork.pieces import ShellPiece

GOLD, SEAM = "gold", "seam"
"""Materials beside the shells."""

_FLAKE = 0.0045
_FLAKE_LEAN = 0.16
"""Standard deviation of the slopes of flakes: an assumption."""
_LEAN = 1.5
"""Pieces of a box lean this much more than the shell's own layers wave: an assumption."""
_SEAM_HALF = 0.006
_RIM_LINE = 0.030
"""The gold line on each side of the seam, from its middle."""


@dataclass(frozen=True, eq=False)
class Chart:
    """Maps of one part, rows from its upper end down.

    Attributes:
        weights: `[K, H, W]` share of each material, 0…1, summing to 1.
        layers: `[2, H, W]` slopes of the shell's layers, to the right and up.
        flakes: `[2, H, W]` the same of the gold.
    """

    weights: Tensor
    layers: Tensor
    flakes: Tensor


def decorated(
    box: Box, part: int, texel: float, scales: Mapping[str, Sequence[float]], seed: int
) -> Chart:
    """The maps of one part, a sample each `texel`.

    Args:
        scales: tablet scales of each shell's models, as for `PieceMaps.weights`: the materials are
            these, gold, the ground, and the seam.
    """
    half, bottom, top = box.chart_size(part)
    columns, rows = (max(2, math.ceil(side / texel)) for side in (2 * half, top - bottom))
    across = ((torch.arange(columns) + 0.5) / columns * 2 - 1) * half
    down = top - (torch.arange(rows) + 0.5) / rows * (top - bottom)
    y, x = torch.meshgrid(down, across, indexing="ij")
    if part == LID:
        maps = lid(x, y, texel, seed=seed)
        pieces, gold, seam = maps.shell, maps.gold[0], torch.zeros_like(x)
    else:
        pieces = cut(list(_side_pieces(box, part)), x, y, texel, seed=seed + part)
        gold = _side_gold(box, part, x, y, texel, seed + part)
        seam = _band(y - box.seam * box.height, _SEAM_HALF, texel)
    covered = pieces.coverage[0]
    shares = pieces.weights(scales)
    shares = shares / shares.sum(0, keepdim=True).clamp(min=1e-6) * covered * (1 - seam)
    bare = 1 - shares.sum(0) - seam
    weights = torch.cat([shares, torch.stack([bare * gold, bare * (1 - gold), seam])])
    flakes = _FLAKE_LEAN * flake_slopes(x, y, texel, flake=_FLAKE, seed=seed + 50 + part)
    return Chart(weights, _LEAN * pieces.layer_slope, flakes)


def _side_pieces(box: Box, part: int) -> Iterator[ShellPiece]:
    """A flower with leaves, petals in the wind, and a border of slips below the seam."""
    half, _, _ = box.chart_size(part)
    seam, inside = box.seam * box.height, half - 1.5 * box.rounding
    at = -0.48 * half if part % 2 == 0 else 0.35 * half
    shell, other = ("yakogai", "mexican") if part % 2 == 0 else ("mexican", "yakogai")
    yield from chrysanthemum(at, 0.20, 0.155, 13, shell=shell, heart="akoya")
    for k, angle in enumerate((28.0, 152.0, 8.0)):
        x = at + 0.13 * math.cos(math.radians(angle)) * (1.25 if k == 2 else 1)
        yield from leaf(x, 0.16, 0.15, math.radians(angle), shell="awabi")
    for k in range(5):
        x = at + (0.42 + 0.26 * k) * (1 if at < 0 else -1)
        if abs(x) < inside:
            y = 0.16 + 0.10 * math.sin(2.3 * k + part)
            yield cherry_petal(x, y, 0.055, 1.7 * k + part, "akoya" if k % 2 else other)
    count = round(2 * inside / 0.045)
    for y in (seam - 0.062, seam + 0.062):
        yield from slips((-inside, y), (inside, y), count, 0.013, (shell, other, shell, "awabi"))


def _side_gold(box: Box, part: int, x: Tensor, y: Tensor, texel: float, seed: int) -> Tensor:
    half, _, top = box.chart_size(part)
    seam = box.seam * top
    rising = 0.13 * (1 + 0.35 * torch.sin(2.1 * x + part))
    mist = (0.62 * torch.exp(-((y / rising) ** 2))).clamp(0, 1)
    mist = torch.where(mist > 0.004, mist, 0.0)
    strewn = powder(mist, x, y, texel, flake=0.0034, seed=seed)
    coarse = powder(0.25 * mist, x, y, texel, flake=0.009, seed=seed + 100)
    inside = half - 0.6 * box.rounding
    lines = [
        Stroke([(-inside, seam + off), (inside, seam + off)], 0.005, 0.005)
        for off in (-_RIM_LINE - 0.06, -_RIM_LINE, _RIM_LINE, _RIM_LINE + 0.06)
    ]
    return 1 - (1 - drawn(lines, x, y, texel)) * (1 - strewn) * (1 - coarse)


def _band(away: Tensor, half: float, texel: float) -> Tensor:
    """The share of a sample that lies within a band about 0."""
    low, high = ((edge - away) / texel + 0.5 for edge in (-half, half))
    return high.clamp(0, 1) - low.clamp(0, 1)
