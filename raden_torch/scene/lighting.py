"""A dressed box under lights: each kind of material by what is fastest for it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import normalize

from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.area_lights import RectangleLight
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light, directions_of
from raden_torch.brdf.shading.shade import shade
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


def lit_box(
    dressing: Dressing,
    dressed: Dressed,
    camera: Place,
    lights: Sequence[Light],
    table: LitTable | None,
) -> Tensor:
    """`[3, N]` radiance of a dressed box."""
    image = torch.zeros_like(dressed.position)
    lamps = [
        light.lamps(_LAMPS) if isinstance(light, EnvironmentLight) else light for light in lights
    ]
    for lies, normal in enumerate(dressed.normals):
        rows = [k for k, c in enumerate(dressing.coverings) if c.lies == lies]
        if not rows:
            continue
        weights = dressed.weights[rows]
        weights = torch.where(weights > _LEAST, weights, 0.0)
        here = (weights.sum(0) > 0).nonzero()[:, 0]
        if len(here):
            gbuffer = _gbuffer(normal[:, here], dressed.position[:, here], camera)
            materials = [dressing.coverings[k].body for k in rows]
            image[:, here] += _mixed(materials, weights[:, here], gbuffer, lamps)
    _add_polish(image, dressing, dressed, camera, lights, table)
    return image


def _mixed(
    materials: Sequence[Reflection], weights: Tensor, gbuffer: GBuffer, lights: Sequence[Light]
) -> Tensor:
    """`[3, N]` of materials by their weights `[K, N]`, not all 0 anywhere."""
    share = weights.sum(0)
    mixed = GBuffer(
        gbuffer.normal,
        position=gbuffer.position,
        camera=gbuffer.camera,
        material=(weights / share)[None, :, None],
    )
    return shade(Palette(materials), mixed, lights)[0, :, 0] * share


def _gbuffer(normal: Tensor, position: Tensor, camera: Place) -> GBuffer:
    return GBuffer(normal[None, :, None], position=position[None, :, None], camera=camera)


def _add_polish(
    image: Tensor,
    dressing: Dressing,
    dressed: Dressed,
    camera: Place,
    lights: Sequence[Light],
    table: LitTable | None,
) -> None:
    """What the polished face reflects, where there is one."""
    rows = [k for k, c in enumerate(dressing.coverings) if c.polished]
    share = dressed.weights[rows].sum(0)
    here = (share > _LEAST).nonzero()[:, 0]
    if not len(here):
        return
    normal, position = dressed.normals[0][:, here], dressed.position[:, here]
    view = normalize(torch.tensor(camera)[:, None] - position, dim=0)
    mirror, cosine = mirrored(normal, view)
    seen = torch.zeros_like(normal)
    small = []
    for light in lights:
        if isinstance(light, EnvironmentLight):
            seen += MirroredSurroundings(light, dressing.polish.roughness).at(mirror)
        elif isinstance(light, RectangleLight):
            seen += mirrored_rectangle(light, position, mirror)
        else:
            small.append(light)
    if table is not None:
        down = (mirror[1] < -1e-3).nonzero()[:, 0]
        at = position[:, down] - mirror[:, down] * (position[1, down] / mirror[1, down])
        seen[:, down] = table.mirrored(at)
    light_of = seen * reflected_share(dressing.polish, cosine)
    light_of += _lamps_in(dressing.polish, normal, position, view, small)
    image[:, here] += light_of * share[here]


def _lamps_in(
    face: Coated, normal: Tensor, position: Tensor, view: Tensor, lights: Sequence[Light]
) -> Tensor:
    """`[3, N]` the highlights of lamps in a face."""
    total = torch.zeros_like(normal)
    # 1 - 1 / (1 + 20²) of a GGX lobe lies within this angle of its facets' normal
    least = 1 / math.sqrt(1 + (_FACETS_WITHIN * face.roughness) ** 2)
    everywhere = position[None, :, None]
    for light in lights:
        for towards, irradiance in directions_of(light, everywhere, everywhere):
            to = normalize(towards, dim=1)[0, :, 0].expand_as(normal)
            half = normalize(to + view, dim=0)
            near = ((normal * half).sum(0) > least).nonzero()[:, 0]
            if not len(near):
                continue
            n, towards_lamp, v = (m[None, :, None, near] for m in (normal, to, view))
            cosine = (n * towards_lamp).sum(1, keepdim=True).clamp(min=0)
            e = irradiance.expand(1, 3, 1, normal.shape[1])[..., near]
            total[:, near] += (face.gloss(n, towards_lamp, v) * e * cosine)[0, :, 0]
    return total
