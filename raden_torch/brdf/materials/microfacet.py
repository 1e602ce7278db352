"""A rough face: Fresnel's equations, the GGX distribution of its slopes, what it reflects in all.

Sources: Walter, Marschner, Li, Torrance, Microfacet models for refraction through rough surfaces
(EGSR 2007), eqs (33) and (34); Heitz, Understanding the masking-shadowing function (JCGT 3(2),
2014), eq. (99), for masking and shadowing of correlated heights; Heitz, Sampling the GGX
distribution of visible normals (JCGT 7(4), 2018), for the quadrature.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot

_NODES = 257
"""Of a function of the cosine, evenly in its square root: it is steep at grazing angles."""
_SAMPLES = 96
"""Facets along each of two axes, of which `albedo` is made."""
_LEAST_COSINE = 1e-4


def fresnel(cosine: Tensor, index: float) -> Tensor:
    """Unpolarised reflectance of a dielectric face seen from air (Born & Wolf, §1.5.2).

    Args:
        cosine: of the incidence, 0…1.
        index: of the dielectric, 1 or more.

    Examples:
        >>> import torch
        >>> fresnel(torch.tensor([1.0, 0.0]), 1.5)
        tensor([0.0400, 1.0000])
    """
    inside = torch.sqrt(1 - (1 - cosine**2) / index**2)
    # an index of 1 at cosine 0 is 0/0
    s = (cosine - index * inside) / (cosine + index * inside).clamp(min=1e-30)
    p = (index * cosine - inside) / (index * cosine + inside).clamp(min=1e-30)
    return (s * s + p * p) / 2


def ggx(cosine: Tensor, alpha: float) -> Tensor:
    """Density of facets, Walter et al. (2007), eq. (33), in terms of cos θ_m; in 1/sr."""
    x = (1 - cosine.clamp(0, 1) ** 2).clamp(min=0) * (1 - alpha**2) + alpha**2
    return alpha**2 / (math.pi * x * x)


def visible(cos_i: Tensor, cos_r: Tensor, alpha: float) -> Tensor:
    """G₂ / (4 cos θi cos θr): Smith's masking and shadowing of GGX with correlated heights."""
    from_i = cos_r * torch.sqrt(alpha**2 + (1 - alpha**2) * cos_i**2)
    from_r = cos_i * torch.sqrt(alpha**2 + (1 - alpha**2) * cos_r**2)
    return 0.5 / (from_i + from_r).clamp(min=1e-12)


def lobe(
    n: Tensor,
    l: Tensor,  # noqa: E741
    v: Tensor,
    alpha: float,
    reflectance: Callable[[Tensor], Tensor],
) -> Tensor:
    """f_r of the facets in 1/sr, of unit vectors: F D G₂ / (4 cos θi cos θr); 0 below the horizon.

    Args:
        reflectance: of a facet by the cosine of incidence on it, `[B, 1, H, W]` → `[B, C, H, W]`.
    """
    n_l, n_v = dot(n, l), dot(n, v)
    h = geometry.normalised(l + v)
    f = reflectance(dot(l, h).clamp(0, 1))
    f = f * ggx(dot(n, h), alpha) * visible(n_l.clamp(min=0), n_v.clamp(min=0), alpha)
    return torch.where((n_l > 0) & (n_v > 0), f, torch.zeros_like(f))


