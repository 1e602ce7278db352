"""b = ρ N of each pixel from I_k = s_k b·L_k: least squares, robust, or by the lamps that agree."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from raden_torch.capture.photo.lights_check import MIN_LAMPS
from raden_torch.capture.photo.lit_pixels import LitPixels, sorted_lamps

Method = Literal["robust", "least-squares", "selection"]
METHODS: tuple[Method, ...] = ("robust", "least-squares", "selection")

_SMALLEST_RESIDUAL = 1e-2
"""Of the albedo: below it lamps weigh alike, lest the L1 fit lock on to three of them."""
_RIDGE = 1e-6
_ROUNDS = 12
_KEPT = 2 / 3
"""The share of the lit lamps that "selection" keeps."""


def scaled_lights(lights: Tensor, intensity: Tensor) -> Tensor:
    """`[K, 3]` or `[K, 3, P]` times the lamps' intensities `[K]`."""
    return lights * intensity.view(-1, *[1] * (lights.ndim - 1))


def weighted_fit(part: LitPixels, lights: Tensor, method: Method) -> tuple[Tensor, Tensor]:
    """b `[3, P]` and the weights `[K, P]` that it was found with."""
    weight = part.lit
    b = _least_squares(part.grey, lights, weight)
    if method == "robust":
        for _ in range(_ROUNDS):
            rho = length(b)
            residual = (part.grey - toward(lights, b)).abs_()
            weight = part.lit / torch.maximum(residual, _SMALLEST_RESIDUAL * rho).clamp_(min=1e-12)
            weight *= rho  # so that sums of weights do not depend on the exposure
            b = _least_squares(part.grey, lights, weight)
    elif method == "selection":
        kept = (part.lit.sum(dim=0) * _KEPT).ceil().clamp(min=MIN_LAMPS + 1).long() - 1
        for _ in range(_ROUNDS):
            residual = (part.grey - toward(lights, b)).abs_()
            residual = torch.where(part.lit > 0, residual, torch.inf)
            limit = sorted_lamps(residual).gather(0, kept.clamp(max=len(lights) - 1)[None])
            weight = part.lit * (residual <= limit)
            b = _least_squares(part.grey, lights, weight)
    return b, weight


def _least_squares(grey: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """b `[3, P]` that minimises Σ w (I − L·b)²."""
    weighted = weight * grey
    if lights.ndim == 2:
        p, q, r = lights.T @ weighted
    else:
        p, q, r = (lights * weighted[:, None]).sum(dim=0)
    a, d, f, b, c, e = inverse_moments(lights, weight)
    return torch.stack([a * p + b * q + c * r, b * p + d * q + e * r, c * p + e * q + f * r])


def inverse_moments(lights: Tensor, weight: Tensor) -> tuple[Tensor, ...]:
    """xx, yy, zz, xy, xz, yz `[P]` of (Σ w L Lᵀ)⁻¹, by the adjugate."""
    x, y, z = lights.unbind(1)
    pairs = torch.stack([x * x, y * y, z * z, x * y, x * z, y * z])
    if lights.ndim == 2:
        xx, yy, zz, xy, xz, yz = pairs @ weight
    else:
        xx, yy, zz, xy, xz, yz = (pairs * weight).sum(dim=1)
    # two lamps alone leave a direction free; a ridge of 1e-6 keeps it finite
    trace = (xx + yy + zz).clamp(min=torch.finfo(weight.dtype).tiny)
    xx, yy, zz, xy, xz, yz = (m / trace for m in (xx, yy, zz, xy, xz, yz))
    xx, yy, zz = xx + _RIDGE, yy + _RIDGE, zz + _RIDGE
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = 1 / ((xx * a + xy * b + xz * c).clamp(min=_RIDGE**3) * trace)
    return a * scale, d * scale, f * scale, b * scale, c * scale, e * scale


def length(b: Tensor) -> Tensor:
    """|b| `[P]`; `Tensor.norm` over the first dimension takes fifty times as long."""
    return (b * b).sum(dim=0).sqrt()


def toward(lights: Tensor, b: Tensor) -> Tensor:
    """L·b `[K, P]`."""
    return lights @ b if lights.ndim == 2 else (lights * b).sum(dim=1)
