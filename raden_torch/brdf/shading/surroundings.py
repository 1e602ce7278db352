"""A frame under an environment, read from a table over the mirror direction and the view.

The lit sphere (Sloan et al. 2001) for surroundings and for cameras that are not at infinity
(`mirror_table.py`). Only nodes that the frame reads are computed. The table is refined until pixels
of the frame that are computed by themselves agree with it. Of a large frame, every so many pixels
tell which nodes are read; the few pixels that read others are computed by themselves.

Nodes of a measured model are summed over distant lamps by the fused kernel; those of other
materials, which may be polished, by a quadrature about R (`mirror_rings.py`) from the surroundings
blurred by the size of its cells (`latlong.SphereBlur`), which are kept for as long as the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model import kernel, shading_kernel
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.eager import masked
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.kept_by_map import KeptByMap
from raden_torch.brdf.shading.latlong import (
    SphereBlur,
    about_y,
    octahedral,
)
from raden_torch.brdf.shading.lights import packed
from raden_torch.brdf.shading.mirror_rings import mirror_axes, ring_weights, rings, row_of
from raden_torch.brdf.shading.mirror_table import (
    MirrorTable,
    ViewGrid,
    maps_of,
    nodes_read,
    read_map,
)
from raden_torch.brdf.shading.triples import checked

_SIDES = (97, 145, 217, 325, 487)
"""Nodes along each side of the tables over R, coarsest first."""
SURE = 0.99
"""The share of pixels that has to be within the tolerance."""
PROBES = 1500
"""Pixels that are computed by themselves, to know the error."""
_CHUNK = 1 << 11
_WHOLE = 1 << 16
"""Of a larger frame, about so many pixels decide which nodes a table has."""
_BEYOND = 0.03
"""Of the span of their views: how far the table's views reach beyond it."""

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
            total += (read_map(level, u, v) * w[:, :, used]).sum(-1)
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


def shade_surroundings(material: Reflection, gbuffer: GBuffer, light: EnvironmentLight) -> Tensor:
    """`[B, 3, H, W]` float32 radiance, times the mask."""
    radiance = _radiance_under(material, light)
    factor = checked("intensity", light.intensity, may_be_one=True).float().view(-1, 1, 1)
    maps = [m for m in maps_of(gbuffer) if m is not None]
    if gbuffer.normal.numel() > 3 * _WHOLE and kernel.takes_tensors(*maps):
        table = _table_of_some(radiance, gbuffer, light.tolerance)
        if table is None or table.is_numbered:
            image = None if table is None else table.read(gbuffer)
            return _completed(radiance, gbuffer, image).mul_(factor)
    normal, view = _unit_maps(gbuffer)
    size = torch.broadcast_shapes(normal.shape, view.shape)
    shape = (size[0], 3, *normal.shape[2:])
    distant = view.shape[-2:] == (1, 1) and view.shape[0] == 1
    n, v = (m.expand(shape).movedim(1, -1).reshape(-1, 3) for m in (normal, view))
    seen = ((n * v).sum(1) > 0).nonzero()[:, 0]
    n, v = n[seen], v[seen]
    table = _fitting_table(radiance, n, v[:1] if distant else v, len(n), light.tolerance)
    image = n.new_zeros(shape[0] * shape[2] * shape[3], 3)
    image[seen] = radiance(n, v) if table is None else table.read_pixels(n, v)
    image = image.view(shape[0], *shape[2:], 3).movedim(-1, 1)
    return masked(image * factor, gbuffer.mask)


def _unit_maps(gbuffer: GBuffer, step: int = 1) -> tuple[Tensor, Tensor]:
    """Unit normals and views, of every `step`-th row and column."""
    first = step // 2

    def some(m: Tensor) -> Tensor:
        rows, columns = (slice(first, None, step) if n > 1 else slice(None) for n in m.shape[2:])
        return m[:, :, rows, columns].float()

    normal, view, position, camera, _ = maps_of(gbuffer)
    if view is None:
        assert position is not None
        assert camera is not None
        view = camera.float()[..., None, None] - some(position)
    else:
        view = some(view)
    return geometry.normalised(some(normal)), geometry.normalised(view)


