"""What a matt reference of known shape says of the lamps: how bright each is, the response.

The reference is a sphere (its normals follow from its outline) or a flat card.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.lambert_fit import Method
from raden_torch.capture.photo.photometric_stereo import solve_normals
from raden_torch.errors import InputError

RIM = 0.95
"""Of a sphere's radius: beyond it an outline half a pixel off tilts the normals by degrees."""
_EXPONENTS = (0.4, 2.6)
_GRAZING = 0.3
_FEWEST = 100
_MOST_ROUNDS, _STILL = 200, 1e-5
_SAMPLE = 2500
"""Pixels that the response is fitted on; more change its second decimal at most."""


@dataclass(frozen=True)
class ResponseFit:
    """The response that fits a reference of known shape.

    Attributes:
        exponent: the power that makes the photographs linear.
        error_deg: the median angle between solved and true normals with it.
        error_linear_deg: the same with exponent 1.
    """

    exponent: float
    error_deg: float
    error_linear_deg: float

    def __str__(self) -> str:
        return (
            f"response exponent {self.exponent:.2f}: normals of the reference to "
            f"{self.error_deg:.2f} deg (median; {self.error_linear_deg:.2f} with 1)"
        )


def sphere_normals(ball: Ball, size: tuple[int, int], rim: float = RIM) -> tuple[Tensor, Tensor]:
    """`[1, 3, H, W]` surface normals of a sphere and `[1, 1, H, W]` bool where they hold."""
    import numpy as np

    y, x = np.mgrid[: size[0], : size[1]]
    _, normal, _ = ball.surface(x, y)
    inside = torch.from_numpy(ball.inside(size, rim) & np.isfinite(normal).all(-1))[None, None]
    normals = torch.from_numpy(np.nan_to_num(normal)).float().movedim(-1, 0)[None]
    return normals * inside, inside


def relative_intensities(
    images: Tensor,
    lights: Tensor,
    normal: Tensor,
    inside: Tensor,
    *,
    saturated: Tensor | None = None,
    exponent: float = 1.0,
) -> Tensor:
    """`[K]` relative intensities of mean 1 from a matt reference under the same lamps.

    Log I_k − log N·L_k is a sum of the lamp's brightness and the pixel's albedo; both are found by
    medians in turn (Tukey's median polish), over the pixels that each lamp lights well. So stains
    do not matter, nor that no pixel is lit by lamps on opposite sides, if lamps between them link
    them.

    Args:
        images: `[K, C, H, W]` linear light.
        lights: `[K, 3]` directions to the lamps, or `[K, 3, H, W]` as `Lamps.towards` gives them.
        normal: `[1, 3, H, W]` of the reference (or `[1, 3, 1, 1]`, a card).
        inside: `[1, 1, H, W]` bool.
        saturated: `[K, 1, H, W]` bool.

    Raises:
        InputError: a lamp that lights fewer than 100 pixels well, or none that other lamps light.
    """
    where = lights[:, :, None, None] if lights.ndim == 2 else lights
    length = where.norm(dim=1, keepdim=True)
    facing = (where * normal).sum(dim=1, keepdim=True)
    good = inside & (facing / length > _GRAZING)
    if saturated is not None:
        good = good & ~saturated
    grey = images.clamp(min=0).mean(dim=1, keepdim=True) ** exponent
    good, ratio = good.expand_as(grey).flatten(1), (grey / facing.clamp(min=1e-6)).flatten(1)
    good, ratio = (m[:, good.sum(dim=0) > 1] for m in (good, ratio))  # one lamp alone says nothing
    fewest = int(good.sum(dim=1).min())
    if fewest < _FEWEST:
        dark = int(good.sum(dim=1).argmin())
        raise InputError(
            f"reference: expected at least {_FEWEST} pixels lit well by lamp {dark + 1} and by "
            f"another, and not saturated, got {fewest}"
        )
    found = torch.where(good, ratio, torch.nan).nanmedian(dim=1).values
    if not bool((found > 0).all()):
        dark = int(found.nan_to_num().argmin())
        raise InputError(f"reference: photograph {dark + 1} is black; was the lamp on?")
    lamp = _median_polish(torch.where(good & (ratio > 0), ratio.log(), torch.nan)).exp()
    return lamp / lamp.mean()


def _median_polish(table: Tensor) -> Tensor:
    """`[K]` effects of the rows of `[K, P]`, where NaN is nothing known."""
    row = table.nanmedian(dim=1).values
    for _ in range(_MOST_ROUNDS):
        column = (table - row[:, None]).nanmedian(dim=0).values
        change = (table - row[:, None] - column).nanmedian(dim=1).values
        row = row + change
        if float(change.abs().max()) < _STILL:
            break
    return row


def fit_response(
    images: Tensor,
    lights: Tensor,
    normal: Tensor,
    inside: Tensor,
    *,
    method: Method = "robust",
    intensity: Tensor | None = None,
    saturated: Tensor | None = None,
) -> ResponseFit:
    """The exponent with which the solved normals are nearest to those known of a reference.

    How well the photographs agree with each other is no substitute: a wrong exponent bends all of
    them alike (the shared grey sphere's agree best at 0.8, and its normals are best at 1.1).

    Args: as for `solve_normals`; `normal` and `inside` as `sphere_normals` gives them.
    """
    from scipy.optimize import minimize_scalar

    rows, columns = inside[0, 0].nonzero(as_tuple=True)
    if len(rows) < _FEWEST:
        raise InputError(f"reference: expected at least {_FEWEST} pixels, got {len(rows)}")
    step = max(1, len(rows) // _SAMPLE)
    rows, columns = rows[::step], columns[::step]

    def picked(m: Tensor) -> Tensor:
        return m[:, :, rows, columns][:, :, None]

    truth = picked(normal)[0, :, 0]
    some = None if saturated is None else picked(saturated)
    near = lights if lights.ndim == 2 else picked(lights)
    grey = picked(images).mean(dim=1, keepdim=True)

    def error(exponent: float) -> float:
        found = solve_normals(
            grey,
            near,
            method=method,
            intensity=intensity,
            saturated=some,
            exponent=float(exponent),
        )
        return float(angle_deg(found.normal[0, :, 0], truth).median())

    fitted = minimize_scalar(error, bounds=_EXPONENTS, method="bounded", options={"xatol": 0.01})
    return ResponseFit(float(fitted.x), float(fitted.fun), error(1.0))


def angle_deg(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between vectors `[3, P]`, exact for small angles too (2 atan2 of sum, difference)."""
    a, b = (v / v.norm(dim=0).clamp(min=1e-12) for v in (a, b))
    return torch.rad2deg(2 * torch.atan2((a - b).norm(dim=0), (a + b).norm(dim=0)))
