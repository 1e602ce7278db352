"""Maps of cut pieces of shell: where each lies, how its layers lean, how thick its tablets are.

Every piece is cut from a random place of an endless sheet of its shell (`layers`), and turned: so
pieces differ from each other and within themselves. The maps are the same at any resolution, up to
what a sample averages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from raden_torch.artwork.layers import HABITS, sheet
from raden_torch.artwork.pieces import ShellPiece, Windows
from raden_torch.errors import InputError

GAP = 0.004
"""Lacquer between two pieces, in the plate's unit."""
HAIRLINE = 0.004
"""Width of an engraved line, filled with lacquer."""

_SHEET = 40.0  # pieces are cut from a square of this side


@dataclass(frozen=True, eq=False)
class PieceMaps:
    """What `cut` finds at every sample.

    Attributes:
        coverage: `[1, H, W]`, share of the sample that is shell, 0…1.
        piece: `[1, H, W]` integers, which piece it is; -1 where there is none.
        shell: `[1, H, W]` integers into `shells`; 0 where there is none.
        layer_slope: `[2, H, W]`, slopes of the layers' height over the plate, along x and y; 0
            where there is no shell.
        tablets: `[1, H, W]`, thickness of the tablets over the shell's own; 1 where there is none.
        shells: names of the shells.
    """

    coverage: Tensor
    piece: Tensor
    shell: Tensor
    layer_slope: Tensor
    tablets: Tensor
    shells: tuple[str, ...]

    def weights(self, scales: Mapping[str, Sequence[float]]) -> Tensor:
        """Which share of which model reflects: `[K, H, W]`, 0…1, summing to 1.

        Args:
            scales: of each shell, the rising tablet scales of its models (`simulate_specimen(shell,
                tablet_scale=…)`); the K models stand in this order. A thickness between two scales
                is blended of both; beyond the ends the last one stays.

        Raises:
            InputError: a shell of the pieces has no scale, or its scales do not rise.
        """
        missing = [name for name in self.shells if not scales.get(name)]
        if missing:
            raise InputError(
                f"scales: expected at least one for each shell, got none for {missing}"
            )
        parts = []
        for name, own in scales.items():
            if any(low >= high for low, high in pairwise(own)):
                raise InputError(f"scales: {name}: expected rising numbers, got {list(own)}")
            here = self.shell == self.shells.index(name) if name in self.shells else None
            for tent in _tents(self.tablets[0], own):
                parts.append(tent * here[0] if here is not None else torch.zeros_like(tent))
        return torch.stack(parts)


def cut(
    pieces: Sequence[ShellPiece],
    x: Tensor,
    y: Tensor,
    pixel: float,
    *,
    gap: float = GAP,
    seed: int = 0,
) -> PieceMaps:
    """Maps of pieces that lie on a plate.

    Args:
        pieces: the first lies on top: those below are cut back to leave a gap.
        x, y: `[H, W]` floating-point coordinates on the plate, rows and columns nearly along them.
        pixel: size of a sample in the same unit; edges are a sample wide.
        gap: lacquer between two pieces.
        seed: draws the sheets, and the place of each piece on them.

    Raises:
        InputError: x and y of different shapes, a pixel or gap that is no positive size, a shell
            that has no habit.
    """
    _check(pieces, x, y, pixel, gap)
    coverage, piece = _covered(pieces, x, y, pixel, gap)
    shells = tuple(dict.fromkeys(p.shell for p in pieces))
    of_piece = torch.tensor([shells.index(p.shell) for p in pieces], device=x.device)
    shell = torch.where(piece >= 0, of_piece[piece.clamp(min=0)], 0)
    slope, tablets = torch.zeros_like(x).repeat(2, 1, 1), torch.ones_like(x)
    places = _places(pieces, seed).to(x)
    for index, name in enumerate(shells):
        here = (shell == index) & (piece >= 0)
        at_u, at_v, turn, own_x, own_y = places[piece[here]].unbind(1)
        c, s = turn.cos(), turn.sin()
        dx, dy = x[here] - own_x, y[here] - own_y
        u, v = at_u + c * dx + s * dy, at_v + c * dy - s * dx
        (along_u, along_v), thickness = sheet(HABITS[name], u, v, pixel, seed + index)
        slope[:, here] = torch.stack([c * along_u - s * along_v, s * along_u + c * along_v])
        tablets[here] = thickness
    return PieceMaps(coverage[None], piece[None], shell[None], slope, tablets[None], shells)