def _table_of_some(radiance: Radiance, gbuffer: GBuffer, tolerance: float) -> MirrorTable | None:
    """A table for a large frame, made for some of its pixels, evenly, and what is beside them."""
    _, _, height, width = gbuffer.normal.shape
    step = max(1, min(height, width, math.isqrt(gbuffer.normal.numel() // 3 // _WHOLE)))
    normal, view = _unit_maps(gbuffer, step)
    shape = torch.broadcast_shapes(normal.shape, view.shape)
    distant = view.shape[-2:] == (1, 1) and view.shape[0] == 1
    n, v = (m.expand(shape).movedim(1, -1).reshape(-1, 3) for m in (normal, view))
    seen = (n * v).sum(1) > 0
    if gbuffer.mask is not None:
        mask = gbuffer.mask.expand(shape[0], 1, height, width)
        seen &= (mask[:, :, step // 2 :: step, step // 2 :: step] > 0).flatten()
    n, v = n[seen], v[seen]
    pixels = len(n) * step**2
    return _fitting_table(radiance, n, v[:1] if distant else v, pixels, tolerance, wider=True)


def _completed(radiance: Radiance, gbuffer: GBuffer, image: Tensor | None) -> Tensor:
    """An image with the pixels that are missing in it (NaN) computed by themselves."""
    normal, view, position, camera, mask = maps_of(gbuffer)
    b, _, h, w = normal.shape
    if image is None:
        image = torch.full((b, 3, h, w), torch.nan)
    which, row, column = image[:, 0].isnan().nonzero(as_tuple=True)
    if not len(which):
        return image

    def at(m: Tensor) -> Tensor:
        return m.expand(b, -1, h, w)[which, :, row, column].float().T[:, None]  # [C, 1, P]

    n, v = at(normal), None if view is None else at(view)
    if v is None:
        assert position is not None
        assert camera is not None
        v = at(camera[..., None, None]) - at(position)
    n, v = geometry.normalised(n)[:, 0].T, geometry.normalised(v)[:, 0].T
    seen = (n * v).sum(1) > 0
    found = torch.zeros_like(n)
    found[seen] = radiance(n[seen], v[seen])
    if mask is not None:
        share = torch.nan_to_num(at(mask)[0, 0], nan=0.0).clamp(0, 1)
        found *= share[:, None]
    image[which, :, row, column] = found
    return image


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
        return shading_kernel.shade(material, n, v, None, None, None, lamps)[0, :, 0].T

    return radiance


def lamps_of(light: EnvironmentLight) -> Tensor:
    """Those that stand for it to a measured model, of intensity 1, `packed`."""
    lamps = replace(light, intensity=1.0).kept_lamps(_LAMPS)
    return packed([lamps], None, torch.zeros(1, 3, 1, 1))


def _fitting_table(
    radiance: Radiance,
    normal: Tensor,
    view: Tensor,
    pixels: int,
    tolerance: float,
    wider: bool = False,
) -> MirrorTable | None:
    """A table within the tolerance, or None where pixels by themselves are done sooner.

    Args:
        normal: `[N, 3]` of all pixels that count, or of some.
        pixels: how many count.
        wider: whether other pixels than these are read from it, too.
    """
    if pixels < 4 * PROBES:
        return None
    grid = ViewGrid.over(view, _BEYOND if wider else 0.0)
    if grid is None:
        return None
    view = view.expand(len(normal), 3)
    probes = torch.linspace(0, len(normal) - 1, min(PROBES, len(normal))).long()
    n, v = normal[probes], view[probes]
    truth = radiance(n, v)
    allowed = tolerance * float(truth.abs().max())
    for side in _SIDES:
        used = nodes_read(grid, normal, view, side, wider)
        if int(used.sum()) > pixels / 2:
            return None
        table = MirrorTable.of(radiance, grid, used, torch.nan if wider else 0.0)
        # a pixel that reads a missing node is computed by itself
        error = (table.read_pixels(n, v) - truth).abs().nan_to_num(nan=0.0).amax(1)
        if float(error.quantile(SURE)) <= allowed:
            return table
    return None
