"""Which places of a picture are looked at: one in each pixel, and many where something ends.

A pixel across which a silhouette, an edge or a crease runs is looked at in a grid of places and
averaged in linear light; edges of the decoration need none, since its maps hold their coverage.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.artwork.box import Box, Hits
from raden_torch.scene.camera import Camera

_CREASE = 0.02
"""Of 1 − cos of the angle between neighbours' normals: some 11 degrees."""


@dataclass(frozen=True)
class Samples:
    """Places that are looked at, those of one pixel in any order.

    Attributes:
        hits: where each ends.
        pixel: `[N]` which pixel it belongs to, row by row.
        per_side: `[N]` places along each side of its pixel: 1, or the number asked for.
    """

    hits: Hits
    pixel: Tensor
    per_side: Tensor

    def at(self, mask: Tensor) -> Samples:
        """Those where `[N]` mask is true."""
        here = mask.nonzero()[:, 0]
        position, normal = (m.index_select(1, here) for m in (self.hits.position, self.hits.normal))
        hits = Hits(self.hits.part[here], position, normal)
        return Samples(hits, self.pixel[here], self.per_side[here])

    def averaged(self, radiance: Tensor, size: tuple[int, int]) -> Tensor:
        """`[1, 3, H, W]` of radiance `[3, N]`."""
        width, height = size
        share = 1 / self.per_side.to(radiance).square()
        image = radiance.new_zeros(3, width * height)
        image.index_add_(1, self.pixel, radiance * share)
        return image.view(1, 3, height, width)


def sampled(box: Box, camera: Camera, per_side: int, everywhere: bool = False) -> Samples:
    """The places of a picture.

    Args:
        per_side: along each side of a pixel at an edge.
        everywhere: looks at all pixels so: slow, the reference.
    """
    width, height = camera.size
    pixel = torch.arange(width * height)
    eye = camera.eye()
    middle = box.cast(eye, camera.rays(pixel % width + 0.5, pixel // width + 0.5))
    if per_side == 1:
        return Samples(middle, pixel, torch.ones_like(pixel))
    edge = torch.ones_like(pixel, dtype=torch.bool)
    if not everywhere:
        edge = _at_edges(middle, (height, width))
    plain, fine = (~edge).nonzero()[:, 0], edge.nonzero()[:, 0].repeat(per_side**2)
    place = torch.arange(per_side**2).repeat_interleave(int(edge.sum()))
    column = fine % width + (place % per_side + 0.5) / per_side
    row = fine // width + (place // per_side + 0.5) / per_side
    more = box.cast(eye, camera.rays(column, row))
    hits = Hits(
        torch.cat([middle.part[plain], more.part]),
        torch.cat([middle.position[:, plain], more.position], 1),
        torch.cat([middle.normal[:, plain], more.normal], 1),
    )
    count = torch.cat([torch.ones_like(plain), torch.full_like(fine, per_side)])
    return Samples(hits, torch.cat([plain, fine]), count)


def _at_edges(hits: Hits, size: tuple[int, int]) -> Tensor:
    """`[N]`: pixels beside which another part, or another direction of the normal, begins."""
    part = hits.part.view(size)
    normal = hits.normal.view(3, *size)
    edge = torch.zeros(size, dtype=torch.bool)
    for axis in (0, 1):
        count = size[axis] - 1
        one, two = (slice(0, count), slice(1, None))
        ahead, behind = ((s, slice(None)) if axis == 0 else (slice(None), s) for s in (one, two))
        turned = (normal[:, *ahead] * normal[:, *behind]).sum(0) < 1 - _CREASE
        differs = (part[ahead] != part[behind]) | turned
        edge[ahead] |= differs
        edge[behind] |= differs
    return edge.flatten()
