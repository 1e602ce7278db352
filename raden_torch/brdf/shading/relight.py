"""Relight what a mask covers in a photograph, in linear light; leave the rest as it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.gbuffer import GBuffer, coverage
from raden_torch.brdf.shading.lights import DirectionalLight, Light, directions_of
from raden_torch.brdf.shading.shade import shade, warn_if_black
from raden_torch.colorimetry import SRGB_LUMINANCE
from raden_torch.errors import InputError

Gain = float | Tensor | Callable[[Tensor, Tensor], float]
_NONE: Mapping[str, Tensor] = MappingProxyType({})
_DARK = 0.1
"""Of the brightest shading: below it a photograph knows little of the texture."""


def relight(
    model: Reflection,
    photo: Tensor,
    normal: Tensor,
    mask: Tensor,
    lights: Sequence[Light],
    *,
    gain: Gain | None = None,
    original: Sequence[Light] | None = None,
    material: Tensor | None = None,
    tangent: Tensor | None = None,
    layers: Mapping[str, Tensor] = _NONE,
    curve: Callable[[Tensor], Tensor] | None = None,
) -> Tensor:
    """Replace the masked part of photographs by the model under new lights.

    Args:
        photo: `[B, 3, H, W]` scene-linear RGB.
        normal: `[B or 1, 3, H, W]`, x right, y up, z to the viewer, who is far away.
        mask: `[B or 1, 1, H, W]`, 0…1; its soft edge blends in linear light.
        lights: directional lights in the normals' frame.
        gain: the photograph's radiance for a shaded radiance of 1; where None, `matching_gain`; or
            what finds it from the mean image under the settings and the mask.
        original: the lights that the photographs were taken under: the photographs' own texture
            (see `texture_of`) is kept then. None leaves the model alone.
        material: of a palette, as in `GBuffer.material`.
        tangent: of a model of several azimuths, as in `GBuffer.tangent`.
        layers: `layer_normal` and gains, as in `GBuffer`.
        curve: what the new light goes through before it joins the photograph, which went through a
            camera's.

    Returns:
        `[B, 3, H, W]` scene-linear RGB, equal to `photo` where the mask is 0.

    Raises:
        InputError: sizes that differ, or an empty mask.
    """
    return relit_under(
        model,
        photo,
        normal,
        mask,
        [lights],
        gain=gain,
        original=original,
        material=material,
        tangent=tangent,
        layers=layers,
        curve=curve,
    )[0]


def relit_under(
    model: Reflection,
    photo: Tensor,
    normal: Tensor,
    mask: Tensor,
    settings: Sequence[Sequence[Light] | Light],
    *,
    gain: Gain | None = None,
    original: Sequence[Light] | None = None,
    material: Tensor | None = None,
    tangent: Tensor | None = None,
    layers: Mapping[str, Tensor] = _NONE,
    curve: Callable[[Tensor], Tensor] | None = None,
) -> Tensor:
    """`[settings, B, 3, H, W]`: the photographs once under each setting of lights.

    Args: as for `relight`; one gain for all: the mean over the settings keeps the mean luminance.
    """
    mask = coverage(mask).to(photo.dtype)
    shaded = shaded_under(
        model,
        photo,
        normal,
        mask,
        settings,
        original=original,
        material=material,
        tangent=tangent,
        layers=layers,
    )
    if gain is None:
        gain = matching_gain(photo, shaded.mean(dim=0), mask)
    elif callable(gain):
        gain = gain(shaded.mean(dim=0), mask)
    lit = gain * shaded
    return photo + mask * ((lit if curve is None else curve(lit)) - photo)


def shaded_under(
    model: Reflection,
    photo: Tensor,
    normal: Tensor,
    mask: Tensor,
    settings: Sequence[Sequence[Light] | Light],
    *,
    original: Sequence[Light] | None = None,
    material: Tensor | None = None,
    tangent: Tensor | None = None,
    layers: Mapping[str, Tensor] = _NONE,
) -> Tensor:
    """`[settings, B, 3, H, W]`: what `relit_under` multiplies by its gain and puts in."""
    _check_sizes(photo, normal, mask)
    view = (0.0, 0.0, 1.0)
    gbuffer = GBuffer(normal, view=view, material=material, tangent=tangent, **layers)
    shaded = torch.stack([shade(model, gbuffer, lights) for lights in settings]).to(photo.dtype)
    warn_if_black(shaded, [lamp for s in settings for lamp in ([s] if isinstance(s, Light) else s)])
    return shaded if original is None else shaded * texture_of(photo, normal, mask, original)


def texture_of(photo: Tensor, normal: Tensor, mask: Tensor, lights: Sequence[Light]) -> Tensor:
    """The photographs over a matt surface's shading under the lights they were taken under.

    With I the photograph, s the shading and t̄ the mean texture, (I s + e² t̄)/(s² + e²): I/s where
    there was light, the mean in the shadows, where nothing is known (e is a tenth of the brightest
    shading). Shadows that the object cast on itself, and its highlights, stay in it.

    Args:
        lights: directional lights in the normals' frame.

    Returns:
        `[B, 3, H, W]`, of mean luminance 1 over the mask.
    """
    normals = geometry.normalised(normal.to(photo.dtype))
    shading = torch.zeros_like(photo[:, :1])
    lamps = (lamp for light in lights for lamp in directions_of(light, None, normals))
    for direction, irradiance in lamps:
        cosine = geometry.dot(normals, geometry.normalised(direction)).clamp(min=0)
        shading = shading + cosine * irradiance
    shading = shading * mask / shading.mul(mask).amax().clamp(min=1e-12)
    weights = photo.new_tensor(SRGB_LUMINANCE).view(3, 1, 1)
    area = (mask.expand(len(photo), -1, -1, -1) * shading**2).sum(dim=(2, 3), keepdim=True)
    mean = (mask * photo * shading).sum(dim=(2, 3), keepdim=True) / area.clamp(min=1e-12)
    texture = (photo * shading + _DARK**2 * mean) / (shading**2 + _DARK**2)
    luminance = (mean * weights).sum(dim=1, keepdim=True)
    return texture / torch.where(luminance > 0, luminance, torch.ones_like(luminance))


def matching_gain(photo: Tensor, shaded: Tensor, mask: Tensor) -> Tensor:
    """The gain `[B, 1, 1, 1]` that gives the masked part the mean luminance that it had.

    So the new light is exposed as the old one was, and the rest of the photograph fits to it.
    1 where either of them is black.
    """
    weights = photo.new_tensor(SRGB_LUMINANCE).view(3, 1, 1)

    def light(image: Tensor) -> Tensor:
        return (image * weights * mask).sum(dim=(1, 2, 3), keepdim=True)

    before, after = light(photo), light(shaded.to(photo.dtype))
    usable = (before > 0) & (after > 1e-12)
    return torch.where(usable, before / torch.where(usable, after, 1.0), torch.ones_like(before))


def lamp_ring(count: int, elevation_deg: float = 40.0) -> list[DirectionalLight]:
    """`count` lamps around the viewing axis, the first on the right, then counter-clockwise.

    Args:
        elevation_deg: their angle above the image plane.
    """
    if not 1 <= count <= 360:
        raise InputError(f"lamps: expected a ring of 1…360, got {count}")
    flat, up = math.cos(math.radians(elevation_deg)), math.sin(math.radians(elevation_deg))
    turns = [2 * math.pi * k / count for k in range(count)]
    return [DirectionalLight((flat * math.cos(t), flat * math.sin(t), up)) for t in turns]


def tiled(images: Tensor, columns: int) -> Tensor:
    """`[N, B, C, H, W]` → `[B, C, H · rows, W · columns]`, row by row; empty tiles are black."""
    count, batch, channels, height, width = images.shape
    rows = -(-count // columns)
    empty = images.new_zeros(rows * columns - count, batch, channels, height, width)
    grid = torch.cat([images, empty]).reshape(rows, columns, batch, channels, height, width)
    return grid.permute(2, 3, 0, 4, 1, 5).reshape(batch, channels, rows * height, columns * width)


def _check_sizes(photo: Tensor, normal: Tensor, mask: Tensor) -> None:
    for name, m, channels in (("photo", photo, 3), ("normals", normal, 3), ("mask", mask, 1)):
        if m.ndim != 4 or m.shape[1] != channels or m.shape[0] not in (1, photo.shape[0]):
            raise InputError(f"{name}: expected shape [B, {channels}, H, W], got {list(m.shape)}")
        if m.shape[2:] != photo.shape[2:]:
            (h, w), (ph, pw) = m.shape[2:], photo.shape[2:]
            raise InputError(
                f"`{name}`: expected the photograph's {pw} x {ph} pixels, got {w} x {h}"
            )
    if not (mask > 0).any():
        raise InputError(
            "mask: expected a mask that is above 0 somewhere, got an empty one: nothing would be "
            "relit"
        )
