"""Shading of a material that turns with the sample, by the fused kernel: one pass, two reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.model import kernel
from raden_torch.brdf.shading.eager import is_recorded
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import KernelLight, Light, packed
from raden_torch.brdf.shading.triples import Triple, as_map

_MOST_NODES = 1 << 24
"""Whole numbers that single precision holds."""


def shade_turned(
    model: AnisotropicBrdf, gbuffer: GBuffer, lights: Sequence[Light]
) -> Tensor | None:
    """The image of a G-buffer with tangents, or None where the eager form has to do it.

    Args:
        lights: without a visibility map.
    """
    tangent = cast(Tensor, gbuffer.tangent)
    if torch.compiler.is_compiling() or gbuffer.normal.device.type != "cpu":
        return None
    if is_recorded(model, gbuffer, *lights) or len(model) * model.layout.nodes > _MOST_NODES:
        return None
    lights = [x.kept_lamps() if isinstance(x, EnvironmentLight) else x for x in lights]
    known = [light for light in lights if isinstance(light, KernelLight)]
    if len(known) < len(lights):
        return None
    normal, position, mask = gbuffer.normal, gbuffer.position, gbuffer.mask
    if mask is not None and not mask.is_floating_point():
        mask = mask.to(torch.float32)
    view = gbuffer.view if isinstance(gbuffer.view, Tensor) else None
    camera = None if view is not None else as_map(cast(Triple, gbuffer.camera), normal)[..., 0, 0]
    lamps = packed(known, position, normal)
    maps = (normal, gbuffer.layer_normal, view, position, camera, mask, lamps)
    if not kernel.takes_tensors(*maps, tangent, *model.parameters()):
        return None
    for lamp in lamps[:1]:
        geometry.check_vector_maps(normal=normal, light=lamp[:, 1:4, None, None])
    turns = [math.radians(x) for x in model.azimuth_deg], math.radians(model.period_deg)
    return kernel.shade_turned(model.tables(), model.layout.warp, turns, tangent, maps)
