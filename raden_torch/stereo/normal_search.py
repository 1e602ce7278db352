"""The normals that fit best of many: where the refinement starts, as a model has several minima."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.stereo.observed_light import ObservedLight, shown

_STEP_DEG = 3.0
_MOST_TURN_DEG = 85.0
"""Of a surface from the camera."""
_MOST_TILT_DEG = 30.0
"""Of film layers below a known surface."""
_NEAR_DEG = 6.0
"""Normals closer than this count as one start."""
_AT_ONCE = 1 << 11


def hemisphere(
    view: Tensor, step_deg: float = _STEP_DEG, widest_deg: float = _MOST_TURN_DEG
) -> Tensor:
    """`[3, M]` normals about a direction `[3]`, evenly: a Fibonacci spiral (Vogel 1979)."""
    local = _spiral(step_deg, widest_deg).to(view)
    a, b = tangents(view[:, None])
    return a * local[0] + b * local[1] + view[:, None] * local[2]


@cache
def _spiral(step_deg: float, widest_deg: float) -> Tensor:
    """`[3, M]` about z, float64."""
    lowest = math.cos(math.radians(widest_deg))
    count = round(2 * math.pi * (1 - lowest) / math.radians(step_deg) ** 2)
    k = torch.arange(count, dtype=torch.float64)
    z = 1 - (1 - lowest) * (k + 0.5) / count
    turn = k * (math.pi * (3 - math.sqrt(5)))
    r = (1 - z * z).sqrt()
    return torch.stack([r * turn.cos(), r * turn.sin(), z])


@cache
def _taken(step_deg: float, widest_deg: float) -> Tensor:
    """`[M, M]`, infinite where two normals of a hemisphere count as one start, else 0."""
    normals = _spiral(step_deg, widest_deg).float()
    near = normals.T @ normals > math.cos(math.radians(_NEAR_DEG))
    return torch.where(near, torch.inf, 0.0)


def tangents(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors `[3, P]` across unit normals `[3, P]` (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = normal
    sign = torch.where(z < 0, -1.0, 1.0).to(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        torch.stack([1 + sign * x * x * a, sign * b, -sign * x]),
        torch.stack([b, sign + y * y * a, -y]),
    )


@dataclass(frozen=True, eq=False)
class Starts:
    """The best few normals of each pixel.

    Attributes:
        normal: `[S, 3, P]`, the best first, none within `_NEAR_DEG` of another.
        gain: `[S, P]` the scale that fits with each.
    """

    normal: Tensor
    gain: Tensor


def search(
    material: Reflection,
    light: ObservedLight,
    starts: int,
    gain: tuple[float, float] | None = None,
) -> Starts:
    """Compare each pixel's values with those of a table of normals, over all lamps and channels.

    Lamps and camera are taken as the pixels' mean sees them; refinement takes each pixel's own.

    Args:
        gain: mean and standard deviation of the logarithm of the scale where it is known.
    """
    middle = light.middle
    if middle.surface is None:
        axis, spaced = middle.view, (_STEP_DEG, _MOST_TURN_DEG)
    else:
        axis, spaced = middle.surface, (_STEP_DEG / 2, _MOST_TILT_DEG)
    normals, taken = hemisphere(axis[:, 0], *spaced), _taken(*spaced).to(axis)
    table = shown(material, normals, middle).flatten(0, 1)
    square = table * table
    found = [
        _best(light.at(index), table, square, taken, starts, gain)
        for index in torch.arange(light.pixels, device=table.device).split(_AT_ONCE)
    ]
    place = torch.cat([p for p, _ in found], 1)
    return Starts(normals[:, place].movedim(0, 1), torch.cat([g for _, g in found], 1))


def _best(
    light: ObservedLight,
    table: Tensor,
    square: Tensor,
    taken: Tensor,
    starts: int,
    gain: tuple[float, float] | None,
) -> tuple[Tensor, Tensor]:
    """Places in the table and scales, `[S, P]` each: of min over g of Σ w (o − g t)²."""
    value = light.value.flatten(0, 1)
    weight = light.weight.flatten(0, 1) ** 2
    both = (weight * value).T @ table
    own = weight.T @ square
    scale = both / own.clamp_(min=1e-30)
    if gain is not None:
        low, high = (math.exp(gain[0] + s * 3 * gain[1]) for s in (-1, 1))
        scale.clamp_(low, high)
    # less Σ w o², which all normals share
    cost = own.mul_(scale).sub_(both.mul_(2)).mul_(scale)
    places, scales = [], []
    for _ in range(starts):
        place = cost.argmin(1)
        places.append(place)
        scales.append(scale.gather(1, place[:, None])[:, 0])
        cost += taken[place]
    return torch.stack(places), torch.stack(scales).clamp(min=1e-12)
