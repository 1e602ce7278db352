"""Radiance as a table over the mirror direction and the view, for cameras that are not at infinity.

What a pixel shows depends on N and V. Over the mirror direction R = 2 (N·V) N − V it hardly depends
on V as long as V changes little, as it does across a frame; so a few tables over R, one for each
node of a grid of views, are read bilinearly in both: by the fused kernel, or in torch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, max_pool2d, normalize

from raden_torch.brdf.model import shading_kernel
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.latlong import octahedral, octahedral_directions
from raden_torch.brdf.shading.lit_sphere import with_room
from raden_torch.brdf.shading.triples import Triple, as_map

_VIEW_STEP = math.radians(8.0)
_RIM = 0.25
"""N·V below which a pixel is near the silhouette."""
_BLOCK = 1 << 16
_MOST_NODES = 1 << 24
"""That the kernel can number."""


@dataclass(frozen=True)
class ViewGrid:
    """A grid of views that spans those of a frame: `count` x `count` about a middle one.

    Attributes:
        axes: `[3, 3]`, rows: across, up, and the middle view.
        low: `[2]`, the first node across and up.
        step: `[2]`; 0 where one view stands for all.
        count: nodes along each side.
    """

    axes: Tensor
    low: Tensor
    step: Tensor
    count: int

    @classmethod
    def over(cls, views: Tensor, beyond: float = 0.0) -> ViewGrid | None:
        """None where they span more than a hemisphere can show well.

        Args:
            beyond: of their span, that the grid reaches beyond them.
        """
        middle = normalize(views.mean(0), dim=0)
        if float((views @ middle).min()) < 0.5:
            return None
        least = torch.nn.functional.one_hot(middle.abs().argmin(), 3).to(middle)
        across = normalize(torch.linalg.cross(least, middle), dim=0)
        axes = torch.stack([across, torch.linalg.cross(middle, across), middle])
        flat = views @ axes[:2].T
        low, high = flat.amin(0), flat.amax(0)
        low, high = torch.lerp(low, high, -beyond), torch.lerp(high, low, -beyond)
        span = float((high - low).max())
        count = 1 if span < 1e-3 else 1 + math.ceil(span / _VIEW_STEP)
        if count == 1:
            return cls(axes, (low + high) / 2, torch.zeros(2), 1)
        return cls(axes, low, (high - low).clamp(min=1e-6) / (count - 1), count)

    def views(self) -> Tensor:
        """`[count², 3]`, row by row."""
        steps = torch.arange(self.count, dtype=torch.float32)
        y, x = torch.meshgrid(steps, steps, indexing="ij")
        flat = self.low + torch.stack([x, y], -1).view(-1, 2) * self.step
        up = (1 - (flat * flat).sum(1, keepdim=True)).clamp(min=0).sqrt()
        return normalize(torch.cat([flat, up], 1) @ self.axes, dim=1)

    def corners(self, views: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Node and weight `[N]` of each node that is read for a view."""
        if self.count == 1:
            zero = torch.zeros(len(views), dtype=torch.long)
            return [(zero, torch.ones(len(views)))]
        at = ((views @ self.axes[:2].T - self.low) / self.step).clamp(0, self.count - 1)
        low = at.long().clamp(max=self.count - 2)
        (x, y), (fx, fy) = low.T, (at - low).T
        return [
            ((y + j) * self.count + x + i, (fx if i else 1 - fx) * (fy if j else 1 - fy))
            for j in (0, 1)
            for i in (0, 1)
        ]


