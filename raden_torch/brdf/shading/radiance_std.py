"""Standard deviations of a picture: what the stated errors of a measurement do to its radiance.

An error that all readings share changes the radiance of every lamp together, so its changes add up
with their signs. Readings' own errors are independent: so are those of lamps that read other cells,
whose variances add up; lamps nearer to each other than the measurement's step read the same cells,
and their standard deviations add up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model import kernel, shading_kernel
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.runtime_table import read
from raden_torch.brdf.model.table_errors import TableErrors
from raden_torch.brdf.shading.eager import is_recorded, masked, surface_of
from raden_torch.brdf.shading.fused import kernel_inputs
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import (
    DirectionalLight,
    Light,
    PointLight,
    SpotLight,
    checked_visibility,
)
from raden_torch.brdf.shading.triples import as_map
from raden_torch.errors import InputError

_NODE = 16
"""Numbers of a node, as the kernel reads them."""
_LAMPS = (DirectionalLight, PointLight, SpotLight)

_nodes: WeakKeyDictionary[RadenBrdf, tuple[Tensor, TableErrors, Tensor]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class RadianceStd:
    """Standard uncertainties (k = 1) of an image, `[B, 3, H, W]` each, in its unit; 0 where it is
    masked, or dark.

    Attributes:
        own: by the errors that each reading has by itself: independent from cell to cell.
        systematic: by those that all readings share: the scale, and the zeros of the axes.
    """

    own: Tensor
    systematic: Tensor

    @property
    def total(self) -> Tensor:
        """Both, in quadrature."""
        return torch.hypot(self.own, self.systematic)


def shade_with_std(
    model: Reflection,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    shade: Callable[[], Tensor],
) -> tuple[Tensor, RadianceStd]:
    """The image and its standard deviations; arguments as of `shade`.

    Args:
        shade: the image alone, for what the fused kernel does not take.

    Raises:
        InputError: a model without errors, or whose gains are not 1; gains by pixel; lights that
            are no lamps.
    """
    measured = _checked(model, gbuffer, lights)
    groups = _together(measured, gbuffer, lights)
    found = None
    if not is_recorded(measured, gbuffer, *lights):
        found = _fused(measured, gbuffer, groups)
    if found is not None:
        return found
    image = shade()
    return image, _eagerly(measured, gbuffer, groups, image.detach())


def _checked(model: Reflection, gbuffer: GBuffer, lights: Sequence[Light]) -> RadenBrdf:
    if type(model) is not RadenBrdf:
        raise InputError(
            "return_std: expected the model of one measurement, a RadenBrdf, got "
            f"{type(model).__name__}; standard deviations of other materials are not known"
        )
    if model.errors is None:
        raise InputError(
            "return_std: expected a model that knows its measurement's errors, got one without; "
            "fit(…, std=True), or `raden fit --std`, makes one of a measurement that states them"
        )
    if model.errors.own.shape[:3] != model.layout.shape:
        raise InputError(
            f"return_std: expected the layout that the errors were found for, "
            f"{list(model.errors.own.shape[:3])} nodes, got {list(model.layout.shape)}"
        )
    gains = model.diffuse_gain, model.specular_gain
    if any(isinstance(gain, Tensor) or gain != 1 for gain in gains):
        raise InputError(f"return_std: expected both gains of the model at 1, got {gains}")
    if gbuffer.diffuse_gain is not None or gbuffer.specular_gain is not None:
        raise InputError("return_std: expected a G-buffer without gains, got one with")
    for place, light in enumerate(lights):
        if not isinstance(light, _LAMPS):
            raise InputError(
                f"return_std: lights[{place}]: expected a directional, point or spot light, got "
                f"{type(light).__name__}, from whose directions errors do not add up simply"
            )
    return model


@torch.no_grad()
def _together(model: RadenBrdf, gbuffer: GBuffer, lights: Sequence[Light]) -> list[list[Light]]:
    """The lights in groups: one has another within a step of the measurement, seen from the middle
    of the surface."""
    if len(lights) < 2:
        return [[light] for light in lights]
    like = torch.zeros(1, 3, 1, 1, dtype=torch.float64)
    middle = like
    if gbuffer.position is not None:
        finite = torch.nan_to_num(gbuffer.position.double(), 0.0, 0.0, 0.0)
        middle = finite.mean((0, 2, 3)).view(1, 3, 1, 1).cpu()
    towards = []
    for light in lights:
        is_far = isinstance(light, DirectionalLight)
        at = as_map(light.direction if is_far else light.position, like)[:1]  # type: ignore[union-attr]
        towards.append(geometry.normalised(at if is_far else at - middle).flatten())
    directions = torch.stack(towards)
    assert model.table is not None
    near = torch.deg2rad(torch.tensor(max(model.table.step_deg[:2]), dtype=torch.float64))
    joined = directions @ directions.T > near.cos()
    groups: list[list[int]] = []
    for i in range(len(lights)):
        touched = [g for g in groups if any(joined[i, k] for k in g)]
        groups = [g for g in groups if g not in touched]
        groups.append([*(k for g in touched for k in g), i])
    return [[lights[k] for k in group] for group in groups]


@torch.no_grad()
def _fused(
    model: RadenBrdf, gbuffer: GBuffer, groups: list[list[Light]]
) -> tuple[Tensor, RadianceStd] | None:
    """By the CPU's kernel; None where it cannot."""
    lights = [light for group in groups for light in group]
    if gbuffer.normal.device.type != "cpu" or torch.compiler.is_compiling():
        return None
    if any(light.visibility is not None for light in lights):
        return None
    inputs = kernel_inputs(gbuffer, lights)
    if inputs is None or not kernel.takes(model, *inputs):
        return None
    ends = [k == len(group) - 1 for group in groups for k in range(len(group))]
    assert model.errors is not None
    image, own, systematic = shading_kernel.shade_with_errors(
        _nodes_of(model), model.layout.warp, inputs, model.errors.scale_std, ends
    )
    return image, RadianceStd(own, systematic)