def _covered(
    pieces: Sequence[ShellPiece], x: Tensor, y: Tensor, pixel: float, gap: float
) -> tuple[Tensor, Tensor]:
    """`[H, W]` coverage, and which piece covers most."""
    coverage, most = torch.zeros_like(x), torch.zeros_like(x)
    above = torch.full_like(x, -math.inf)
    piece = torch.full(x.shape, -1, dtype=torch.long, device=x.device)
    windows = Windows(x, y)
    for index, one in enumerate(pieces):
        middle = torch.tensor([[one.x, one.y]], dtype=torch.float64)
        window = windows.near(middle, one.reach + pixel)
        own = torch.minimum(one.distance(x[window], y[window]), -gap - above[window])
        part = (own / pixel + 0.5).clamp(0, 1)
        if one.engraved is not None:
            part = part * (1 - _line(one.engraved(x[window], y[window]), pixel))
        piece[window] = torch.where(part > most[window], index, piece[window])
        most[window] = torch.maximum(most[window], part)
        coverage[window] += part  # pieces lie apart: their areas add up
        above[window] = torch.maximum(above[window], own)
    return coverage.clamp(0, 1), piece


def _line(away: Tensor, pixel: float) -> Tensor:
    """The share of a sample that an engraved line at this distance takes."""
    low, high = ((edge - away) / pixel + 0.5 for edge in (-HAIRLINE / 2, HAIRLINE / 2))
    return high.clamp(0, 1) - low.clamp(0, 1)


def _places(pieces: Sequence[ShellPiece], seed: int) -> Tensor:
    """`[P, 5]`: place u and v on the sheet, turn, and the piece's own x and y."""
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.rand(len(pieces), 3, generator=generator, dtype=torch.float64)
    own = torch.tensor([[p.x, p.y] for p in pieces], dtype=torch.float64)
    return torch.cat([drawn * torch.tensor([_SHEET, _SHEET, 2 * math.pi]), own], dim=1)


def _tents(tablets: Tensor, scales: Sequence[float]) -> list[Tensor]:
    """Linear interpolation's weights of each scale, constant beyond the ends."""
    inside = tablets.clamp(scales[0], scales[-1])
    tents = [torch.ones_like(tablets) for _ in scales]
    for index, (low, high) in enumerate(pairwise(scales)):
        share = ((inside - low) / (high - low)).clamp(0, 1)
        tents[index] = tents[index] * (1 - share)
        tents[index + 1] = tents[index + 1] * share
    return tents


def _check(pieces: Sequence[ShellPiece], x: Tensor, y: Tensor, pixel: float, gap: float) -> None:
    if x.shape != y.shape or x.ndim != 2 or not x.is_floating_point():
        raise InputError(
            f"cut: expected floating-point x and y [H, W], got {list(x.shape)} {x.dtype} and "
            f"{list(y.shape)}"
        )
    if not 0 < pixel < math.inf or not 0 <= gap < math.inf:
        raise InputError(f"cut: expected a positive pixel and a gap, got {pixel} and {gap}")
    if not pieces:
        raise InputError("cut: expected at least one piece, got none")
    unknown = sorted({p.shell for p in pieces} - set(HABITS))
    if unknown:
        raise InputError(f"cut: expected shells of {', '.join(HABITS)}, got {', '.join(unknown)}")
