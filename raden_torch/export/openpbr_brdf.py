"""The reflection of MaterialX's `open_pbr_surface`, by a subset of its inputs, for arrays.

Sources: the node graph of MaterialX 1.39.5, libraries/bxdf/open_pbr_surface.mtlx (which layer lies
on which, how a coat roughens and dims what is below it), and its functions in
libraries/pbrlib/genglsl (GGX, Smith's masking of correlated heights, the albedos as a rational fit,
energy compensation by Turquin, Practical multiple scattering compensation for microfacet models
(2019), eqs (14) and (16); the film by Belcour and Barla, A practical extension to microfacet theory
for the modeling of varying iridescence (ACM TOG 36(4), 2017)). Where that code differs from these
papers this file follows the code: programs that read the file run it. So a film on metal has half
of the metal's reflectance at each polarisation, its base colour counts as XYZ, and its colours are
in CIE RGB for an even spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.export.gltf_brdf import airy_orders, schlick, xyz_sensitivity

XYZ_TO_CIE_RGB = np.array(
    [
        [2.3706743, -0.9000405, -0.4706338],
        [-0.5138850, 1.4253036, 0.0885814],
        [0.0052982, -0.0146949, 1.0093968],
    ]
)
"""Linear, an even spectrum at R = G = B, as the shader has it."""
_ALBEDO_FIT = np.array(
    [
        [0.1003, 0.9345, 1.0, 1.0],
        [-0.6303, -2.323, -1.765, 0.2281],
        [9.748, 2.229, 8.263, 15.94],
        [-2.038, -3.748, 11.53, -55.83],
        [29.34, 1.424, 28.96, 13.08],
        [-8.245, -0.7684, -7.507, 41.26],
        [-26.44, 1.436, -36.11, 54.9],
        [19.99, 0.2913, 15.86, 300.2],
        [-5.448, 0.6286, 33.37, -285.1],
    ]
)
"""Of 1, x, y, xy, x², y², x²y, xy², x²y², x = N·V and y = α: two numerators, two denominators."""
_LEAST = 1e-8


@dataclass(frozen=True)
class OpenPbrMaterial:
    """Inputs of the node that are not at their defaults; `coat_darkening` is 0.

    Attributes:
        base_color: linear RGB, 0…1.
        base_metalness, specular_roughness: 0…1.
        specular_ior: of the dielectric base, 1 or more.
        thin_film_weight: 0…1.
        thin_film_thickness: in micrometres.
        thin_film_ior: 1 or more.
        coat_weight, coat_roughness: 0…1.
        coat_ior: 1 or more.
    """

    base_color: tuple[float, float, float]
    base_metalness: float
    specular_roughness: float
    specular_ior: float
    thin_film_weight: float
    thin_film_thickness: float
    thin_film_ior: float
    coat_weight: float
    coat_roughness: float
    coat_ior: float

    def f_r(self, n_l: Floats, n_v: Floats, n_h: Floats, v_h: Floats) -> Floats:
        """f_r in 1/sr, `[N, 3]`, by the cosines between normal, light, viewer and half vector,
        `[N]` each, light and viewer above the horizon. It is not reciprocal: what layers let pass
        follows the viewer."""
        at = _Geometry(n_l, n_v, n_h, v_h)
        base = self._base(at)
        if self.coat_weight <= 0:
            return base
        alpha = self.coat_roughness**2
        plain = fresnel(v_h, self.coat_ior)[:, None]
        kept = self.coat_weight * at.albedo(alpha, self.coat_ior, plain)
        return self.coat_weight * at.lobe(alpha, plain) + (1 - kept) * base

    def _base(self, at: _Geometry) -> Floats:
        rough, ior = self._under_the_coat()
        alpha, base = rough**2, np.array(self.base_color)
        dielectric, metal = fresnel(at.v_h, ior)[:, None], schlick(base, at.v_h[:, None])
        if self.thin_film_weight <= 0 or self.thin_film_thickness <= 0:
            return self._mixed(at, alpha, ior, dielectric, metal)
        film = self.thin_film_ior, 1e-6 * self.thin_film_thickness
        coloured = film_on_dielectric(at.v_h, *film, ior), film_on_metal(at.v_h, *film, base)
        bare = self._mixed(at, alpha, ior, dielectric, metal)
        return bare + self.thin_film_weight * (self._mixed(at, alpha, ior, *coloured) - bare)

    def _mixed(
        self, at: _Geometry, alpha: float, ior: float, dielectric: Floats, metal: Floats
    ) -> Floats:
        """The base, of what a facet of each of its parts reflects."""
        passed = 1 - at.albedo(alpha, ior, dielectric)
        body = at.lobe(alpha, dielectric) + passed * np.array(self.base_color) / np.pi
        return body + self.base_metalness * (at.lobe(alpha, metal) - body)

    def _under_the_coat(self) -> tuple[float, float]:
        """The base's roughness, which the coat adds to, and its index, relative to the coat's and
        never below 1."""
        sum_of_powers = 2 * self.coat_roughness**4 + self.specular_roughness**4
        coated = min(1.0, sum_of_powers) ** 0.25
        rough = self.specular_roughness + self.coat_weight * (coated - self.specular_roughness)
        ratio = self.specular_ior / self.coat_ior
        ratio = max(ratio, 1 / ratio)
        return rough, self.specular_ior + self.coat_weight * (ratio - self.specular_ior)


@dataclass(frozen=True)
class _Geometry:
    """Cosines, `[N]` each, and what a lobe is by them."""

    n_l: Floats
    n_v: Floats
    n_h: Floats
    v_h: Floats

    def lobe(self, alpha: float, reflectance: Floats) -> Floats:
        """Facets that reflect `[N, 3]` or `[N, 1]`, with what they scatter among themselves."""
        square = max(alpha, _LEAST) ** 2
        facets = square / (np.pi * (1 + self.n_h**2 * (square - 1)) ** 2)
        from_l = self.n_v * np.sqrt(square + (1 - square) * self.n_l**2)
        from_v = self.n_l * np.sqrt(square + (1 - square) * self.n_v**2)
        each = (facets * 0.5 / (from_l + from_v))[:, None]
        return each * reflectance * self._compensation(alpha, reflectance)

    def albedo(self, alpha: float, ior: float, reflectance: Floats) -> Floats:
        """What a dielectric keeps from what lies below it: of its index, but compensated by what
        its facets reflect."""
        to_0, to_1 = self._albedo_parts(alpha)
        f0 = ((ior - 1) / (ior + 1)) ** 2
        return (f0 * to_0 + to_1)[:, None] * self._compensation(alpha, reflectance)

    def _compensation(self, alpha: float, reflectance: Floats) -> Floats:
        to_0, to_1 = self._albedo_parts(alpha)
        once = (to_0 + to_1)[:, None]
        return 1 + reflectance * (1 - once) / once

    def _albedo_parts(self, alpha: float) -> tuple[Floats, Floats]:
        """Shares of a lobe's albedo that go with the reflectance at 0° and at 90°."""
        x, y = self.n_v, np.full_like(self.n_v, alpha)
        terms = [np.ones_like(x), x, y, x * y, x**2, y**2, x**2 * y, x * y**2, x**2 * y**2]
        above, above_1, below, below_1 = np.stack(terms, -1).dot(_ALBEDO_FIT).T
        return np.clip(above / below, 0, 1), np.clip(above_1 / below_1, 0, 1)


