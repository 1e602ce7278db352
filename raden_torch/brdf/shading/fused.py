"""What the fused kernel shades in one pass: one table; several, which an index chooses or weights
mix; or those of a material that turns with the sample. None where the eager form, or another way,
has to do it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.surface import Reflection, SurfaceReflection
from raden_torch.brdf.model import kernel, shading_kernel
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.eager import is_recorded
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.from_afar import lamps_from_afar
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import KernelLight, Light, packed
from raden_torch.brdf.shading.triples import Triple, as_map

Kept = tuple[dict[tuple[int, ...], Tensor], tuple[int, ...]]
"""Where packed lights are kept, and by what key."""
_MOST_NODES = 1 << 24
"""Whole numbers that single precision holds."""


def in_one_table(model: Reflection, gbuffer: GBuffer) -> RadenBrdf | None:
    """What the fused kernel can read: a `RadenBrdf`, or a baked material, which is read as one."""
    if type(model) is RadenBrdf:
        return model
    if gbuffer.layer_normal is not None and isinstance(model, SurfaceReflection):
        return None  # what has layers and a surface of its own
    baked = getattr(model, "runtime_brdf", None)
    return None if baked is None else cast(RadenBrdf | None, baked())


def shade_one(
    model: RadenBrdf,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    tolerance: float,
    kept: Kept | None = None,
) -> Tensor | None:
    """The image of one model."""
    if is_recorded(model, gbuffer, *lights):
        return None
    trades = tolerance > 0 and gbuffer.normal.device.type in ("cpu", "cuda")
    bound = model.upper_bound() if trades else None
    inputs = kernel_inputs(gbuffer, lights, bound, tolerance, kept)
    if inputs is None or not kernel.takes(model, *inputs):
        return None
    normal, layers, view, position, camera, mask, lamps = inputs
    normal, lamps = cast(Tensor, normal), cast(Tensor, lamps)
    if trades and view is not None and layers is None and normal.device.type == "cpu":
        sphere = lamps_from_afar(model, normal, view, lights, lamps, tolerance / 2)
        if sphere is not None:
            return shading_kernel.look_up(sphere, normal, mask)
    return shading_kernel.shade(model, normal, view, position, camera, mask, lamps, layers)


def shade_several(
    models: Sequence[RadenBrdf | None],
    choice: Tensor,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    tolerance: float,
) -> Tensor | None:
    """The image of several models in one pass on the CPU; there is no lit sphere.

    Args:
        models: None is black.
        choice: indices or weights, as `shading_kernel.shade_several` takes them.
    """
    read = [model for model in models if model is not None]
    weighted = choice.is_floating_point()
    if not read or (weighted and len(models) > min(len(read), shading_kernel.MOST_WEIGHTS)):
        return None
    if gbuffer.normal.device.type != "cpu" or choice.device.type != "cpu":
        return None
    if choice.requires_grad and torch.is_grad_enabled():
        return None
    if any(is_recorded(model, gbuffer, *lights) for model in read):
        return None
    bound = None
    if tolerance > 0:
        bound = torch.stack([model.upper_bound().float() for model in read]).amax(0)
    inputs = kernel_inputs(gbuffer, lights, bound, tolerance)
    if inputs is None or not all(kernel.takes(model, *inputs) for model in read):
        return None
    return shading_kernel.shade_several(models, choice, inputs)


def shade_turned(
    model: AnisotropicBrdf, gbuffer: GBuffer, lights: Sequence[Light]
) -> Tensor | None:
    """The image of a G-buffer with tangents, on the CPU: two of the model's tables a pixel."""
    tangent = cast(Tensor, gbuffer.tangent)
    if torch.compiler.is_compiling() or gbuffer.normal.device.type != "cpu":
        return None
    if is_recorded(model, gbuffer, *lights) or len(model) * model.layout.nodes > _MOST_NODES:
        return None
    inputs = kernel_inputs(gbuffer, lights)
    if inputs is None or not kernel.takes_tensors(*inputs, tangent, *model.parameters()):
        return None
    turns = [math.radians(x) for x in model.azimuth_deg], math.radians(model.period_deg)
    return shading_kernel.shade_turned(model.tables(), model.layout.warp, turns, tangent, inputs)


def is_lamp(light: Light) -> bool:
    """Whether a light is to the kernel a lamp, or lamps, whatever it shines on."""
    return isinstance(light, KernelLight) or (
        isinstance(light, EnvironmentLight) and light.samples is not None
    )


def kernel_inputs(
    gbuffer: GBuffer,
    lights: Sequence[Light],
    bound: Tensor | None = None,
    tolerance: float = 0.0,
    kept: Kept | None = None,
) -> tuple[Tensor | None, ...] | None:
    """Maps and packed lights, as the kernel takes them; None where it does not know a light.

    Args:
        bound: `[3]`, the most that any model reflects, where lights may be left out.

    Raises:
        InputError: lights of another batch than the normals.
    """
    lights = [x.kept_lamps() if isinstance(x, EnvironmentLight) else x for x in lights]
    known = [light for light in lights if isinstance(light, KernelLight)]
    if len(known) < len(lights):
        return None
    normal, position = gbuffer.normal, gbuffer.position
    view = gbuffer.view if isinstance(gbuffer.view, Tensor) else None
    camera = None if view is not None else as_map(cast(Triple, gbuffer.camera), normal)[..., 0, 0]
    if kept is None or bound is not None:
        # one half for the lights that are left out, one for the lit sphere
        may_be_lost = 0.0 if bound is None else tolerance / 2 / bound
        lamps = packed(known, position, normal, may_be_lost)
    else:
        found, key = kept
        if key not in found:
            found[key] = packed(known, position, normal)
        lamps = found[key]
    for lamp in lamps[:1]:
        geometry.check_vector_maps(normal=normal, light=lamp[:, 1:4, None, None])
    return normal, gbuffer.layer_normal, view, position, camera, floating(gbuffer.mask), lamps


def floating(mask: Tensor | None) -> Tensor | None:
    """A mask in floating point."""
    return mask if mask is None or mask.is_floating_point() else mask.to(torch.float32)
