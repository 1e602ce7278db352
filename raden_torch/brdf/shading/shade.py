"""Deferred shading: a model, a G-buffer and lights become scene-linear radiance."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from numbers import Real
from typing import Any, Literal, cast, get_args, overload

import torch
from torch import Tensor

from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.metal import Powder
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model import kernel
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.parts import parts_of
from raden_torch.brdf.shading import latlong
from raden_torch.brdf.shading.area_lights import AreaLight
from raden_torch.brdf.shading.by_material import shade_palette
from raden_torch.brdf.shading.eager import is_recorded, maps_of, shade_eagerly
from raden_torch.brdf.shading.environment import DistantLamps, EnvironmentLight
from raden_torch.brdf.shading.from_afar import surroundings_from_afar
from raden_torch.brdf.shading.fused import (
    floating,
    in_one_table,
    is_lamp,
    shade_one,
    shade_several,
    shade_turned,
)
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import DirectionalLight, Light, checked_visibility
from raden_torch.brdf.shading.radiance_std import RadianceStd, shade_with_std
from raden_torch.brdf.shading.surroundings import shade_surroundings
from raden_torch.errors import InputError, check_type

_LAMPS_NAMED = 4
_LIGHTS = get_args(Light)


@overload
def shade(
    model: Reflection,
    gbuffer: GBuffer,
    lights: Sequence[Light] | Light,
    *,
    tolerance: float = 0.0,
    return_std: Literal[False] = False,
) -> Tensor: ...
@overload
def shade(
    model: Reflection,
    gbuffer: GBuffer,
    lights: Sequence[Light] | Light,
    *,
    tolerance: float = 0.0,
    return_std: Literal[True],
) -> tuple[Tensor, RadianceStd]: ...
def shade(
    model: Reflection,
    gbuffer: GBuffer,
    lights: Sequence[Light] | Light,
    *,
    tolerance: float = 0.0,
    return_std: bool = False,
) -> Tensor | tuple[Tensor, RadianceStd]:
    """Outgoing radiance, L_r = Σ f_r E cos θi (Take 2012, eq. (1), summed over the lights).

    Args:
        model: the reflection model, a `RadenBrdf` or anything that reflects like one; or a
            `Palette`, of which `gbuffer.material` chooses for each pixel.
        gbuffer: the scene; half-precision maps are computed in float32.
        lights: directional, point and spot lights, and environments, which are prefiltered where
            that serves (`EnvironmentLight.samples`). No light gives a black image.
        tolerance: the error of a pixel's radiance, in the image's unit, that may be traded for
            time. Above 0, lights, and samples of lamps with a shape, are left out where all that is
            left out at a pixel certainly adds less; and the CPU's kernel reads large frames under
            distant lamps from a `LitSphere`. A material without an `upper_bound`, and gradients,
            leave nothing out in the eager form.
        return_std: also return what the stated errors of the measurement do to the image
            (docs/uncertainty.md): of a model fitted with `std=True`, under directional, point and
            spot lights. Nothing is left out then.

    Returns:
        `[B, 3, H, W]` scene-linear RGB with sRGB primaries, unclipped, multiplied by the mask.
        Every value is finite; invalid pixels are 0. With `return_std` a pair: the image, and a
        `RadianceStd`, whose `own` and `systematic` are standard deviations of the same shape and
        have no gradient.

    Raises:
        InputError: a light needs positions that the G-buffer lacks; shapes or devices do not fit;
            with `return_std`, another material or light, or a model without errors.

    Examples:
        A perfect diffuser under a lamp overhead, and under one at 60° to its normal:

        >>> import numpy as np
        >>> import torch
        >>> import raden_torch as rt
        >>> deg = np.mgrid[0:71:35, -70:71:35, -70:71:35].reshape(3, -1)
        >>> white = rt.BrdfMeasurement(*deg, np.full((75, 3), 100.0), channels=("R", "G", "B"))
        >>> model = rt.fit(white).model
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        >>> gbuffer = rt.GBuffer(up, view=(0, 0, 1))
        >>> for direction in ((0, 0, 1), (3**0.5, 0, 1)):
        ...     image = rt.shade(model, gbuffer, rt.DirectionalLight(direction))
        ...     print([round(value, 4) for value in image.flatten().tolist()])
        [1.0, 1.0, 1.0]
        [0.5, 0.5, 0.5]
    """
    check_type("lights", lights, (Sequence, *_LIGHTS), "give a list of lights")
    lights = [lights] if isinstance(lights, Light) else list(lights)
    if isinstance(model, SpectralBrdf):
        raise InputError(
            'model: expected a material, got a spectral model; model.under("D65") is one'
        )
    if not hasattr(model, "of_unit_vectors"):
        raise InputError(
            f"model: expected a material, got {type(model).__name__}; fit(…).model is one, "
            "load_model reads one from a file"
        )
    check_type("gbuffer", gbuffer, GBuffer, "make it by GBuffer(normal=…, view=…)")
    check_type("tolerance", tolerance, (float, Real))
    if not 0 <= tolerance < float("inf"):
        raise InputError(f"tolerance: expected a radiance of 0 or more, got {tolerance}")
    for place, light in enumerate(lights):
        check_type(f"lights[{place}]", light, _LIGHTS)
    if return_std:
        return shade_with_std(model, gbuffer, lights, partial(_shaded, model, gbuffer, lights, 0.0))
    return _shaded(model, gbuffer, lights, tolerance)


def _shaded(
    model: Reflection, gbuffer: GBuffer, lights: Sequence[Light], tolerance: float
) -> Tensor:
    """The image under lights, of which some may be seen by a part of the pixels."""
    open_lights = [light for light in lights if light.visibility is None]
    # what has a visibility map is shaded by itself, and may lose its share
    tolerance /= max(1, len(lights) - len(open_lights) + bool(open_lights))
    image = None
    if open_lights or len(open_lights) == len(lights):
        image = _lit(model, gbuffer, open_lights, tolerance)
    for light in lights:
        if light.visibility is not None:
            seen = checked_visibility(light, gbuffer)
            part = _lit(model, gbuffer, [light], tolerance)
            part = part * seen.to(part)
            image = part if image is None else image + part
    return cast(Tensor, image)


def _lit(
    model: Reflection,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    tolerance: float,
    kept: dict[tuple[int, ...], Tensor] | None = None,
) -> Tensor:
    """The image under lights that every pixel sees.

    Args:
        kept: where the materials of a palette keep what `packed` makes of their lights.
    """
    if _takes_gains(model, gbuffer):
        return _with_gains(model, gbuffer, lights, tolerance, kept)
    if isinstance(model, AnisotropicBrdf) and gbuffer.tangent is None:
        model = model.mean()
    if isinstance(model, Palette):
        return shade_palette(model, gbuffer, lights, tolerance, partial(_lit, kept={}))
    if isinstance(model, Powder) and model.varies:
        return _sprinkled(model, gbuffer, lights, tolerance)
    if type(model) is RadenBrdf:
        model.check_device(gbuffer.normal)
    around: list[EnvironmentLight] = []
    shaped: list[Light] = []
    lamps: list[Light] = []
    for light in lights:
        if isinstance(light, EnvironmentLight) and _is_prefiltered(model, gbuffer, light):
            around.append(light)
        else:
            (shaped if isinstance(light, AreaLight) else lamps).append(light)
    # each way of shading may lose its share
    share = tolerance / max(1, sum(map(bool, (around, shaped, lamps))))
    image = None
    if lamps or not (around or shaped):
        if isinstance(model, AnisotropicBrdf):
            image = shade_turned(model, gbuffer, lamps)
        elif (one_table := in_one_table(model, gbuffer)) is not None:
            own = None if kept is None else (kept, tuple(id(light) for light in lamps))
            image = shade_one(one_table, gbuffer, lamps, share, own)
        if image is None:
            image = shade_eagerly(model, gbuffer, lamps, share)
    if shaped:
        found = shade_eagerly(model, gbuffer, shaped, share)
        image = found if image is None else image + found
    if around:
        found = _under_surroundings(model, gbuffer, around, share)
        image = found if image is None else image + found
    return cast(Tensor, image)


def _takes_gains(model: Reflection, gbuffer: GBuffer) -> bool:
    """Whether there are gains, and they may be a factor on the whole or on all parts."""
    body, beyond = gbuffer.diffuse_gain, gbuffer.specular_gain
    if body is None and beyond is None:
        return False
    # of a palette of other members, each that is shown is asked
    return body is beyond or not isinstance(model, Palette) or _is_measured(model)


def _is_measured(palette: Palette) -> bool:
    return all(type(model) is RadenBrdf and None not in parts_of(model) for model in palette)


def _with_gains(
    model: Reflection,
    gbuffer: GBuffer,
    lights: Sequence[Light],
    tolerance: float,
    kept: dict[tuple[int, ...], Tensor] | None,
) -> Tensor:
    """The image with factors on I_d and I_s, which multiply the radiance of each part."""
    body, beyond = gbuffer.diffuse_gain, gbuffer.specular_gain
    plain = replace(gbuffer, diffuse_gain=None, specular_gain=None)
    if body is beyond:
        whole = _lit(model, plain, lights, tolerance, kept)
        return whole * cast(Tensor, body).to(whole)
    if isinstance(model, Palette):
        both = zip(*(parts_of(cast(RadenBrdf, m)) for m in model), strict=True)
        parts: Iterable[Reflection | None] = [Palette(cast(Any, each)) for each in both]
    elif type(model) is RadenBrdf:
        parts = parts_of(model)
    else:
        raise InputError(
            "GBuffer diffuse_gain, specular_gain: expected a RadenBrdf, which has the two parts, "
            f"got {type(model).__name__}; one tensor as both is a gain on the whole"
        )
    image = None
    for part, gain in zip(parts, (body, beyond), strict=True):
        if part is None:
            continue
        most = 1.0 if gain is None or not gain.numel() else max(float(gain.detach().amax()), 1.0)
        lit = _lit(part, plain, lights, tolerance / (2 * most), kept)
        lit = lit if gain is None else lit * gain.to(lit)
        image = lit if image is None else image + lit
    return _lit(model, plain, [], 0.0) if image is None else image


def _sprinkled(
    powder: Powder, gbuffer: GBuffer, lights: Sequence[Light], tolerance: float
) -> Tensor:
    """The image of a powder whose density is a map: flakes and ground in one pass where both have a
    table, else each with its share of the mask, so that it is computed only where it shows.

    Raises:
        InputError: a map of another size.
    """
    density = cast(Tensor, powder.density)
    sides = zip(density.shape, gbuffer.normal.shape, (False, True, False, False), strict=True)
    if not all(one or own in (1, side) for own, side, one in sides):
        b, _, h, w = gbuffer.normal.shape
        raise InputError(
            f"density: expected a map [{b}, 1, {h}, {w}], as the normals, got "
            f"{list(density.shape)}; in a palette, give flakes and ground, and their weights"
        )
    share = density.to(gbuffer.normal.device, powder.working_dtype(gbuffer.normal))
    if all(map(is_lamp, lights)):
        tables = [in_one_table(part, gbuffer) for part in (powder.flakes, powder.ground)]
        image = shade_several(tables, share, gbuffer, lights, tolerance)
        if image is not None:
            return image
    mask = 1.0 if gbuffer.mask is None else torch.nan_to_num(gbuffer.mask.to(share), nan=0.0)
    parts = ((powder.flakes, share), (powder.ground, 1 - share))
    return sum(  # type: ignore[return-value]
        _lit(part, replace(gbuffer, mask=own * mask), lights, tolerance) for part, own in parts
    )


def _is_prefiltered(model: Reflection, gbuffer: GBuffer, light: EnvironmentLight) -> bool:
    """Whether radiance is a function of N and V alone, which nobody differentiates."""
    more = (gbuffer.layer_normal, gbuffer.tangent, gbuffer.material)
    if light.samples is not None or any(m is not None for m in more):
        return False
    if is_recorded(model, gbuffer, light):
        return False
    if type(model) is RadenBrdf and not kernel.takes(model, *maps_of(gbuffer)):
        return False
    return gbuffer.normal.device.type == "cpu" and not torch.compiler.is_compiling()


@torch.no_grad()
def _under_surroundings(
    model: Reflection, gbuffer: GBuffer, lights: list[EnvironmentLight], tolerance: float
) -> Tensor:
    """The image under environments, prefiltered, but for those that may be left out."""
    if tolerance > 0 and hasattr(model, "upper_bound"):
        lights = _that_matter(lights, model.upper_bound(), tolerance)
    view, mask = gbuffer.view, floating(gbuffer.mask)
    if isinstance(view, Tensor) and type(model) is RadenBrdf:
        found = surroundings_from_afar(model, gbuffer.normal, mask, view, lights)
        if found is not None:
            return found
    image = torch.zeros(gbuffer.normal.shape)
    for light in lights:
        image = image + shade_surroundings(model, gbuffer, light)
    return image.to(model.working_dtype(*maps_of(gbuffer)))


def _that_matter(
    lights: list[EnvironmentLight], bound: Tensor, tolerance: float
) -> list[EnvironmentLight]:
    """Those whose radiance at a pixel is not certain to fit into the tolerance, all together.

    The irradiance of a plane is at most that of all texels facing it, and π times the largest
    radiance.
    """
    kept = []
    for light in lights:
        radiance = light.scaled().double()
        _, height, width = radiance.shape
        whole = (radiance * latlong.solid_angles(height, width)).sum((1, 2))
        most = torch.minimum(whole, torch.pi * radiance.amax((1, 2)))
        lost = float((most * bound.to(most)).max())
        if lost <= tolerance:
            tolerance -= lost
        else:
            kept.append(light)
    return kept


def warn_if_black(image: Tensor, lights: Sequence[Light]) -> None:
    """Warn where lights leave a whole image black: most often a lamp below the horizon.

    Args:
        image: `[B, 3, H, W]` that was shaded with them.
    """
    if not lights or bool((image != 0).any()):
        return
    lamps = ", ".join(f"{type(light).__name__} {_at(light)}" for light in lights[:_LAMPS_NAMED])
    if all(_is_dark(light) for light in lights):
        warnings.warn(
            f"the picture is black: expected a light of more than 0, got {lamps} without any",
            stacklevel=2,
        )
        return
    more = f" and {len(lights) - _LAMPS_NAMED} more" if len(lights) > _LAMPS_NAMED else ""
    warnings.warn(
        f"the picture is black: no lamp ({lamps}{more}) is above the horizon of anything in view; "
        "directions point to the light (x right, y up, z to the viewer), normals away from the "
        "surface",
        stacklevel=2,
    )


def _is_dark(light: Light) -> bool:
    amounts = (getattr(light, name, None) for name in ("irradiance", "intensity", "radiance"))
    return any(x is not None and not bool((torch.as_tensor(x) != 0).any()) for x in amounts)


def _at(light: Light) -> str:
    if isinstance(light, (EnvironmentLight, DistantLamps)):
        return ""
    place = light.direction if isinstance(light, DirectionalLight) else light.position
    return ",".join(f"{x:g}" for x in torch.as_tensor(place).flatten().tolist()[:3])
