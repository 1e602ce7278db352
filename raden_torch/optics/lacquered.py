"""Nacre facets and a diffuse body under a smooth coat of clear lacquer: the formulas.

Light and view directions are unit vectors `[..., 3]` in the sample's frame, z along the surface
normal. The coat's outer face is flat; below it lie small nacre mirrors whose slopes spread, and
below those a diffuse body. The coat's own mirror image is left out: it is far narrower than a
5 degree grid can hold.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from raden_torch.arrays import Floats


class Facets(NamedTuple):
    """A population of film planes, their slopes spread normally about a pair of mean slopes.

    The pair lies at ± `mean_slope` along y, so that the sample looks the same after half a turn.

    Attributes:
        share: share of the surface, seen from above, that the pair covers.
        mean_slope: tangent of the mean plane's angle to the surface.
        spread_x, spread_y: standard deviations of the slopes: the roughness.
    """

    share: float
    mean_slope: float
    spread_x: float
    spread_y: float


def refracted(direction: Floats, n: float) -> Floats:
    """The direction within a flat coat of index `n` (Snell's law)."""
    inside = direction / n
    inside[..., 2] = np.sqrt(1 - inside[..., 0] ** 2 - inside[..., 1] ** 2)
    return inside


def coat_transmittance(cos_outside: Floats, cos_inside: Floats, n: float) -> Floats:
    """Fresnel's transmittance of the coat's outer face for unpolarised light."""
    s = (cos_outside - n * cos_inside) / (cos_outside + n * cos_inside)
    p = (n * cos_outside - cos_inside) / (n * cos_outside + cos_inside)
    return 1 - (s**2 + p**2) / 2


@cache
def internal_diffuse_reflectance(n: float) -> float:
    """What share of diffuse light the coat's outer face throws back inside.

    1 − (1 − F)/n², with F = ∫ 2 cos θ F(θ) d cos θ from outside, by Gauss-Legendre quadrature
    (Judd, J. Res. NBS 29, 329 (1942), from memory).
    """
    node, weight = np.polynomial.legendre.leggauss(64)
    cos_outside = (node + 1) / 2
    cos_inside = np.sqrt(1 - (1 - cos_outside**2) / n**2)
    entering = np.sum(weight * cos_outside * coat_transmittance(cos_outside, cos_inside, n))
    return float(1 - entering / n**2)


def facet_slopes(light: Floats, view: Floats) -> tuple[Floats, Floats]:
    """Slopes along x and y of the facet that mirrors `light` to `view`: those of L + V."""
    half = light + view
    return half[..., 0] / half[..., 2], half[..., 1] / half[..., 2]


def slope_density(populations: tuple[Facets, ...], slope_x: Floats, slope_y: Floats) -> Floats:
    """Probability density of the slopes over the surface; its integral is the sum of the shares."""
    total = np.zeros(np.broadcast_shapes(slope_x.shape, slope_y.shape))
    for share, mean, spread_x, spread_y in populations:
        height = share / (2 * np.pi * spread_x * spread_y)
        for centre in (-mean, mean):
            y = (slope_y - centre) / spread_y
            total += height / 2 * np.exp(-((slope_x / spread_x) ** 2 + y**2) / 2)
    return total


def facet_brdf(density: Floats, reflectance: Floats, light: Floats, view: Floats) -> Floats:
    """R D / (4 cos θi cos θr) within the coat, in 1/sr, with D = density · (1 + slope²)².

    Torrance & Sparrow, J. Opt. Soc. Am. 57, 1105 (1967), in the form of Cook & Torrance (1982).
    Shadowing is left out: within the coat no direction is flatter than 41° from the normal and the
    slopes are small.
    """
    half = light + view
    # 1 + slope² = 1 / cos² of the facet, from L + V
    steepness = np.sum(half**2, axis=-1) / half[..., 2] ** 2
    spread = density * steepness**2 / (4 * light[..., 2] * view[..., 2])
    return np.asarray(reflectance * spread[..., None])


def body_brdf(albedo: Floats, reflected_in: Floats, reflected_out: Floats, n: float) -> Floats:
    """Lambert's body within the coat, in 1/sr, lit and seen through the films.

    (1 − R_in)(1 − R_out) ρ / π / (1 − ρ F): the films pass what they do not reflect, and the coat's
    outer face returns the share F of the diffuse light (Saunderson, J. Opt. Soc. Am. 32, 727
    (1942), from memory). The films' own return of diffuse light is left out.
    """
    inside = albedo / np.pi / (1 - albedo * internal_diffuse_reflectance(n))
    return np.asarray((1 - reflected_in) * (1 - reflected_out) * inside)
