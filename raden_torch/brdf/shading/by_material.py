"""Shading with a palette: all that has a table in one pass of the fused kernel, which takes each
pixel's own. What has none is gathered: the pixels of each material are lit as a row of their own,
by the fastest form that it has, and put back. So it is with gradients, on a GPU, and under lights
that the kernel does not know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import cast

import numpy as np
import torch
from torch import Tensor

from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.environment import DistantLamps, EnvironmentLight
from raden_torch.brdf.shading.fused import in_one_table, is_lamp, shade_several
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light

_MAPS = (
    *("normal", "view", "position", "mask", "layer_normal", "tangent"),
    *("diffuse_gain", "specular_gain"),
)
_NO_MATERIAL = 255
"""Beyond the indices of a palette of so many members."""
_LOOKED_FOR = 8
"""So many materials are looked for one by one; more are sorted."""


Shade = Callable[[Reflection, GBuffer, Sequence[Light], float], Tensor]
"""Shades one material, within a tolerance."""


def shade_palette(
    palette: Palette, gbuffer: GBuffer, lights: Sequence[Light], tolerance: float, shade: Shade
) -> Tensor:
    """The image of a palette, `[B, 3, H, W]`.

    Raises:
        InputError: the G-buffer's `material` does not fit the palette.
    """
    material = gbuffer.material
    plain = replace(gbuffer, material=None)
    if material is None:
        if len(palette) > 1:
            palette.of_unit_vectors(gbuffer.normal, gbuffer.normal, gbuffer.normal)
        return shade(palette[0], plain, lights, tolerance)
    low, high = palette.check_material(material, gbuffer.mask)
    dtype = palette.working_dtype(gbuffer.normal)
    if low == high and not material.is_floating_point():
        return shade(palette[low], plain, lights, tolerance).to(dtype)
    lamps = [light for light in lights if is_lamp(light)]
    others = [light for light in lights if not is_lamp(light)]
    share = tolerance / (2 if lamps and others else 1)
    image = None
    has_gains = gbuffer.diffuse_gain is not None or gbuffer.specular_gain is not None
    if (lamps or not others) and dtype == torch.float32 and not has_gains:
        tables = [
            in_one_table(model, plain) if low <= place <= high else None
            for place, model in enumerate(palette)
        ]
        image = shade_several(tables, material, plain, lamps, share)
    if image is None:
        return _gathering(palette, gbuffer, lights, partial(_with_tolerance, shade, tolerance))
    gathering = partial(_with_tolerance, shade, share)
    if None in tables[low : high + 1]:
        rest = torch.tensor([table is None for table in tables])
        shown = rest[material.long().clamp(0, len(palette) - 1)]
        mask = shown if gbuffer.mask is None else gbuffer.mask * shown
        image = image + _gathering(palette, replace(gbuffer, mask=mask), lamps, gathering)
    return image + _gathering(palette, gbuffer, others, gathering) if others else image


def _with_tolerance(
    shade: Shade, tolerance: float, model: Reflection, gbuffer: GBuffer, lights: Sequence[Light]
) -> Tensor:
    return shade(model, gbuffer, lights, tolerance)


def _gathering(
    palette: Palette,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    shade: Callable[[Reflection, GBuffer, Sequence[Light]], Tensor],
) -> Tensor:
    """The image of each material's pixels by themselves, in rows."""
    b, _, h, w = gbuffer.normal.shape
    material = cast(Tensor, gbuffer.material)
    dtype = palette.working_dtype(gbuffer.normal)
    image = gbuffer.normal.new_zeros((b, 3, h * w), dtype=dtype)
    chosen = _small(material, len(palette)).expand(b, -1, h, w).reshape(b, -1, h * w)
    covered = None if gbuffer.mask is None else gbuffer.mask.expand(b, 1, h, w).reshape(b, -1) > 0
    only = _only_one(chosen, covered, len(palette))
    if only is not None:
        return shade(palette[only], replace(gbuffer, material=None), lights).to(dtype)
    # all alive at once: `shade` may know a light by its id
    lights_of = [[_of_image(light, k, b) for light in lights] for k in range(b)]
    for k in range(b):
        inside = None if covered is None else covered[k]
        order, sizes, weights = _order(chosen[k], inside, len(palette))
        if not len(order):
            continue
        rows = _gathered(gbuffer, k, order)
        parts, start = [], 0
        for place, size in enumerate(sizes):
            if size:
                part = shade(palette[place], _cut(rows, start, size), lights_of[k])
                parts.append(part[0, :, 0].to(dtype))
            start += size
        values = torch.cat(parts, 1)
        if weights is None:  # `scatter_` takes half the time of `image[:, order] = …`
            image[k].scatter_(1, order.expand(3, -1), values)
        else:
            image[k].index_add_(1, order, values * weights)
    return image.reshape(b, 3, h, w)


