"""What covers a thing: its materials, and the maps that say where each of them is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from raden_torch.artwork.box import FRONT, LID, Box, Hits
from raden_torch.artwork.box_decoration import Chart
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.geometry import unit_columns

_TAPS = 3
"""Along the longer side of what a sample sees."""
_BLOCK = 1 << 18

SURFACE, LAYERS, FLAKES = 0, 1, 2
"""Which normals a material has: the surface's; those of a shell's layers; of flakes of metal."""


@dataclass(frozen=True, eq=False)
class Covering:
    """One material of a dressing.

    Attributes:
        name: for messages.
        body: what `shade` takes, without the mirror image in a polished face above it.
        lies: SURFACE, LAYERS or FLAKES.
        polished: whether there is such a face.
    """

    name: str
    body: Reflection
    lies: int = SURFACE
    polished: bool = False


@dataclass(frozen=True, eq=False)
class Dressing:
    """The materials of a box and its charts.

    Attributes:
        coverings: in the order of the charts' weights.
        charts: of each part; a part without one is the ground all over.
        ground: which covering that is.
        polish: the face above what is polished.
    """

    coverings: tuple[Covering, ...]
    charts: Mapping[int, Chart]
    ground: int
    polish: Coated

    @cached_property
    def _textures(self) -> dict[int, Tensor]:
        """Each part's maps below each other."""
        return {k: torch.cat([c.weights, c.layers, c.flakes]) for k, c in self.charts.items()}

    def at(self, box: Box, hits: Hits, eye: Tensor, pixel: float) -> Dressed:
        """The maps where rays hit the box.

        Args:
            hits: on the box alone.
            pixel: angle that a sample spans, radians.
        """
        count = hits.part.shape[0]
        normal = box.domed(hits.normal, hits.position)
        weights = normal.new_zeros(len(self.coverings), count)
        weights[self.ground] = 1.0
        bent = [normal, normal.clone(), normal.clone()]
        for part in (LID, *range(FRONT, FRONT + 4)):
            where = (hits.part == part).nonzero()[:, 0]
            chart = self.charts.get(part)
            if chart is None or not len(where):
                continue
            texture = self._textures[part]
            read = _read(box, part, texture, hits.position[:, where], normal[:, where], eye, pixel)
            weights[:, where] = read[:-4]
            axes = _axes(part).to(normal)
            for lies, slopes in ((LAYERS, read[-4:-2]), (FLAKES, read[-2:])):
                leaning = normal[:, where] - axes.T @ slopes
                bent[lies][:, where] = unit_columns(leaning)
        return Dressed(hits.position, tuple(bent), weights)


@dataclass(frozen=True, eq=False)
class Dressed:
    """Maps at N places.

    Attributes:
        position: `[3, N]`.
        normals: `[3, N]` each: of the surface, of layers, of flakes.
        weights: `[K, N]`.
    """

    position: Tensor
    normals: tuple[Tensor, ...]
    weights: Tensor


def _axes(part: int) -> Tensor:
    """`[2, 3]`: right and up of a chart, in space."""
    rights = ((1, 0, 0), (1, 0, 0), (0, 0, -1), (-1, 0, 0), (0, 0, 1))
    up = (0.0, 0.0, -1.0) if part == LID else (0.0, 1.0, 0.0)
    return torch.tensor([[float(x) for x in rights[part - LID]], up])


def _read(
    box: Box,
    part: int,
    texture: Tensor,
    position: Tensor,
    normal: Tensor,
    eye: Tensor,
    pixel: float,
) -> Tensor:
    """`[C, N]`: a texture averaged over what each sample sees of it."""
    place = box.chart(torch.full(position.shape[1:], part), position)
    half, low, high = box.chart_size(part)
    away = eye[:, None] - position
    distance = away.square().sum(0).sqrt()
    cosine = ((away * normal).sum(0) / distance).clamp(min=0.05)
    # a sample is longest where the view runs along the surface
    along = _axes(part).to(away) @ (away / distance)
    along = unit_columns(along)
    longer = along * (distance * pixel * (1 / cosine).clamp(max=8.0))
    total = torch.zeros(len(texture), position.shape[1])
    scale = torch.tensor([1 / half, -2 / (high - low)])[:, None]
    middle = torch.tensor([0.0, (high + low) / 2])[:, None]
    for start in range(0, position.shape[1], _BLOCK):
        here = slice(start, start + _BLOCK)
        for tap in range(_TAPS):
            offset = longer[:, here] * ((tap + 0.5) / _TAPS - 0.5)
            at = ((place[:, here] + offset - middle) * scale).T[None, None]
            found = grid_sample(texture[None], at, align_corners=False, padding_mode="border")
            total[:, here] += found[0, :, 0] / _TAPS
    return total