@dataclass(frozen=True)
class MirrorTable:
    """Radiance over R, once for each view of a grid.

    Attributes:
        radiance: `[views · S, S, 3]`, one octahedral map below the other.
        side: S.
    """

    radiance: Tensor
    side: int
    grid: ViewGrid

    @classmethod
    def of(
        cls,
        radiance: Callable[[Tensor, Tensor], Tensor],
        grid: ViewGrid,
        used: Tensor,
        missing: float = 0.0,
    ) -> MirrorTable:
        """By radiance of normals and views `[N, 3]` at the nodes `[views, S, S]` that are used.

        Args:
            missing: what stands at the others.
        """
        side = used.shape[-1]
        which, row, column = used.nonzero(as_tuple=True)
        mirror = octahedral_directions(side).float()[:, row, column].T
        view = grid.views()[which]
        # R = −V is the silhouette, where N is any normal across V
        normal = normalize(mirror + view, dim=1)
        values = with_room((grid.count**2 * side, side, 3)).fill_(missing)
        values.view(-1, 3)[used.flatten()] = radiance(normal, view)
        return cls(values, side, grid)

    @property
    def is_numbered(self) -> bool:
        """Whether the kernel can count its nodes."""
        return self.radiance.numel() // 3 < _MOST_NODES

    def read(self, gbuffer: GBuffer) -> Tensor:
        """`[B, 3, H, W]` by the fused kernel, times the mask; NaN where a missing node is read."""
        grid = self.grid
        numbers = [*torch.cat([grid.axes.flatten(), grid.low, grid.step]).tolist(), _RIM]
        nodes = (grid.count, self.side)
        return shading_kernel.look_up_mirror(self.radiance, nodes, numbers, *maps_of(gbuffer))

    def read_pixels(self, normal: Tensor, view: Tensor) -> Tensor:
        """`[N, 3]` for unit normals and views `[N, 3]`, in torch."""
        image = torch.empty_like(normal)
        planes, height = self.radiance.movedim(-1, 0), len(self.radiance)
        for block in range(0, len(normal), _BLOCK):
            here = slice(block, block + _BLOCK)
            total = torch.zeros(3, len(normal[here]))
            for node, weight, u, v in _places(self.grid, normal[here], view[here]):
                row = (v + 1) * ((self.side - 1) / 2) + node * self.side
                found = read_map(planes, u[:, None], (row * (2 / (height - 1)) - 1)[:, None])
                total += found[..., 0] * weight
            image[here] = total.T
        return image


def maps_of(
    gbuffer: GBuffer,
) -> tuple[Tensor, Tensor | None, Tensor | None, Tensor | None, Tensor | None]:
    """Normal, view, position, camera `[B or 1, 3]` and mask as the kernel takes them."""
    normal, mask = gbuffer.normal, gbuffer.mask
    if mask is not None and not mask.is_floating_point():
        mask = mask.to(torch.float32)
    if isinstance(gbuffer.view, Tensor):
        return normal, gbuffer.view, None, None, mask
    camera = as_map(cast(Triple, gbuffer.camera), normal)[..., 0, 0]
    return normal, None, gbuffer.position, camera, mask


def nodes_read(
    grid: ViewGrid, normal: Tensor, view: Tensor, side: int, wider: bool = False
) -> Tensor:
    """`[views, S, S]` bool: the nodes that pixels are read from, and, if asked for, those beside
    them."""
    used = torch.zeros(grid.count**2, side, side, dtype=torch.bool)
    for n, w in zip(normal.split(_BLOCK), view.split(_BLOCK), strict=True):
        for node, _, *place in _places(grid, n, w):
            x, y = (((m + 1) * ((side - 1) / 2)).long().clamp(0, side - 2) for m in place)
            used.view(-1)[(node * side + y) * side + x] = True
    if wider:
        used = max_pool2d(used.float(), 3, 1, 1) > 0
    for shift in (1, 2):
        used |= used.roll(1, dims=shift)
    return used


def _places(
    grid: ViewGrid, normal: Tensor, view: Tensor
) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """For each view of the grid that a pixel is read from: which, its weight, where in its map.

    That is at the pixel's R. Near the silhouette R tells N·V badly, which matters most there: R
    is turned as V is turned to the grid's view.
    """
    cosine = (normal * view).sum(1, keepdim=True)
    mirror = (2 * cosine) * normal - view
    rim = (cosine[:, 0] < _RIM).nonzero()[:, 0] if grid.count > 1 else None
    plain = octahedral(*mirror.T)
    nodes = grid.views()
    for node, weight in grid.corners(view):
        u, v = plain
        if rim is not None and len(rim):
            turned = _turned(mirror[rim], view[rim], nodes[node[rim]])
            u, v = (
                m.clone().index_copy_(0, rim, part)
                for m, part in zip(plain, octahedral(*turned.T), strict=True)
            )
        yield node, weight, u, v


def _turned(vector: Tensor, start: Tensor, end: Tensor) -> Tensor:
    """`[N, 3]` vectors by the shortest turn from one unit vector to another, not its opposite."""
    axis = torch.linalg.cross(start, end, dim=1)
    cosine = (start * end).sum(1, keepdim=True)
    along = (axis * vector).sum(1, keepdim=True) / (1 + cosine)
    return vector * cosine + torch.linalg.cross(axis, vector, dim=1) + axis * along


def read_map(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """`[C, n, J]` of `[C, H, W]`, bilinear, shared among the threads by images of a batch."""
    threads = torch.get_num_threads() if u.shape[0] % torch.get_num_threads() == 0 else 1
    at = torch.stack([u, v], dim=-1).view(threads, -1, *u.shape[1:], 2)
    found = grid_sample(image.expand(threads, -1, -1, -1), at, align_corners=True)
    return found.transpose(0, 1).reshape(len(image), *u.shape)
