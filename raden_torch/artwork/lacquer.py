"""Urushi, in which raden is set: a dark base under a clear, polished coat.

Sources: the microfacet model of Walter, Marschner, Li and Torrance (2007) with the GGX
distribution; Fresnel's equations. Index 1.53 and a brown base are usual for urushi; the roughness
is an assumption.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.geometry import dot


@dataclass(frozen=True)
class Lacquer:
    """f_r of black urushi: coat and base, with the same methods as `RadenBrdf` that `shade` calls.

    Attributes:
        base: reflectance of the pigmented base, linear RGB; zeros leave the coat's gloss alone.
        index: refractive index of the coat.
        roughness: GGX α of its surface; 0.07 spreads a small lamp's highlight over some 8 degrees,
            as wide as a shaded lamp is in a polished coat.
    """

    base: tuple[float, float, float] = (0.010, 0.006, 0.004)
    index: float = 1.53
    roughness: float = 0.07

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit vectors; 0 below the horizon."""
        n_l, n_v = dot(n, l), dot(n, v)
        above = (n_l > 0) & (n_v > 0)
        cos_i, cos_r = n_l.clamp(min=1e-4), n_v.clamp(min=1e-4)
        gloss = self._gloss(n, l, v, cos_i, cos_r)
        through = (1 - fresnel(cos_i, self.index)) * (1 - fresnel(cos_r, self.index))
        base = through * n.new_tensor(self.base).view(3, 1, 1) / math.pi
        f = gloss + base
        return torch.where(above, f, torch.zeros_like(f))

    def _gloss(self, n: Tensor, l: Tensor, v: Tensor, cos_i: Tensor, cos_r: Tensor) -> Tensor:  # noqa: E741
        h = geometry.normalised(l + v)
        d = ggx(dot(n, h), self.roughness)
        g = smith(cos_i, self.roughness) * smith(cos_r, self.roughness)
        return fresnel(dot(l, h).clamp(0, 1), self.index) * d * g / (4 * cos_i * cos_r)


def fresnel(cosine: Tensor, index: float) -> Tensor:
    """Unpolarised reflectance of a dielectric surface seen from air."""
    inside = torch.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return (s * s + p * p) / 2


def ggx(cosine: Tensor, alpha: float) -> Tensor:
    """Walter et al. (2007), eq. (33), in terms of cos θ_m."""
    x = cosine.clamp(0, 1) ** 2 * (alpha**2 - 1) + 1
    return alpha**2 / (math.pi * x * x)


def smith(cosine: Tensor, alpha: float) -> Tensor:
    """Walter et al. (2007), eq. (34): masking of GGX."""
    return 2 * cosine / (cosine + torch.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))