def fresnel(cosine: Floats, ior: float) -> Floats:
    """Unpolarised reflectance of a dielectric, `[N]`."""
    p, s = fresnel_polarised(cosine, ior)
    return (p + s) / 2


def fresnel_polarised(cosine: Floats, ior: float) -> tuple[Floats, Floats]:
    """Reflectance of p and of s, 1 where all is reflected; `ior` relative to the side that light
    comes from, above 0."""
    inside = np.sqrt(np.maximum(ior**2 - 1 + cosine**2, 0))
    s = (cosine - inside) / np.maximum(cosine + inside, _LEAST)
    p = (ior**2 * cosine - inside) / np.maximum(ior**2 * cosine + inside, _LEAST)
    return p**2, s**2


def film_on_dielectric(cosine: Floats, ior: float, thickness_m: float, base: float) -> Floats:
    """Reflectance of a film in air on a dielectric of the index `base`, RGB `[N, 3]`."""
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    second_p, second_s = fresnel_polarised(inside, base / ior)
    square = base**2 - ior**2 * (1 - inside**2)
    # the phase of total reflection; 0 or π elsewhere
    u2, v = np.maximum(square, 0), np.sqrt(np.maximum(-square, 0))
    phase_s = np.arctan2(2 * ior * v * inside, u2 + v**2 - (ior * inside) ** 2)
    phase_p = np.arctan2(
        -2 * ior * base**2 * inside * v, (base**2 * inside) ** 2 - ior**2 * (u2 + v**2)
    )
    second = (second_p[:, None], phase_p[:, None]), (second_s[:, None], phase_s[:, None])
    return _film(cosine, ior, 2 * ior * thickness_m * inside, second)


def film_on_metal(cosine: Floats, ior: float, thickness_m: float, base: Floats) -> Floats:
    """Reflectance of a film in air on a metal of the colour `base` `[3]`, RGB `[N, 3]`."""
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    half = 0.5 * schlick(base, inside[:, None])
    root = np.sqrt(np.clip(base, 0.01, 0.99))
    phase = np.where((1 + root) / (1 - root) < ior, np.pi, 0.0)[None]
    return _film(cosine, ior, 2 * ior * thickness_m * inside, ((half, phase), (half, phase)))


def _film(
    cosine: Floats, ior: float, path_m: Floats, second: tuple[tuple[Floats, Floats], ...]
) -> Floats:
    """The mean of both polarisations; `second` is p's and s's reflectance and phase at the base."""
    brewster = np.cos(np.arctan(ior))
    turns: tuple[Floats, Floats]
    turns = np.where(cosine < brewster, 0.0, np.pi)[:, None], np.full((1, 1), np.pi)
    firsts = fresnel_polarised(cosine, ior)
    total = np.zeros((len(cosine), 3))
    for first, turn, (reflectance, phase) in zip(firsts, turns, second, strict=True):
        r, shift = first[:, None], np.broadcast_to(phase + turn, total.shape)
        waves = [xyz_sensitivity(order * path_m, order * shift) for order in (1, 2)]
        total += airy_orders(r, reflectance, np.minimum(r * reflectance, 1 - _LEAST), waves) / 2
    return np.clip(total @ XYZ_TO_CIE_RGB.T, 0, 1)
