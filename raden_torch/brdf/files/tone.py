"""Tone curves: scene-linear light 0…∞ → display-linear 0…1."""

from __future__ import annotations

from typing import Literal, get_args

import torch
from torch import Tensor

Tone = Literal["srgb", "neutral", "aces"]
"""none (what is above 1 is out of gamut); Khronos' PBR Neutral; Narkowicz's fit of ACES."""
TONES: tuple[Tone, ...] = get_args(Tone)

_STRAIGHT_TO, _DESATURATION = 0.8 - 0.04, 0.15
_BASE = 0.08
"""The darkest channel from which the Fresnel reflection that is taken away is 0.04."""


def toned(linear: Tensor, tone: Tone) -> Tensor:
    """`[…, 3, H, W]` display-linear; `linear` as it is for "srgb".

    Args:
        linear: not negative, unless `tone` is "srgb".
    """
    if tone == "neutral":
        return neutral(linear)
    return aces(linear) if tone == "aces" else linear


def neutral(linear: Tensor) -> Tensor:
    """Khronos PBR Neutral: base colours as they are, highlights compressed by one factor for all
    channels and led to white.

    Source: Khronos Group, "PBR Neutral Tone Mapper", specification of 2024.
    """
    low = linear.amin(-3, keepdim=True)
    light = linear - torch.where(low < _BASE, low - 6.25 * low * low, 0.04)
    peak = light.amax(-3, keepdim=True)
    room = 1 - _STRAIGHT_TO
    over = peak.clamp(min=_STRAIGHT_TO)
    reached = 1 - room * room / (over + room - _STRAIGHT_TO)
    towards_white = 1 - 1 / (_DESATURATION * (over - reached) + 1)
    compressed = torch.lerp(light * (reached / over), reached, towards_white)
    return torch.where(peak < _STRAIGHT_TO, light, compressed)


def aces(linear: Tensor) -> Tensor:
    """The filmic curve of ACES' reference rendering and sRGB output transforms, channel by channel.

    Source: Narkowicz, "ACES Filmic Tone Mapping Curve" (2016), with his factor 0.6 on the input,
    by which middle grey has ACES' exposure.
    """
    x = 0.6 * linear
    return ((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)).clamp(0, 1)
