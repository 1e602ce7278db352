"""The values of a matt surface's pixels under K lamps, and which of the lamps light each."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.capture.photo.lights_check import MIN_LAMPS


@dataclass(frozen=True, eq=False)
class LitPixels:
    """P pixels.

    Attributes:
        value: `[K, C, P]` linear, 0 or more.
        grey: `[K, P]` the mean of the channels.
        lights: `[K, 3]` or `[K, 3, P]` to the lamps.
        lit: `[K, P]` 1 where the lamp lights the pixel, else 0.
    """

    value: Tensor
    grey: Tensor
    lights: Tensor
    lit: Tensor


@dataclass(frozen=True, eq=False)
class PixelStack:
    """The photographs, pixel by pixel, of which some are worked on at a time.

    Attributes:
        images: `[K, C, H·W]` as read.
        saturated: `[K, H·W]`, or None.
        lights: `[K, 3]`, or `[K, 3, H, W]` for near lamps.
        shadow: a lamp counts as shadowed below this share of the pixel's third brightest, 0…1.
        exponent: of the camera's response.
        dtype: that is computed in.
    """

    images: Tensor
    saturated: Tensor | None
    lights: Tensor
    shadow: float
    exponent: float
    dtype: torch.dtype

    def at(self, index: Tensor) -> LitPixels:
        """Pixels by their numbers `[P]` in H·W."""
        value = self.images[:, :, index].to(self.dtype).clamp(min=0)
        if self.exponent != 1:
            value = value**self.exponent
        value = torch.nan_to_num(value, posinf=0.0)
        grey = value[:, 0] if value.shape[1] == 1 else value.mean(dim=1)
        usable = grey if self.saturated is None else grey * ~self.saturated[:, index]
        # the third brightest: one or two highlights must not make shadows of the rest
        level = sorted_lamps(usable)[-MIN_LAMPS]
        lit = ((usable > self.shadow * level) & (usable > 0)).to(self.dtype)
        # with fewer than three lamps lit, the three brightest unsaturated ones
        few = lit.sum(dim=0) < MIN_LAMPS
        if bool(few.any()):
            lit[:, few] = ((usable[:, few] >= level[few]) & (usable[:, few] > 0)).to(self.dtype)
        lights = self.lights
        if lights.ndim == 4:
            lights = lights.reshape(len(lights), 3, -1)[:, :, index]
        return LitPixels(value, grey, lights, lit)


def sorted_lamps(m: Tensor) -> Tensor:
    """`[K, P]` sorted along K, smallest first, by odd-even transposition: for K of a few dozen and
    many P it is far faster than `torch.sort`, which goes down each column by itself."""
    m = m.clone()
    for i in range(len(m)):
        low, high = m[i % 2 : -1 : 2], m[i % 2 + 1 :: 2]
        smaller = torch.minimum(low, high)
        torch.maximum(low, high, out=high)
        low.copy_(smaller)
    return m
