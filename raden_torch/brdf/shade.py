"""Deferred shading: a model, a G-buffer and lights become scene-linear radiance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, cast

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf import kernel
from raden_torch.brdf.gbuffer import GBuffer
from raden_torch.brdf.lights import (
    DirectionalLight,
    Light,
    PointLight,
    SpotLight,
    Triple,
    as_map,
    packed,
)
from raden_torch.brdf.model import RadenBrdf
from raden_torch.errors import InputError


class Reflection(Protocol):
    """What `shade` needs of a material; `RadenBrdf` is one."""

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """The dtype to compute in for maps of these dtypes."""

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r in 1/sr of unit (or zero) vectors, 0 below the horizon."""


def shade(model: Reflection, gbuffer: GBuffer, lights: Sequence[Light] | Light) -> Tensor:
    """Outgoing radiance, L_r = Σ f_r E cos θi (Take 2012, eq. (1), summed over the lights).

    Args:
        model: the reflection model, a `RadenBrdf` or anything that reflects like one.
        gbuffer: the scene; half-precision maps are computed in float32.
        lights: directional, point and spot lights. No light gives a black image.

    Returns:
        `[B, 3, H, W]` scene-linear RGB with sRGB primaries, unclipped, multiplied by the mask.
        Every value is finite; invalid pixels are 0.

    Raises:
        InputError: a light needs positions that the G-buffer lacks; shapes or devices do not fit.
    """
    lights = [lights] if isinstance(lights, Light) else list(lights)
    for light in lights:
        if not isinstance(light, (DirectionalLight, PointLight, SpotLight)):
            raise InputError(f"lights: {type(light).__name__} is not a light of raden_torch")
    if type(model) is RadenBrdf:
        model.check_device(gbuffer.normal)
        image = _by_kernel(model, gbuffer, lights)
        if image is not None:
            return image
    maps = [m for m in (gbuffer.normal, gbuffer.view, gbuffer.position) if isinstance(m, Tensor)]
    dtype = model.working_dtype(*maps)
    normal = geometry.normalised(gbuffer.normal.to(dtype))
    view = geometry.normalised(gbuffer.view_map(normal))
    position = None if gbuffer.position is None else gbuffer.position.to(dtype)
    image = torch.zeros((), dtype=dtype, device=normal.device)
    for light in lights:
        to_light, irradiance = light.at(position, normal)
        geometry.check_vector_maps(normal=normal, light=to_light, view=view)
        direction = geometry.normalised(to_light)
        cosine = geometry.dot(normal, direction).clamp(min=0)
        f = model.of_unit_vectors(normal, direction, view)
        image = image + f * (irradiance * cosine)
    image = image.expand(torch.broadcast_shapes(image.shape, normal.shape, view.shape))
    valid = torch.isfinite(image)
    if gbuffer.mask is None:
        return torch.where(valid, image, torch.zeros_like(image))
    mask = torch.nan_to_num(gbuffer.mask.to(dtype), nan=0.0).clamp(0, 1)
    return torch.where(valid, image, torch.zeros_like(image)) * mask


def _by_kernel(model: RadenBrdf, gbuffer: GBuffer, lights: list[Light]) -> Tensor | None:
    """The fused kernel's image, or None where the eager form has to do it."""
    normal, position, mask = gbuffer.normal, gbuffer.position, gbuffer.mask
    view = gbuffer.view if isinstance(gbuffer.view, Tensor) else None
    camera = None if view is not None else as_map(cast(Triple, gbuffer.camera), normal)[..., 0, 0]
    floating = mask if mask is None or mask.is_floating_point() else mask.to(torch.float32)
    lamps = packed(lights, position, normal)
    inputs = (normal, view, position, camera, floating, lamps)
    if not kernel.takes(model, *inputs) or kernel.asks_for_gradient(model, *inputs):
        return None
    for lamp in lamps.unbind(0):
        geometry.check_vector_maps(normal=normal, light=lamp[:, 1:4, None, None])
    return kernel.shade(model, normal, view, position, camera, floating, lamps)
