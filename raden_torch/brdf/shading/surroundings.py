"""A frame under an environment: radiance as a table over the mirror direction and the view.

The lit sphere (Sloan et al. 2001) for surroundings and for cameras that are not at infinity. What
a pixel shows depends on N and V. Over the mirror direction R = 2 (N·V) N − V it hardly depends on
V as long as V changes little, as it does across a frame; so a few tables over R, one for each node
of a grid of views, are read bilinearly in both. Only nodes that the frame reads are computed. The
table is refined until pixels of the frame that are computed by themselves agree with it.

Nodes of a measured model are summed over distant lamps by the fused kernel; those of other
materials, which may be polished, by a quadrature about R (`mirror_rings.py`) from the surroundings
blurred by the size of its cells (`latlong.SphereBlur`), which are kept for as long as the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model import kernel
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.kept_by_map import KeptByMap
from raden_torch.brdf.shading.latlong import (
    SphereBlur,
    about_y,
    octahedral,
    octahedral_directions,
)
from raden_torch.brdf.shading.lights import packed
from raden_torch.brdf.shading.mirror_rings import mirror_axes, ring_weights, rings, row_of
from raden_torch.brdf.shading.triples import checked

_SIDES = (97, 145, 217, 325, 487)
"""Nodes along each side of the tables over R, coarsest first."""
_VIEW_STEP = math.radians(8.0)
_RIM = 0.25
"""N·V below which a pixel is near the silhouette."""
SURE = 0.99
"""The share of pixels that has to be within the tolerance."""
PROBES = 1500
"""Pixels that are computed by themselves, to know the error."""
_CHUNK = 1 << 11
_BLOCK = 1 << 16

_SIGMA = 0.5
"""Of a cell's size: Gaussians as wide as this cover evenly."""

_LAMPS = 768
"""That stand for an environment to a measured model: off by 0.3 % of the peak or less."""

Radiance = Callable[[Tensor, Tensor], Tensor]
"""Unit normals and views `[N, 3]` in the scene's frame → radiance `[N, 3]`."""

_levels: KeptByMap[list[Tensor]] = KeptByMap()


@dataclass(frozen=True)
class Surroundings:
    """An environment's means over the cells of every ring, and a material's weights for them.

    Attributes:
        levels: `[3, S, S]` octahedral maps, one for each ring.
        weights: of `ring_weights`.
        turn: `[3, 3]`, from the scene's frame to the environment's.
    """

    levels: list[Tensor]
    weights: list[Tensor]
    turn: Tensor

    @classmethod
    def of(cls, light: EnvironmentLight, weights: list[Tensor]) -> Surroundings:
        return cls(levels_of(light.radiance), weights, about_y(-light.rotation_deg).float())

    def radiance(self, normal: Tensor, view: Tensor) -> Tensor:
        """`[N, 3]` for unit normals and views `[N, 3]` in the scene's frame."""
        parts = [
            self._chunk(n @ self.turn.T, v @ self.turn.T)
            for n, v in zip(normal.split(_CHUNK), view.split(_CHUNK), strict=True)
        ]
        return torch.cat(parts) if parts else normal.new_zeros(0, 3)

    def _chunk(self, normal: Tensor, view: Tensor) -> Tensor:
        axes = mirror_axes(normal[..., None, None], view[..., None, None])[..., 0, 0]
        row = row_of((normal * view).sum(1))
        low = row.long().clamp(max=self.weights[0].shape[1] - 2)
        between = (row - low)[:, None]
        total = normal.new_zeros(3, len(normal))
        for ring, level, weights in zip(rings(), self.levels, self.weights, strict=True):
            w = torch.lerp(weights[:, low], weights[:, low + 1], between)
            used = (w != 0).any(0).any(0)
            if not bool(used.any()):
                continue
            local = ring.directions().float()[used]
            light = torch.einsum("ja,nac->cnj", local, axes)
            u, v = octahedral(*light)
            total += (_read(level, u, v) * w[:, :, used]).sum(-1)
        return total.T


def levels_of(radiance: Tensor) -> list[Tensor]:
    """The means over the cells of every ring, kept for as long as the map is, unchanged."""

    def make() -> list[Tensor]:
        blur = SphereBlur(radiance)
        # rings whose cells differ by a fifth share a map
        steps = [round(math.log(ring.size) / math.log(1.2)) for ring in rings()]
        maps = {step: blur.octahedral(_SIGMA * 1.2**step) for step in set(steps)}
        return [maps[step] for step in steps]

    return _levels.get(radiance, None, make)


