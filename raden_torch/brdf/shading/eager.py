"""Shading in torch, lamp by lamp: any material, any light, any dtype."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Reflection, Surface, reflected
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light, directions_of

_ROUNDING = 1e-4
"""Of the tolerance, kept for the sums' rounding."""


def shade_eagerly(
    model: Reflection, gbuffer: GBuffer, lights: Sequence[Light], tolerance: float = 0.0
) -> Tensor:
    """The image in torch, light by light.

    Args:
        tolerance: the radiance that all samples left out at a pixel may have together.
    """
    dtype = model.working_dtype(*maps_of(gbuffer))
    surface = surface_of(gbuffer, dtype)
    normal, view = surface.normal, surface.view
    position = None if gbuffer.position is None else gbuffer.position.to(dtype)
    image = torch.zeros((), dtype=dtype, device=normal.device)
    # with gradients a table is baked in every call: once is enough for all lights
    material = _Baked(model, model.runtime_table()) if type(model) is RadenBrdf else model
    recorded = is_recorded(model, gbuffer, *lights)
    spare = None if recorded else _Spare.of(model, surface, gbuffer, position, tolerance)
    if spare is not None:
        image = image.new_zeros(spare.lost.expand(-1, 3, -1, -1).shape)
    lamps = (lamp for light in lights for lamp in directions_of(light, position, normal))
    for to_light, irradiance in lamps:
        geometry.check_vector_maps(normal=normal, light=to_light, view=view)
        direction = geometry.normalised(to_light)
        arriving = irradiance * geometry.dot(normal, direction).clamp(min=0)
        if spare is None:
            image = image + reflected(material, surface, direction) * arriving
            continue
        box = spare.left_of(arriving)
        if box is not None:
            f = reflected(material, _cut_surface(surface, box), _cut(direction, box))
            _cut(image, box).add_(f * _cut(arriving, box))
    image = image.expand(torch.broadcast_shapes(image.shape, normal.shape, view.shape))
    return masked(image, gbuffer.mask)


Box = tuple[slice, slice]


@dataclass
class _Spare:
    """What may still be left out, pixel by pixel.

    Attributes:
        bound: `[1, 3, 1, 1]`, what |f_r| cannot exceed.
        inside: `[B, 1, H, W]`, pixels that are shown.
        lost: `[B, 1, H, W]`, the most that was left out so far, in the worst channel.
    """

    bound: Tensor
    inside: Tensor
    lost: Tensor
    tolerance: float

    @classmethod
    def of(
        cls,
        model: Reflection,
        surface: Surface,
        gbuffer: GBuffer,
        position: Tensor | None,
        tolerance: float,
    ) -> _Spare | None:
        """None where everything has to be computed."""
        bound = getattr(model, "upper_bound", None)
        if not tolerance > 0 or bound is None:
            return None
        maps = [surface.normal, surface.view, *([] if position is None else [position])]
        shape = torch.broadcast_shapes(*(m.shape for m in maps))
        shown = (surface.normal != 0).any(1, keepdim=True)
        if gbuffer.mask is not None:
            shown = shown & (gbuffer.mask > 0)
        shown = shown.expand(shape[0], 1, *shape[2:])
        lost = surface.normal.new_zeros(shown.shape)
        most = bound().to(lost).view(1, 3, 1, 1)
        return cls(most, shown, lost, tolerance * (1 - _ROUNDING))

    def left_of(self, arriving: Tensor) -> Box | None:
        """The rows and columns where a sample matters; beyond them it is left out.

        Args:
            arriving: irradiance on the surface.
        """
        most = (arriving.abs() * self.bound).amax(1, keepdim=True)
        after = self.lost + most
        matters = self.inside & ~(after <= self.tolerance)  # NaN matters
        rows, columns = (matters.any(1).any(0).any(k).nonzero()[:, 0] for k in (1, 0))
        if not len(rows):
            self.lost = after
            return None
        down, across = (slice(int(x[0]), int(x[-1]) + 1) for x in (rows, columns))
        box = down, across
        _cut(after, box).copy_(_cut(self.lost, box))
        self.lost = after
        return box


def is_recorded(model: Reflection, *given: object) -> bool:
    """Whether autograd records what is computed of a model, and of what these hold."""
    if not torch.is_grad_enabled():
        return False
    parameters = model.parameters() if isinstance(model, torch.nn.Module) else ()
    gains = (getattr(model, name, None) for name in ("diffuse_gain", "specular_gain"))
    values = (value for each in given for value in vars(each).values())
    tensors = (t for t in (*parameters, *gains, *values) if isinstance(t, Tensor))
    return any(t.requires_grad for t in tensors)


def _cut(values: Tensor, box: Box) -> Tensor:
    """Some rows and columns of a map, where it has them."""
    rows, columns = (
        part if size > 1 else slice(None) for part, size in zip(box, values.shape[-2:], strict=True)
    )
    return values[..., rows, columns]


def _cut_surface(surface: Surface, box: Box) -> Surface:
    maps = {k: v for k, v in vars(surface).items() if isinstance(v, Tensor)}
    return replace(surface, **{k: _cut(v, box) for k, v in maps.items()})


@dataclass(frozen=True)
class _Baked:
    """A model with its runtime table."""

    model: RadenBrdf
    table: Tensor

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return self.model.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        return self.model.of_unit_vectors(n, l, v, self.table)


def masked(image: Tensor, mask: Tensor | None) -> Tensor:
    """Times the mask, 0 where it is not finite."""
    image = torch.where(torch.isfinite(image), image, torch.zeros_like(image))
    if mask is None:
        return image
    return image * torch.nan_to_num(mask.to(image.dtype), nan=0.0).clamp(0, 1)


def maps_of(gbuffer: GBuffer) -> list[Tensor]:
    """The maps whose dtypes decide that of the image."""
    return [m for m in (gbuffer.normal, gbuffer.view, gbuffer.position) if isinstance(m, Tensor)]


def surface_of(gbuffer: GBuffer, dtype: torch.dtype) -> Surface:
    """What a material is told of the G-buffer."""
    normal = geometry.normalised(gbuffer.normal.to(dtype))
    view = geometry.normalised(gbuffer.view_map(normal))
    layers, tangent = gbuffer.layer_normal, gbuffer.tangent
    return Surface(
        normal,
        view,
        None if layers is None else geometry.normalised(layers.to(dtype)),
        None if tangent is None else tangent.to(dtype),
        gbuffer.material,
    )
