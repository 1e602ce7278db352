"""Shading with a palette: the pixels of each material are gathered, lit and put back.

A material sees a row of pixels, so its own fastest way of shading is taken, whatever it is, and
where it is not, nothing is computed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.gbuffer import GBuffer

_MAPS = ("normal", "view", "position", "mask", "layer_normal", "tangent")
_L = TypeVar("_L")


def shade_palette(
    palette: Palette,
    gbuffer: GBuffer,
    lights: Sequence[_L],
    shade: Callable[[Reflection, GBuffer, Sequence[_L]], Tensor],
) -> Tensor:
    """The image of a palette, `[B, 3, H, W]`.

    Args:
        lights: dataclasses whose tensors `[B, 3]` are one for each image.
        shade: shades one material.

    Raises:
        InputError: the G-buffer's `material` does not fit the palette.
    """
    b, _, h, w = gbuffer.normal.shape
    material = gbuffer.material
    if material is None:
        if len(palette) > 1:
            palette.of_unit_vectors(gbuffer.normal, gbuffer.normal, gbuffer.normal)
        return shade(palette[0], replace(gbuffer, material=None), lights)
    palette.check_material(material, gbuffer.mask)
    dtype = palette.working_dtype(gbuffer.normal)
    image = gbuffer.normal.new_zeros((b, 3, h * w), dtype=dtype)
    chosen = material.expand(b, -1, h, w).reshape(b, -1, h * w)
    covered = None if gbuffer.mask is None else gbuffer.mask.expand(b, 1, h, w).reshape(b, -1) > 0
    for k in range(b):
        own = [_of_image(light, k, b) for light in lights]
        inside = None if covered is None else covered[k]
        for place, pixels, weight in _parts(chosen[k], inside, len(palette)):
            part = shade(palette[place], _gathered(gbuffer, k, pixels), own)[0, :, 0].to(dtype)
            image[k].index_add_(1, pixels, part if weight is None else part * weight)
    return image.reshape(b, 3, h, w)


def _parts(
    chosen: Tensor, inside: Tensor | None, count: int
) -> Iterator[tuple[int, Tensor, Tensor | None]]:
    """Each material that an image has, its pixels, and their weights.

    Args:
        chosen: `[1, P]` indices or `[K, P]` weights.
        inside: `[P]`, which pixels count; all where None.
        count: of materials.
    """
    if chosen.is_floating_point():
        for place, weight in enumerate(chosen):
            # with a gradient, a weight of 0 may grow
            wanted = (
                torch.ones_like(weight, dtype=torch.bool) if chosen.requires_grad else weight > 0
            )
            pixels = (wanted if inside is None else wanted & inside).nonzero()[:, 0]
            if len(pixels):
                yield place, pixels, weight[pixels]
        return
    index = chosen[0]
    shown = None if inside is None else inside.nonzero()[:, 0]
    index = index if shown is None else index[shown]
    if not len(index):
        return
    order, sizes = _sorted(index, count)
    order = order if shown is None else shown[order]
    for place, pixels in enumerate(order.split(sizes)):
        if len(pixels):
            yield place, pixels, None


def _sorted(index: Tensor, count: int) -> tuple[Tensor, list[int]]:
    """The places of 0, of 1, …, each in their order, and how many there are of each."""
    if index.device.type != "cpu":
        return index.argsort(stable=True), torch.bincount(index, minlength=count).tolist()
    small = index.to(torch.uint8 if count <= 256 else torch.int32).numpy()
    # NumPy sorts bytes by counting them
    order = torch.from_numpy(np.argsort(small, kind="stable"))
    return order, np.bincount(small, minlength=count).tolist()


def _gathered(gbuffer: GBuffer, image: int, pixels: Tensor) -> GBuffer:
    """Pixels of one image as a G-buffer of one row."""
    b, _, h, w = gbuffer.normal.shape

    def row(name: str, value: Tensor) -> Tensor:
        own = value[image if len(value) > 1 else 0]
        if own.shape[-2:] == (1, 1) and name != "normal":
            return own[None]  # one for all pixels
        return own.expand(-1, h, w).reshape(len(own), h * w).index_select(1, pixels)[None, :, None]

    maps = {
        name: row(name, value)
        for name in _MAPS
        if isinstance(value := getattr(gbuffer, name), Tensor)
    }
    return GBuffer(**maps, camera=_triple_of(gbuffer.camera, image, b))  # type: ignore[arg-type]


def _of_image(light: _L, image: int, batch: int) -> _L:
    """A light for one image of a batch."""
    values = {f.name: _triple_of(getattr(light, f.name), image, batch) for f in fields(light)}  # type: ignore[arg-type]
    return replace(light, **values)  # type: ignore[type-var]


def _triple_of(value: object, image: int, batch: int) -> object:
    if batch > 1 and getattr(value, "ndim", 0) == 2 and len(value) == batch:  # type: ignore[arg-type]
        return value[image : image + 1]  # type: ignore[index]
    return value