def _read(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """`[C, n, J]` of `[C, H, W]`, bilinear, shared among the threads by images of a batch."""
    threads = torch.get_num_threads() if u.shape[0] % torch.get_num_threads() == 0 else 1
    at = torch.stack([u, v], dim=-1).view(threads, -1, *u.shape[1:], 2)
    found = grid_sample(image.expand(threads, -1, -1, -1), at, align_corners=True)
    return found.transpose(0, 1).reshape(len(image), *u.shape)


def shade_surroundings(
    material: Reflection, normal: Tensor, view: Tensor, light: EnvironmentLight
) -> Tensor:
    """`[B, 3, H, W]` float32 radiance of unit (or zero) normals and views."""
    size = torch.broadcast_shapes(normal.shape, view.shape)
    shape = (size[0], 3, *normal.shape[2:])
    n = normal.float().expand(shape).movedim(1, -1).reshape(-1, 3)
    distant = view.shape[-2:] == (1, 1) and view.shape[0] == 1
    v = view.float().expand(shape).movedim(1, -1).reshape(-1, 3)
    seen = ((n * v).sum(1) > 0).nonzero()[:, 0]
    n, v = n[seen], v[seen]
    radiance = _radiance_under(material, light)
    table = _fitting_table(radiance, n, v[:1] if distant else v, light.tolerance)
    shown = radiance(n, v) if table is None else table.read_pixels(n, v)
    image = n.new_zeros(shape[0] * shape[2] * shape[3], 3)
    image[seen] = shown
    factor = checked("intensity", light.intensity, may_be_one=True).float()
    return (image * factor).view(shape[0], *shape[2:], 3).movedim(-1, 1)


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
    def over(cls, views: Tensor) -> ViewGrid | None:
        """None where they span more than a hemisphere can show well."""
        middle = normalize(views.mean(0), dim=0)
        if float((views @ middle).min()) < 0.5:
            return None
        least = torch.nn.functional.one_hot(middle.abs().argmin(), 3).to(middle)
        across = normalize(torch.linalg.cross(least, middle), dim=0)
        axes = torch.stack([across, torch.linalg.cross(middle, across), middle])
        flat = views @ axes[:2].T
        low, high = flat.amin(0), flat.amax(0)
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
        radiance: `[3, views · S, S]`, one octahedral map below the other.
        side: S.
    """

    radiance: Tensor
    side: int
    grid: ViewGrid

    def read_pixels(self, normal: Tensor, view: Tensor) -> Tensor:
        """`[N, 3]` for unit normals and views `[N, 3]`."""
        image = torch.empty_like(normal)
        height = self.radiance.shape[1]
        for block in range(0, len(normal), _BLOCK):
            here = slice(block, block + _BLOCK)
            total = torch.zeros(3, len(normal[here]))
            for node, weight, u, v in _places(self.grid, normal[here], view[here]):
                row = (v + 1) * ((self.side - 1) / 2) + node * self.side
                found = _read(self.radiance, u[:, None], (row * (2 / (height - 1)) - 1)[:, None])
                total += found[..., 0] * weight
            image[here] = total.T
        return image


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


def _radiance_under(material: Reflection, light: EnvironmentLight) -> Radiance:
    """How pixels by themselves are computed: the factor `intensity` is left to the caller.

    A measured model is broad, and its kernel is fast: distant lamps are nearer to the truth. What
    may be polished is summed by rings.
    """
    if type(material) is not RadenBrdf:
        return Surroundings.of(light, ring_weights(material)).radiance
    lamps = lamps_of(light)

    def radiance(normal: Tensor, view: Tensor) -> Tensor:
        n, v = (x.T.reshape(1, 3, 1, -1) for x in (normal, view))
        return kernel.shade(material, n, v, None, None, None, lamps)[0, :, 0].T

    return radiance


def lamps_of(light: EnvironmentLight) -> Tensor:
    """Those that stand for it to a measured model, of intensity 1, `packed`."""
    lamps = replace(light, intensity=1.0).kept_lamps(_LAMPS)
    return packed([lamps], None, torch.zeros(1, 3, 1, 1))


def _fitting_table(
    radiance: Radiance, normal: Tensor, view: Tensor, tolerance: float
) -> MirrorTable | None:
    """A table within the tolerance, or None where pixels by themselves are done sooner."""
    pixels = len(normal)
    if pixels < 4 * PROBES:
        return None
    grid = ViewGrid.over(view)
    if grid is None:
        return None
    probes = torch.linspace(0, pixels - 1, PROBES).long()
    n, v = normal[probes], view.expand(pixels, 3)[probes]
    truth = radiance(n, v)
    allowed = tolerance * float(truth.abs().max())
    for side in _SIDES:
        used = _nodes_read(grid, normal, view.expand(pixels, 3), side)
        if int(used.sum()) > pixels / 2:
            return None
        table = _table(radiance, grid, used, side)
        error = (table.read_pixels(n, v) - truth).abs().amax(1)
        if float(error.quantile(SURE)) <= allowed:
            return table
    return None


def _nodes_read(grid: ViewGrid, normal: Tensor, view: Tensor, side: int) -> Tensor:
    """`[views, S, S]` bool: the nodes that a frame's pixels are read from."""
    used = torch.zeros(grid.count**2, side, side, dtype=torch.bool)
    for n, w in zip(normal.split(_BLOCK), view.split(_BLOCK), strict=True):
        for node, _, *place in _places(grid, n, w):
            x, y = (((m + 1) * ((side - 1) / 2)).long().clamp(0, side - 2) for m in place)
            used.view(-1)[(node * side + y) * side + x] = True
    for shift in (1, 2):
        used |= used.roll(1, dims=shift)
    return used


def _table(radiance: Radiance, grid: ViewGrid, used: Tensor, side: int) -> MirrorTable:
    which, row, column = used.nonzero(as_tuple=True)
    mirror = octahedral_directions(side).float()[:, row, column].T
    view = grid.views()[which]
    half = mirror + view
    # R = −V is the silhouette, where N is any normal across V
    normal = normalize(half, dim=1)
    values = torch.zeros(3, grid.count**2 * side, side)
    values.view(3, -1)[:, used.flatten()] = radiance(normal, view).T
    return MirrorTable(values, side, grid)
