"""The lamps' relative intensities, found in the photographs that normals are solved from."""

from __future__ import annotations

import torch
from torch import Tensor

from raden_torch.capture.photo.lambert_fit import (
    Method,
    inverse_moments,
    length,
    scaled_lights,
    weighted_fit,
)
from raden_torch.capture.photo.lights_check import MIN_LAMPS
from raden_torch.capture.photo.lit_pixels import LitPixels

_TURNS = 6
_TRUST, _INDEPENDENT = 0.1, 1.0
"""Relative standard deviation of intensities said to be slightly wrong; see `refined_intensity`."""


def refined_intensity(part: LitPixels, scale: Tensor, method: Method) -> Tensor:
    """Intensities that fit best; their mean stays 1.

    Σ w (I_k/s_k − L_k·b)² is a square form in t = 1/s once b is eliminated, pixel by pixel. Its
    minimum alone would take up the directions' errors, which neighbouring pixels share; so all
    pixels together count as `_INDEPENDENT` measurements with the variance that is seen, beside the
    intensities given, which are believed to `_TRUST`. Directions and intensities together determine
    both but for a common factor, where K ≥ 5.
    """
    given = scale
    bare = part.lights if part.lights.ndim == 3 else part.lights[..., None]
    for _ in range(_TURNS):
        lights = scaled_lights(part.lights, scale)
        b, weight = weighted_fit(part, lights, method)
        weight = weight / length(b).clamp(min=1e-12) ** 2
        xx, yy, zz, xy, xz, yz = inverse_moments(part.lights, weight)
        inverse = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz]).reshape(3, 3, -1)
        weighted = weight[:, None] * bare * part.grey[:, None]
        seen = torch.einsum("kip,ijp,mjp->km", weighted, inverse, weighted)
        form = torch.diag((weight * part.grey**2).sum(dim=1)) - seen
        form = form.double() / part.grey.shape[1]
        reciprocal = 1 / scale.double()
        variance = float(reciprocal @ form @ reciprocal) / max(1, len(scale) - MIN_LAMPS)
        prior = torch.diag(given.double() ** 2) / _TRUST**2
        data = form * (_INDEPENDENT / max(variance, 1e-10))
        solved = torch.linalg.solve(data + prior, prior @ (1 / given.double()))
        reciprocal = solved.to(scale.dtype)
        if not bool((reciprocal > 0).all()):
            return scale
        scale = 1 / reciprocal
        scale = scale / scale.mean()
    return scale
