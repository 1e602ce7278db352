"""What raden shows, in pieces of shell as a cutter makes them: flowers, leaves, butterflies.

Full-faced and sideways chrysanthemums, five-petalled blossoms and butterflies are those of lacquer
boxes in museums (docs/shells.md names some). The pieces of a motif come in the order in which they
lie, the first on top. Angles are in radians, counter-clockwise from x.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from raden_torch.artwork.pieces import ShellPiece, box, ellipse, outline, placed

_GAP = 0.0022  # half the lacquer between the parts of a leaf or a wing


def chrysanthemum(
    cx: float,
    cy: float,
    radius: float,
    petals: int,
    *,
    shell: str = "yakogai",
    heart: str = "mexican",
    turn: float = 0.0,
) -> Iterator[ShellPiece]:
    """A full-faced double flower: a heart of small pieces, and three rings of petals."""
    yield ellipse(cx, cy, 0.045 * radius, 0.045 * radius, 0.0, heart)
    for k in range(7):
        angle = turn + 2 * math.pi * k / 7
        x, y = cx + 0.105 * radius * math.cos(angle), cy + 0.105 * radius * math.sin(angle)
        yield ellipse(x, y, 0.043 * radius, 0.043 * radius, 0.0, heart)
    rings = ((0.15, 0.46, 0.70, 0.0), (0.22, 0.74, 1.0, 0.5), (0.34, 1.0, 1.0, 0.0))
    for inner, outer, share, shift in rings:
        count = round(petals * share)
        width = 1.76 * math.pi * (inner + 0.72 * (outer - inner)) / count * radius
        for k in range(count):
            angle = turn + 2 * math.pi * (k + shift) / count
            yield petal(cx, cy, inner * radius, outer * radius, width, angle, shell)


def sideways_chrysanthemum(
    cx: float, cy: float, radius: float, angle: float, *, shell: str = "yakogai"
) -> Iterator[ShellPiece]:
    """A flower seen from the side, opening towards `angle`: a fan of petals over a calyx."""
    for k in range(-1, 2):
        yield petal(cx, cy, 0.02 * radius, 0.24 * radius, 0.09 * radius, angle + 0.62 * k, "awabi")
    for reach, count, spread in ((0.72, 5, 0.70), (1.0, 8, 1.18)):
        for k in range(count):
            lean = angle + spread * (2 * k / (count - 1) - 1)
            far = reach * radius * (1 - 0.16 * ((lean - angle) / 1.18) ** 2)
            yield petal(cx, cy, 0.16 * radius, far, 0.155 * radius * reach, lean, shell)


def petal(
    cx: float, cy: float, inner: float, outer: float, width: float, angle: float, shell: str
) -> ShellPiece:
    """A narrow petal from `inner` to `outer` off a centre, round at its tip, one line engraved."""
    length = outer - inner

    def inside(u: Tensor, v: Tensor) -> Tensor:
        t = ((u - inner) / length).clamp(0, 3)
        half = width / 2 * (0.42 + 0.58 * t**0.8)
        return torch.minimum(1 - t**7 - (v / half) ** 2, (u - inner) / half)

    def engraved(u: Tensor, v: Tensor) -> Tensor:
        beyond = torch.maximum(inner + 0.45 * length - u, u - inner - 0.88 * length)
        return torch.maximum(v.abs(), beyond)

    middle = (inner + outer) / 2
    return ShellPiece(
        placed(outline(inside), cx, cy, angle),
        cx + middle * math.cos(angle),
        cy + middle * math.sin(angle),
        math.hypot(length / 2, width / 2),
        shell,
        placed(engraved, cx, cy, angle),
    )


def cherry_blossom(
    cx: float, cy: float, radius: float, *, shell: str = "akoya", turn: float = 0.3
) -> Iterator[ShellPiece]:
    """Five notched petals."""
    for k in range(5):
        yield cherry_petal(cx, cy, radius, turn + 2 * math.pi * k / 5, shell)


def cherry_petal(cx: float, cy: float, radius: float, angle: float, shell: str) -> ShellPiece:
    """One petal whose root lies at cx, cy."""

    def inside(u: Tensor, v: Tensor) -> Tensor:
        t = (u / radius).clamp(0, 1.3)
        wide = torch.sin(math.pi * t**1.15) - (v.abs() / (0.43 * radius)) ** 1.6
        notch = 0.84 + 0.75 * v.abs() / radius - t
        return torch.minimum(torch.minimum(wide, notch), t - 0.08)

    x, y = cx + radius / 2 * math.cos(angle), cy + radius / 2 * math.sin(angle)
    return ShellPiece(outline(placed(inside, cx, cy, angle)), x, y, 0.66 * radius, shell)


def plum_blossom(
    cx: float, cy: float, radius: float, *, shell: str = "akoya", turn: float = 0.0
) -> Iterator[ShellPiece]:
    """Five round petals about a dot."""
    yield ellipse(cx, cy, 0.17 * radius, 0.17 * radius, 0.0, "mexican")
    for k in range(5):
        angle = turn + 2 * math.pi * k / 5
        x, y = cx + 0.58 * radius * math.cos(angle), cy + 0.58 * radius * math.sin(angle)
        yield ellipse(x, y, 0.40 * radius, 0.37 * radius, angle, shell)


def leaf(
    cx: float, cy: float, length: float, angle: float, *, shell: str = "awabi", strips: int = 4
) -> Iterator[ShellPiece]:
    """A lobed leaf from its stalk at cx, cy, parted at the midrib and along its side veins."""
    for side in (-1.0, 1.0):
        for strip in range(strips):
            yield _leaf_strip(cx, cy, length, angle, side, strip, strips, shell)


def _leaf_strip(
    cx: float, cy: float, length: float, angle: float, side: float, strip: int, of: int, shell: str
) -> ShellPiece:

    def inside(u: Tensor, v: Tensor) -> Tensor:
        t, v = (u / length).clamp(0, 1), side * v
        lobes = 1 + 0.14 * torch.cos(2 * math.pi * (of * (t - 0.30 * v / length) + 0.5))
        margin = 0.30 * length * torch.sin(math.pi * t**0.8).clamp(min=0) ** 0.85 * lobes
        half = torch.minimum(outline_of(margin - v), v - _GAP)
        along = u / length - 0.55 * v / length  # side veins run forward
        low, high = strip / of, (strip + 1) / of
        veins = torch.minimum(along - low, high - along) * length * 0.87 - _GAP
        if strip == 0:
            veins = (high - along) * length * 0.87 - _GAP
        if strip == of - 1:
            veins = (along - low) * length * 0.87 - _GAP
        ends = torch.minimum(u, length - u)
        return torch.minimum(torch.minimum(half, veins), ends)

    def outline_of(f: Tensor) -> Tensor:
        return f * 0.8  # the margin leans

    x, y = cx + 0.55 * length * math.cos(angle), cy + 0.55 * length * math.sin(angle)
    return ShellPiece(placed(inside, cx, cy, angle), x, y, 0.66 * length, shell)


def butterfly(
    cx: float,
    cy: float,
    size: float,
    angle: float,
    *,
    shell: str = "mexican",
    spots: str = "yakogai",
) -> Iterator[ShellPiece]:
    """A butterfly from above that flies towards `angle`; every cell of a wing is a piece.

    Args:
        spots: the shell of its body and of the spots on its wings.
    """
    along, across = (math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))

    def at(forward: float, aside: float) -> tuple[float, float]:
        return (
            cx + size * (forward * along[0] + aside * across[0]),
            cy + size * (forward * along[1] + aside * across[1]),
        )

    for forward, long in ((0.22, 0.09), (0.03, 0.11), (-0.19, 0.13)):
        yield ellipse(*at(forward, 0), long * size, 0.040 * size, angle, spots)
    for side in (-1.0, 1.0):
        for far, aside, r in ((0.33, 0.62, 0.075), (-0.40, 0.40, 0.06)):
            yield ellipse(*at(far, side * aside), r * size, r * size, 0.0, spots)
        for wing in (_FORE, _HIND):
            for cell in range(wing.cells):
                yield _wing_cell(cx, cy, size, angle, side, wing, cell, shell)


class _Wing:
    """A wing about its root: a radius over the angle from the body's axis."""

    def __init__(
        self, root: float, start: float, end: float, cells: int, reach: float, waves: float
    ) -> None:
        self.root, self.start, self.end = root, start, end
        self.cells, self.reach, self.waves = cells, reach, waves

    def radius(self, theta: Tensor) -> Tensor:
        t = ((theta - self.start) / (self.end - self.start)).clamp(0, 1)
        bulge = 0.62 + 0.38 * torch.sin(math.pi * (0.18 + 0.64 * t))
        lead = 1 - 0.22 * t if self.waves == 0 else 0.86 + 0.14 * torch.sin(math.pi * t)
        scallop = 1 - 0.035 * torch.cos(2 * math.pi * self.cells * t)
        return self.reach * bulge * lead * scallop