def _nodes_of(model: RadenBrdf) -> Tensor:
    """`[U, V, W, 16]`, made anew where the runtime table was."""
    table, errors = model.runtime_table(), cast(TableErrors, model.errors)
    known = _nodes.get(model)
    if known is None or known[0] is not table or known[1] is not errors:
        nodes = table.new_zeros(*table.shape[:3], _NODE, dtype=torch.float32)
        nodes[..., :3] = table
        nodes[..., 3 : 6 + 3 * len(errors.shared)] = errors.channels
        known = _nodes[model] = (table, errors, nodes)
    return known[2]


@torch.no_grad()
def _eagerly(
    model: RadenBrdf, gbuffer: GBuffer, groups: list[list[Light]], image: Tensor
) -> RadianceStd:
    """The same in torch, lamp by lamp: any dtype and device."""
    errors = cast(TableErrors, model.errors)
    surface = surface_of(gbuffer, image.dtype)
    normal, view = surface.normal, surface.view
    by = normal if surface.layer_normal is None else surface.layer_normal
    table = errors.channels.to(image)
    position = None if gbuffer.position is None else gbuffer.position.to(image.dtype)
    own = torch.zeros_like(image)
    shared = image.new_zeros(len(errors.shared), *image.shape)
    for group in groups:
        together = torch.zeros_like(own)
        for light in group:
            to_light, irradiance = cast(DirectionalLight, light).at(position, normal)
            direction = geometry.normalised(to_light)
            facing = geometry.dot(normal, direction).clamp(min=0)
            arriving = irradiance * facing * (geometry.dot(normal, view) > 0)
            if light.visibility is not None:
                arriving = arriving * checked_visibility(light, gbuffer).to(image)
            found = read(table, model.layout.warp, *torch.broadcast_tensors(by, direction, view))
            together = together + found[:, :3] * arriving
            for k in range(len(shared)):
                shared[k] += found[:, 3 + 3 * k : 6 + 3 * k] * arriving
        own = own + together.square()
    systematic = masked(shared.square().sum(0).sqrt(), gbuffer.mask)
    return RadianceStd(
        masked(own.sqrt(), gbuffer.mask), torch.hypot(systematic, errors.scale_std * image)
    )
