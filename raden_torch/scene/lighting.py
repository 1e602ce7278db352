"""A dressed box under lights: each kind of material by what is fastest for it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.area_lights import RectangleLight
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light, directions_of
from raden_torch.brdf.shading.shade import shade
from raden_torch.geometry import unit_columns
from raden_torch.scene.dressing import Dressed, Dressing
from raden_torch.scene.polish import (
    MirroredSurroundings,
    mirrored,
    mirrored_rectangle,
    reflected_share,
)
from raden_torch.scene.table import LitTable

_LAMPS = 192
"""That stand for surroundings, to what is not polished."""
_FACETS_WITHIN = 20.0
"""Times α, as a slope: where the highlight of a lamp is computed."""
_LEAST = 1 / 512
"""Shares of a sample below this are left out."""

Place = tuple[float, float, float]


class SeenBox:
    """A dressed box before a camera: what stays the same under any light is gathered once."""

    def __init__(self, dressing: Dressing, dressed: Dressed, camera: Place) -> None:
        self._size = dressed.position.shape
        self._bodies = list(_bodies(dressing, dressed, camera))
        rows = [k for k, c in enumerate(dressing.coverings) if c.polished]
        share = dressed.weights[rows].sum(0)
        here = (share > _LEAST).nonzero()[:, 0]
        self._face = None
        if len(here):
            normal, position = (
                m.index_select(1, here) for m in (dressed.normals[0], dressed.position)
            )
            self._face = Face.of(dressing.polish, normal, position, camera, share[here])
            self._polished = here

    def radiance(self, lights: Sequence[Light], table: LitTable | None) -> Tensor:
        """`[3, N]` under lights, above a table that they light, too."""
        image = torch.zeros(self._size)
        lamps = [x.lamps(_LAMPS) if isinstance(x, EnvironmentLight) else x for x in lights]
        for body in self._bodies:
            lit = shade(body.material, body.gbuffer, lamps)[0, :, 0]
            image.index_add_(1, body.here, lit * body.share)
        if self._face is not None:
            image.index_add_(1, self._polished, self._face.reflected(lights, table))
        return image


@dataclass(frozen=True, eq=False)
class _Body:
    """Where a material shows.

    Attributes:
        here: `[P]` which of the places.
        share: `[P]` how much of each.
        gbuffer: of one row.
    """

    material: Reflection
    here: Tensor
    share: Tensor
    gbuffer: GBuffer


def _bodies(dressing: Dressing, dressed: Dressed, camera: Place) -> Iterator[_Body]:
    for covering, share in zip(dressing.coverings, dressed.weights, strict=True):
        here = (share > _LEAST).nonzero()[:, 0]
        if len(here):
            normal, position = (
                m.index_select(1, here)[None, :, None]
                for m in (dressed.normals[covering.lies], dressed.position)
            )
            gbuffer = GBuffer(normal, position=position, camera=camera)
            yield _Body(covering.body, here, share[here], gbuffer)


@dataclass(frozen=True, eq=False)
class Face:
    """A polished face at P places, `[3, P]` maps.

    Attributes:
        view, mirror: unit vectors to the eye, and to where the face mirrors it.
        share: `[P]`, how much of each place is polished.
        reflects: `[3, P]`, how much of what the face mirrors is seen.
    """

    polish: Coated
    normal: Tensor
    position: Tensor
    view: Tensor
    mirror: Tensor
    share: Tensor
    reflects: Tensor

    @classmethod
    def of(
        cls, polish: Coated, normal: Tensor, position: Tensor, camera: Place, share: Tensor
    ) -> Face:
        view = unit_columns(torch.tensor(camera)[:, None] - position)
        mirror, cosine = mirrored(normal, view)
        reflects = reflected_share(polish, cosine) * share
        return cls(polish, normal, position, view, mirror, share, reflects)

    def reflected(
        self,
        lights: Sequence[Light],
        table: LitTable | None,
        before: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        """`[3, P]` radiance.

        Args:
            table: that is mirrored below the horizon.
            before: what is mirrored before the lights: radiance `[3, P]`, times how much of them it
                hides, `[P]`.
        """
        seen = torch.zeros_like(self.normal)
        small = []
        for light in lights:
            if isinstance(light, EnvironmentLight):
                seen += MirroredSurroundings(light, self.polish.roughness).at(self.mirror)
            elif isinstance(light, RectangleLight):
                seen += mirrored_rectangle(light, self.position, self.mirror)
            else:
                small.append(light)
        if table is not None:
            down = (self.mirror[1] < -1e-3).nonzero()[:, 0]
            position, mirror = (m.index_select(1, down) for m in (self.position, self.mirror))
            seen[:, down] = table.mirrored(position - mirror * (position[1] / mirror[1]))
        highlights = self._lamps(small)
        if before is not None:
            radiance, cover = before
            seen = seen.mul_(1 - cover).add_(radiance)
            highlights *= 1 - cover
        return seen.mul_(self.reflects) + highlights

    def _lamps(self, lights: Sequence[Light]) -> Tensor:
        """`[3, P]` their highlights."""
        total = torch.zeros_like(self.normal)
        # 1 - 1 / (1 + 20²) of a GGX lobe lies within this angle of its facets' normal, and a lamp
        # off the mirror direction by twice the angle at most
        least = 1 / math.sqrt(1 + (_FACETS_WITHIN * self.polish.roughness) ** 2)
        widest = 2 * least**2 - 1
        everywhere = self.position[None, :, None]
        for light in lights:
            for towards, irradiance in directions_of(light, everywhere, everywhere):
                to = towards[0, :, 0]
                along = (self.mirror * to).sum(0)
                near = (along > widest * to.square().sum(0).sqrt()).nonzero()[:, 0]
                if not len(near):
                    continue
                n, v, to = (
                    m.expand_as(self.normal).index_select(1, near)
                    for m in (self.normal, self.view, to)
                )
                to = unit_columns(to)
                cosine = (n * to).sum(0).clamp(min=0)
                e = irradiance[0, :, 0].expand(3, len(self.share))[:, near] * self.share[near]
                n, to, v = (m[None, :, None] for m in (n, to, v))
                total[:, near] += self.polish.gloss(n, to, v)[0, :, 0] * (e * cosine)
        return total