_FORE = _Wing(0.10, math.radians(32), math.radians(96), 5, 1.0, 0.0)
_HIND = _Wing(-0.06, math.radians(100), math.radians(164), 4, 0.74, 1.0)


def _wing_cell(
    cx: float,
    cy: float,
    size: float,
    angle: float,
    side: float,
    wing: _Wing,
    cell: int,
    shell: str,
) -> ShellPiece:
    step = (wing.end - wing.start) / wing.cells
    low, high = wing.start + cell * step, wing.start + (cell + 1) * step

    def inside(u: Tensor, v: Tensor) -> Tensor:
        u, v = u / size - wing.root, side * v / size - 0.045
        theta, r = torch.atan2(v, u), torch.hypot(u, v)
        edge = wing.radius(theta) - r
        after = v * math.cos(low) - u * math.sin(low)
        before = u * math.sin(high) - v * math.cos(high)
        root = r - 0.10
        return torch.minimum(
            torch.minimum(after, before) * size - _GAP, torch.minimum(edge, root) * size
        )

    middle, half = (low + high) / 2, wing.reach * size / 2
    forward, aside = (
        wing.root + half / size * math.cos(middle),
        side * half / size * math.sin(middle),
    )
    x = cx + size * (forward * math.cos(angle) - aside * math.sin(angle))
    y = cy + size * (forward * math.sin(angle) + aside * math.cos(angle))
    return ShellPiece(placed(inside, cx, cy, angle), x, y, 1.25 * half, shell)


def crushed(
    places: Tensor, size: float, *, shell: str = "mexican", seed: int = 0
) -> Iterator[ShellPiece]:
    """Crushed shell (mijin-gai) strewn at `[N, 2]` places: small slips, turned at random."""
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.rand(len(places), 3, generator=generator, dtype=torch.float64)
    for (x, y), (long, wide, turn) in zip(places.tolist(), drawn.tolist(), strict=True):
        yield box(
            x, y, size * (0.5 + 0.7 * long), size * (0.35 + 0.4 * wide), math.pi * turn, shell
        )


def slips(
    start: tuple[float, float],
    end: tuple[float, float],
    count: int,
    width: float,
    shells: tuple[str, ...],
) -> Iterator[ShellPiece]:
    """A line of narrow slips (border), the shells taking turns."""
    angle = math.atan2(end[1] - start[1], end[0] - start[0])
    pitch = math.dist(start, end) / count
    for k in range(count):
        share = (k + 0.5) / count
        x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
        yield box(x, y, 0.46 * pitch, width / 2, angle, shells[k % len(shells)])