class OfCosine:
    """A function of a cosine in 0…1, from a table `[nodes, C]` that is read linearly."""

    def __init__(self, values: Tensor) -> None:
        self.values = values

    @staticmethod
    def nodes() -> Tensor:
        """The cosines of the nodes, in float64."""
        return torch.linspace(0, 1, _NODES, dtype=torch.float64, device="cpu") ** 2

    def __call__(self, cosine: Tensor) -> Tensor:
        """`[B, 1, H, W]` → `[B, C, H, W]`."""
        at = cosine.clamp(0, 1).sqrt() * (_NODES - 1)
        low = at.detach().floor().clamp(max=_NODES - 2)
        part = at - low
        values = self.values.to(cosine)
        first, second = (
            values[(low + step).long().squeeze(geometry.XYZ_DIM)].movedim(-1, geometry.XYZ_DIM)
            for step in (0, 1)
        )
        return first + part * (second - first)

    def mean(self) -> Tensor:
        """`[C]`: 2 ∫ x cos θ d cos θ, the mean over diffuse light, of the linear interpolation."""
        c, x = self.nodes()[:, None], self.values
        # exact for what is linear between the nodes in the cosine; they are close enough
        step = c[1:] - c[:-1]
        middle = (c[1:] * (2 * x[1:] + x[:-1]) + c[:-1] * (x[1:] + 2 * x[:-1])) / 3
        return (step * middle).sum(0)


@lru_cache(maxsize=64)
def albedo(alpha: float, index: float | None = None) -> OfCosine:
    """What a rough face reflects of light from one direction, single scattering alone.

    Args:
        alpha: GGX roughness.
        index: of a dielectric; None: every facet is a perfect mirror.
    """
    return OfCosine(facet_mean(alpha, None if index is None else lambda c: fresnel(c, index)))


@torch.inference_mode(False)
@torch.no_grad()
def facet_mean(alpha: float, reflectance: Callable[[Tensor], Tensor] | None) -> Tensor:
    """`[nodes, 1]`: ∫ F D G₂ / (4 cos θi) dω over the visible facets, by the midpoint rule in
    Heitz's (2018) two numbers, with the weight G₂/G₁."""
    cosine = OfCosine.nodes().clamp(min=_LEAST_COSINE)[:, None, None]
    u = (torch.arange(_SAMPLES, dtype=torch.float64, device="cpu") + 0.5) / _SAMPLES
    # closer to the rim, 1 − (1 − u)², where the long tail of GGX is
    rim, turn = (1 - u)[:, None], 2 * math.pi * u
    radius = torch.sqrt(1 - rim**2)
    sine = (1 - cosine**2).sqrt()
    stretched = torch.sqrt((alpha * sine) ** 2 + cosine**2)
    vx, vz = alpha * sine / stretched, cosine / stretched
    t1 = radius * turn.cos()  # across the plane of view and normal
    t2 = radius * turn.sin()
    s = (1 + vz) / 2
    t2 = (1 - s) * torch.sqrt(1 - t1**2) + s * t2
    t3 = torch.sqrt((1 - t1**2 - t2**2).clamp(min=0))
    # Heitz's basis: y, (−vz, 0, vx), and the stretched view
    hx, hy, hz = alpha * (-vz * t2 + vx * t3), alpha * t1, (vx * t2 + vz * t3).clamp(min=0)
    length = torch.sqrt(hx**2 + hy**2 + hz**2).clamp(min=1e-30)
    hx, hz = hx / length, hz / length
    v_h = (sine * hx + cosine * hz).clamp(0, 1)
    out = 2 * v_h * hz - cosine
    tangent2 = (1 - out**2).clamp(min=0) / out.clamp(min=1e-6) ** 2
    masked = [(torch.sqrt(1 + alpha**2 * x) - 1) / 2 for x in (sine**2 / cosine**2, tangent2)]
    weight = (1 + masked[0]) / (1 + masked[0] + masked[1])
    weight = torch.where(out > 0, weight, torch.zeros_like(weight)) * 2 * rim
    if reflectance is not None:
        weight = weight * reflectance(v_h)
    return weight.mean((1, 2))[:, None]


def checked_roughness(roughness: float) -> float:
    """A GGX α that is one.

    Raises:
        InputError: not in 0…1, or 0.
    """
    check_type("roughness", roughness, (float, int))
    if not 0 < roughness <= 1:
        raise InputError(f"roughness: expected GGX α above 0 and at most 1, got {roughness}")
    return float(roughness)