def _small(material: Tensor, count: int) -> Tensor:
    """Indices as bytes, where these reach; weights as they are."""
    if material.is_floating_point() or count > _NO_MATERIAL or material.dtype == torch.uint8:
        return material
    return material.to(torch.uint8)


def _only_one(chosen: Tensor, covered: Tensor | None, count: int) -> int | None:
    """The one material that all covered pixels have, by index."""
    if chosen.dtype != torch.uint8 or not chosen.numel() or count > _NO_MATERIAL:
        return None
    if covered is None:
        low, high = chosen.aminmax()
    else:
        low = torch.where(covered, chosen[:, 0], _NO_MATERIAL).amin()
        high = torch.where(covered, chosen[:, 0], 0).amax()
    return int(low) if int(low) == int(high) else None


def _order(
    chosen: Tensor, inside: Tensor | None, count: int
) -> tuple[Tensor, list[int], Tensor | None]:
    """The pixels of the first material, of the second, …; how many each has; their weights.

    Args:
        chosen: `[1, P]` indices or `[K, P]` weights.
        inside: `[P]`, which pixels count; all where None.
        count: of materials.
    """
    if chosen.is_floating_point():
        # with a gradient, a weight of 0 may grow
        wanted = (chosen > 0) | chosen.requires_grad
        place, order = (wanted if inside is None else wanted & inside).nonzero(as_tuple=True)
        sizes = torch.bincount(place, minlength=count).tolist()
        return order, sizes, chosen[place, order]
    index = chosen[0]
    if count <= _LOOKED_FOR and index.device.type == "cpu" and index.dtype == torch.uint8:
        if inside is not None:
            index = torch.where(inside, index, _NO_MATERIAL)
        found = [np.flatnonzero(index.numpy() == place) for place in range(count)]
        return torch.from_numpy(np.concatenate(found)), [len(each) for each in found], None
    shown = None if inside is None else inside.nonzero()[:, 0]
    order, sizes = _sorted(index if shown is None else index[shown], count)
    return order if shown is None else shown[order], sizes, None


def _sorted(index: Tensor, count: int) -> tuple[Tensor, list[int]]:
    """The places of 0, of 1, …, each in their order, and how many there are of each."""
    if index.device.type != "cpu":
        return index.argsort(stable=True), torch.bincount(index, minlength=count).tolist()
    # NumPy sorts bytes by counting them
    order = torch.from_numpy(np.argsort(index.numpy(), kind="stable"))
    return order, np.bincount(index.numpy(), minlength=count).tolist()


def _gathered(gbuffer: GBuffer, image: int, pixels: Tensor) -> dict[str, Tensor]:
    """Maps of one image at some pixels, `[1, C, 1, P]`, or `[1, C, 1, 1]` where one is for all."""
    _, _, h, w = gbuffer.normal.shape

    def row(name: str, value: Tensor) -> Tensor:
        own = value[image if len(value) > 1 else 0]
        if own.shape[-2:] == (1, 1) and name != "normal":
            return own[None]
        flat = own.expand(-1, h, w).reshape(len(own), h * w)
        # half the time of `flat[:, pixels]`
        return flat.gather(1, pixels.expand(len(own), -1))[None, :, None]

    found = {name: getattr(gbuffer, name) for name in _MAPS}
    rows = {name: row(name, value) for name, value in found.items() if isinstance(value, Tensor)}
    if gbuffer.specular_gain is gbuffer.diffuse_gain and gbuffer.diffuse_gain is not None:
        rows["specular_gain"] = rows["diffuse_gain"]  # a gain on the whole stays one
    if gbuffer.camera is not None:
        camera = _triple_of(gbuffer.camera, image, len(gbuffer.normal))
        rows["camera"] = camera  # type: ignore[assignment]
    return rows


def _cut(rows: dict[str, Tensor], start: int, size: int) -> GBuffer:
    """Some of the gathered pixels as a G-buffer of one row."""
    maps = {
        name: value[..., start : start + size] if name == "normal" or _is_row(value) else value
        for name, value in rows.items()
    }
    if "diffuse_gain" in rows and rows["diffuse_gain"] is rows.get("specular_gain"):
        maps["specular_gain"] = maps["diffuse_gain"]
    return GBuffer(**maps)


def _is_row(value: object) -> bool:
    return isinstance(value, Tensor) and value.ndim == 4 and value.shape[-1] > 1


def _of_image(light: Light, image: int, batch: int) -> Light:
    """A light for one image of a batch."""
    if isinstance(light, (DistantLamps, EnvironmentLight)):  # the same for every image
        return light
    values = {f.name: _triple_of(getattr(light, f.name), image, batch) for f in fields(light)}
    return replace(light, **values)  # type: ignore[arg-type]


def _triple_of(value: object, image: int, batch: int) -> object:
    if batch > 1 and getattr(value, "ndim", 0) == 2 and len(value) == batch:  # type: ignore[arg-type]
        return value[image : image + 1]  # type: ignore[index]
    return value
