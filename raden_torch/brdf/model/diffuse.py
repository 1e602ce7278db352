"""The diffuse part of the model: Take (2012), eqs (3)–(6), and nothing else.

Measurements determine only the product S = S_T · S_R · S_I, so it is one parameter per channel.
"""

from __future__ import annotations

import torch
from torch import Tensor

_LEAST = 1e-30  # below this, 1 − cos a counts as 0: x**n keeps finite gradients down to n = 0.01


def tilt_term(tilt: Tensor) -> Tensor:
    """Eq. (3) without S_T: T(t) = cos t."""
    return torch.cos(tilt)


def receiving_term(receiving: Tensor) -> Tensor:
    """Eq. (4) without S_R: R(r) = cos r."""
    return torch.cos(receiving)


def incidence_term(incidence: Tensor, exponent: Tensor) -> Tensor:
    """Eq. (5) without S_I: I(a) = (1 − cos a)^n; I(0) = 0 with gradient 0, for every n > 0.

    1 − cos a is computed as 2 sin²(a/2), which keeps its digits at small a.
    """
    x = 2 * torch.sin(incidence / 2) ** 2
    positive = x > _LEAST
    power = torch.where(positive, x, torch.ones_like(x)) ** exponent
    return torch.where(positive, power, torch.zeros_like(power))


def diffuse(
    incidence: Tensor, receiving: Tensor, tilt: Tensor, scale: Tensor, exponent: Tensor
) -> Tensor:
    """Eq. (6): S · T(t) · R(r) · I(a), the diffuse f_r.

    Args:
        incidence, receiving, tilt: `[..., 1, H, W]` in radians.
        scale: `[C]`, S per channel in 1/sr.
        exponent: `[C]`, n per channel, > 0.

    Returns:
        `[..., C, H, W]` in 1/sr, without the cosine of incidence.
    """
    per_channel = (-1, 1, 1)
    angular = tilt_term(tilt) * receiving_term(receiving)
    return scale.view(per_channel) * angular * incidence_term(incidence, exponent.view(per_channel))
