"""Colours beyond a display's gamut, brought into it at constant hue and lightness in Oklab.

Source of Oklab: Ottosson, "A perceptual color space for image processing" (2020).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.arrays import Floats
from raden_torch.colorimetry import SRGB, primary_matrix

Gamut = Literal["hue", "clip"]
"""Less chroma at the same hue and lightness, or every channel cut by itself."""
GAMUTS: tuple[Gamut, ...] = get_args(Gamut)

_XYZ_TO_LMS = np.array(
    [
        [0.8189330101, 0.3618667424, -0.1288597137],
        [0.0329845436, 0.9293118715, 0.0361456387],
        [0.0482003018, 0.2643662691, 0.6338517070],
    ]
)
_LMS_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
_HALVINGS = 9
"""Of the interval that the chroma is searched in, before a secant."""
_LEAST_ROOM = 1e-9
_ROUNDING = 1e-5


def oklab(linear: Tensor, chromaticities: Sequence[float] = SRGB) -> Tensor:
    """`[…, 3, H, W]` linear RGB of any range → L (white is 1), a, b.

    Args:
        chromaticities: x, y of the primaries and of their white, which is D65.
    """
    lms = _mixed(_lms_matrix(chromaticities), linear)
    # a third of the time of a power; 0 stays 0
    root = lms.abs().log2_().div_(3).exp2_()
    return _mixed(_LMS_TO_LAB, torch.copysign(root, lms))


def into_gamut(
    linear: Tensor, chromaticities: Sequence[float] = SRGB, *, top: float | None = 1.0
) -> Tensor:
    """Colours with no channel below 0 or above `top`, at the hue and the lightness they had.

    Those inside stay as they are. What is as bright as white or brighter becomes white.

    Args:
        linear: `[…, 3, H, W]`.
        chromaticities: x, y of the display's primaries and of their white, which is D65.
        top: None for scene-linear light, which has no white.
    """
    limit = torch.inf if top is None else top
    pixels = linear.movedim(-3, 0).flatten(1)
    low, high = _extremes(pixels)
    (outside,) = torch.nonzero((low < -_ROUNDING) | (high > limit + _ROUNDING), as_tuple=True)
    inside = pixels.clamp(0, limit)
    if len(outside):
        inside[:, outside] = _less_chroma(pixels[:, outside], chromaticities, limit)
    return inside.unflatten(1, (*linear.shape[:-3], *linear.shape[-2:])).movedim(0, -3)


def _less_chroma(pixels: Tensor, chromaticities: Sequence[float], limit: float) -> Tensor:
    """`[3, N]` by the largest share t of their chroma that is in gamut.

    Every channel is a cubic of t, since the cube roots of LMS are linear in it.
    """
    lab = oklab(pixels[..., None], chromaticities)[..., 0]
    lightness = lab[:1].clamp(0, limit ** (1 / 3))
    root = _mixed(np.asarray(np.linalg.inv(_LMS_TO_LAB)[:, 1:]), lab[1:, :, None])[..., 0]
    to_rgb = np.asarray(np.linalg.inv(_lms_matrix(chromaticities)))
    square = lightness * lightness
    powers = (square * lightness + 0 * root, 3 * square * root, 3 * lightness * root**2, root**3)
    c0, c1, c2, c3 = (_mixed(to_rgb, power[..., None])[..., 0] for power in powers)

    def at(share: Tensor) -> Tensor:
        return torch.addcmul(c0, share, torch.addcmul(c1, share, torch.addcmul(c2, share, c3)))

    share = _last_inside(lambda t: _room(at(t), limit), lightness[0])
    return at(share).clamp_(0, limit)


def _room(rgb: Tensor, limit: float) -> Tensor:
    """`[N]` of `[3, N]`: how far the nearest face of the gamut is; less than 0 outside."""
    low, high = _extremes(rgb)
    return torch.minimum(low, limit - high)


def _extremes(rgb: Tensor) -> tuple[Tensor, Tensor]:
    """As `torch.aminmax` of three rows, which takes several times as long."""
    red, green, blue = rgb
    low = torch.minimum(torch.minimum(red, green), blue)
    return low, torch.maximum(torch.maximum(red, green), blue)


def _last_inside(room: Callable[[Tensor], Tensor], like: Tensor) -> Tensor:
    """`[N]`: where `room` falls below 0 between 0 and 1: by halving, and a secant at the end."""
    inside, step = torch.zeros_like(like), 1.0
    more, less = room(inside), room(torch.ones_like(like))
    for _ in range(_HALVINGS):
        step /= 2
        found = room(inside + step)
        is_inside = found >= 0
        inside += is_inside * step
        more, less = torch.where(is_inside, found, more), torch.where(is_inside, less, found)
    # grey is in gamut but for rounding
    more = more.clamp_(min=0)
    return inside + step * (more / (more - less).clamp_(min=_LEAST_ROOM))


def _lms_matrix(chromaticities: Sequence[float]) -> Floats:
    return np.asarray(_XYZ_TO_LMS @ primary_matrix(chromaticities))


def _mixed(matrix: NDArray[np.floating], planes: Tensor) -> Tensor:
    """A matrix times `[…, C, H, W]`."""
    weights = torch.as_tensor(matrix, dtype=planes.dtype, device=planes.device)
    return torch.einsum("ij,...jhw->...ihw", weights, planes)
