"""A lit sphere: radiance as a table over the normal, where light and viewer are at infinity.

With L and V the same at every pixel, all that `shade` does depends on N alone. Then many pixels
under many lamps can be read from one picture of a sphere under them. The sphere is as fine as a
tolerance asks for, and not made where it would take longer than the pixels themselves.

The idea is Sloan, Martin, Gooch and Gooch, "The Lit Sphere" (2001); the map from the hemisphere to
the square is the octahedral one (Engelhardt and Dachsbacher, 2008), turned by 45 degrees so that
the horizon is the square's edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

_COARSEST = 129
_HORIZON = 1e-5
"""The outermost nodes lie this far above the horizon: on it, nothing is seen."""

_NODE = 4
"""What a node costs beside its lights, in lights at one pixel: its normal, and the check."""

_PADDING = 8
"""Floats behind the table that a vector load may touch."""


@dataclass(frozen=True)
class LitSphere:
    """Radiance over the hemisphere of normals that the viewer sees.

    Attributes:
        radiance: `[side, side, 3]`, scene-linear RGB at the nodes.
        frame: `[3, 3]`, rows: two axes across, and the direction to the viewer.
        error: the largest difference between the nodes and what every other one predicts, in
            radiance; what is read between the nodes is closer, as a rule by half.
    """

    radiance: Tensor
    frame: Tensor
    error: float


def lit_sphere(
    light_normals: Callable[[Tensor], Tensor],
    view: Tensor,
    lights: int,
    pixels: int,
    tolerance: float,
) -> LitSphere | None:
    """A sphere within the tolerance, or None where the pixels alone are done sooner.

    Args:
        light_normals: normals `[1, 3, S, S]` → radiance `[1, 3, S, S]`.
        view: `[3]`, the direction to the viewer, of any length but not zero.
        lights, pixels: how many of each the sphere would stand for.
        tolerance: the largest error allowed, in radiance.
    """
    frame = _frame(view).to(torch.float32)
    # half of what the pixels would cost themselves; reading them takes most of the rest
    largest = (lights * pixels / (2 * (lights + _NODE))) ** 0.5
    side, coarse = _COARSEST, None
    while side <= largest:
        fine = light_normals(_normals(side, frame))
        if coarse is not None:
            between = interpolate(coarse, size=(side, side), mode="bilinear", align_corners=True)
            error = float((between - fine).abs().amax())
            if error <= tolerance:
                return LitSphere(_rows(fine), frame, error)
            # the table's kinks: twice as fine, half the error
            if error > tolerance * largest / side:
                return None
        coarse, side = fine, 2 * side - 1
    return None


def sphere_of_side(light_normals: Callable[[Tensor], Tensor], view: Tensor, side: int) -> LitSphere:
    """A sphere of `side` x `side` nodes, whose error is not known (NaN)."""
    frame = _frame(view).to(torch.float32)
    return LitSphere(_rows(light_normals(_normals(side, frame))), frame, float("nan"))


def _frame(view: Tensor) -> Tensor:
    z = torch.nn.functional.normalize(view.to(torch.float64), dim=0)
    least = torch.nn.functional.one_hot(z.abs().argmin(), 3).to(z)
    x = torch.nn.functional.normalize(torch.linalg.cross(least, z), dim=0)
    return torch.stack([x, torch.linalg.cross(z, x), z])


def _normals(side: int, frame: Tensor) -> Tensor:
    """`[1, 3, side, side]`: the normal of every node."""
    at = torch.linspace(-1, 1, side, dtype=frame.dtype, device=frame.device)
    down, across = torch.meshgrid(at, at, indexing="ij")
    x, y = (across + down) / 2, (across - down) / 2
    z = (1 - x.abs() - y.abs()).clamp(min=_HORIZON)
    normals = torch.einsum("chw,cd->dhw", torch.stack([x, y, z]), frame)
    return torch.nn.functional.normalize(normals[None], dim=1)


def _rows(image: Tensor) -> Tensor:
    """`[1, 3, S, S]` → `[S, S, 3]` in one piece, with room behind it."""
    rows = image[0].movedim(0, -1)
    return with_room(tuple(rows.shape)).copy_(rows)


def with_room(shape: tuple[int, ...]) -> Tensor:
    """Zeros in one piece, with room behind them that a vector load may touch."""
    count = math.prod(shape)
    return torch.zeros(count + _PADDING)[:count].view(shape)
