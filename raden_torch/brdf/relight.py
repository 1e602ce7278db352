"""Relight what a mask covers in a photograph, in linear light; leave the rest as it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.brdf.gbuffer import GBuffer
from raden_torch.brdf.lights import DirectionalLight, Light
from raden_torch.brdf.shade import Reflection, shade
from raden_torch.errors import InputError

_LUMINANCE = (0.2126, 0.7152, 0.0722)


def relight(
    model: Reflection,
    photo: Tensor,
    normal: Tensor,
    mask: Tensor,
    lights: Sequence[Light],
    *,
    gain: float | Tensor | None = None,
) -> Tensor:
    """Replace the masked part of photographs by the model under new lights.

    Args:
        photo: `[B, 3, H, W]` scene-linear RGB.
        normal: `[B or 1, 3, H, W]`, x right, y up, z to the viewer, who is far away.
        mask: `[B or 1, 1, H, W]`, 0…1; its soft edge blends in linear light.
        lights: directional lights in the normals' frame.
        gain: the photograph's radiance for a shaded radiance of 1; where None, `matching_gain`.

    Returns:
        `[B, 3, H, W]` scene-linear RGB, equal to `photo` where the mask is 0.

    Raises:
        InputError: sizes that differ, or an empty mask.
    """
    _check_sizes(photo, normal, mask)
    shaded = shade(model, GBuffer(normal, view=(0.0, 0.0, 1.0)), lights)
    if gain is None:
        gain = matching_gain(photo, shaded, mask)
    return photo + mask * (gain * shaded.to(photo.dtype) - photo)


def matching_gain(photo: Tensor, shaded: Tensor, mask: Tensor) -> Tensor:
    """The gain `[B, 1, 1, 1]` that gives the masked part the mean luminance that it had.

    So the new light is exposed as the old one was, and the rest of the photograph fits to it.
    1 where either of them is black.
    """
    weights = photo.new_tensor(_LUMINANCE).view(3, 1, 1)

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
        raise InputError(f"lamps: {count} in a ring; 1…360 was wanted")
    flat, up = math.cos(math.radians(elevation_deg)), math.sin(math.radians(elevation_deg))
    turns = [2 * math.pi * k / count for k in range(count)]
    return [DirectionalLight((flat * math.cos(t), flat * math.sin(t), up)) for t in turns]


def relit_strip(
    model: Reflection,
    photo: Tensor,
    normal: Tensor,
    mask: Tensor,
    lamps: Sequence[Light],
    *,
    gain: float | Tensor | None = None,
) -> Tensor:
    """`[B, 3, H, W · lamps]`: the photographs once under each lamp, one gain for all of them.

    Args: as for `relight`; without a gain, the mean over the lamps keeps the mean luminance.
    """
    _check_sizes(photo, normal, mask)
    gbuffer = GBuffer(normal, view=(0.0, 0.0, 1.0))
    shaded = torch.stack([shade(model, gbuffer, lamp) for lamp in lamps])
    if gain is None:
        gain = matching_gain(photo, shaded.mean(dim=0), mask)
    return torch.cat([photo + mask * (gain * s.to(photo.dtype) - photo) for s in shaded], dim=-1)


def _check_sizes(photo: Tensor, normal: Tensor, mask: Tensor) -> None:
    for name, m, channels in (("photo", photo, 3), ("normals", normal, 3), ("mask", mask, 1)):
        if m.ndim != 4 or m.shape[1] != channels or m.shape[0] not in (1, photo.shape[0]):
            raise InputError(f"{name}: shape {list(m.shape)}; [B, {channels}, H, W] was wanted")
        if m.shape[2:] != photo.shape[2:]:
            (h, w), (ph, pw) = m.shape[2:], photo.shape[2:]
            raise InputError(
                f"{name}: {w} x {h} pixels, the photograph has {pw} x {ph}; equal sizes"
            )
    if not (mask > 0).any():
        raise InputError("mask: it is empty: nothing would be relit")
