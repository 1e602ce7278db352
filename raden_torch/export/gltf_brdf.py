"""The reflection of a glTF 2.0 material with KHR_materials_iridescence, for arrays of geometries.

Sources: Khronos, glTF 2.0 specification, appendix B (metallic-roughness: Schlick's Fresnel, GGX,
Smith's masking without correlation); Khronos, KHR_materials_iridescence, implementation notes (two
interfaces, two orders of interference, the colour matching functions as Gaussians in the frequency
domain), after Belcour and Barla, A practical extension to microfacet theory for the modeling of
varying iridescence (ACM TOG 36(4), 2017), eqs (3), (10) and appendix A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.colorimetry import XYZ_TO_SRGB

_ORDERS = 2
# of x, y and z, and x's second lobe: height, centre and variance in 1/m, as published
_GAUSSIANS = (
    (5.4856e-13, 1.6810e6, 4.3278e9, 0),
    (4.4201e-13, 1.7953e6, 9.3046e9, 1),
    (5.2481e-13, 2.2084e6, 6.6121e9, 2),
    (9.7470e-14, 2.2399e6, 4.5282e9, 0),
)
_EQUAL_ENERGY = 1.0685e-7
"""The integral of ȳ, which the published heights are divided by."""


@dataclass(frozen=True)
class GltfMaterial:
    """The factors of a material, without textures.

    Attributes:
        base_colour: linear RGB, 0…1.
        metallic, roughness, iridescence: 0…1.
        ior, film_ior: of the dielectric base and of the film, 1 or more.
        thickness_nm: of the film.
    """

    base_colour: tuple[float, float, float]
    metallic: float
    roughness: float
    ior: float
    iridescence: float
    film_ior: float
    thickness_nm: float

    def f_r(self, n_l: Floats, n_v: Floats, n_h: Floats, v_h: Floats) -> Floats:
        """f_r in 1/sr, `[N, 3]`, by the cosines between normal, light, viewer and half vector,
        `[N]` each, light and viewer above the horizon."""
        base = np.array(self.base_colour)
        square = self.roughness**4
        distribution = square / (np.pi * (n_h**2 * (square - 1) + 1) ** 2)
        masking = 1 / (_smith(n_l, square) * _smith(n_v, square))
        specular = (distribution * masking)[:, None]
        f0 = ((self.ior - 1) / (self.ior + 1)) ** 2
        dielectric = self._fresnel(v_h, np.full(3, f0))
        # one share for all channels, or the body would take the film's complementary colour
        passed = 1 - dielectric.max(axis=1, keepdims=True)
        body = passed * base / np.pi + dielectric * specular
        metal = self._fresnel(v_h, base) * specular
        return body + self.metallic * (metal - body)

    def _fresnel(self, cosine: Floats, f0: Floats) -> Floats:
        plain = schlick(f0, cosine[:, None])
        film = film_reflectance(cosine, self.film_ior, self.thickness_nm, f0)
        return plain + self.iridescence * (film - plain)


def schlick(f0: Floats | float, cosine: Floats) -> Floats:
    """Fresnel's reflectance by Schlick's approximation."""
    return f0 + (1 - f0) * (1 - cosine) ** 5


def film_reflectance(cosine: Floats, ior: float, thickness_nm: float, f0: Floats) -> Floats:
    """What a film in air over a base reflects, linear RGB `[N, 3]`.

    Args:
        cosine: of the incidence, `[N]`.
        ior: of the film.
        f0: of the base in air at normal incidence, `[3]`.
    """
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    first = schlick(((ior - 1) / (ior + 1)) ** 2, cosine)[:, None]
    root = np.sqrt(np.minimum(f0 + 1e-4, 0.9999))
    base_ior = (1 + root) / (1 - root)
    second = schlick(((base_ior - ior) / (base_ior + ior)) ** 2, inside[:, None])
    shift = np.pi + np.where(base_ior < ior, np.pi, 0.0)
    path_m = 2e-9 * ior * thickness_nm * inside
    between = np.clip(first * second, 1e-5, 0.9999)
    waves = [sensitivity(order * path_m, order * shift) for order in range(1, _ORDERS + 1)]
    return np.maximum(airy_orders(first, second, between, waves), 0.0)


def airy_orders(first: Floats, second: Floats, between: Floats, waves: list[Floats]) -> Floats:
    """What a film's interfaces reflect together, by its first orders: Belcour and Barla, eq. (10).

    Args:
        first, second: reflectance of the interfaces.
        between: their product, below 1.
        waves: for each order what `sensitivity` is there.
    """
    through = (1 - first) ** 2 * second / (1 - between)
    total = first + through
    amplitude = through - (1 - first)
    for wave in waves:
        amplitude = amplitude * np.sqrt(between)
        total = total + 2 * amplitude * wave
    return total


def sensitivity(path_m: Floats, shift: Floats) -> Floats:
    """∫ x̄(λ) cos(2π path/λ + shift) dλ and so on, in linear RGB `[N, 3]`: for no path and no shift
    the colour of an even spectrum.

    Args:
        path_m: optical path difference in metres, `[N]`.
        shift: of the phase, for R, G and B alike those of X, Y and Z, `[3]` or `[N, 3]`.
    """
    return xyz_sensitivity(path_m, shift) @ XYZ_TO_SRGB.T


def xyz_sensitivity(path_m: Floats, shift: Floats) -> Floats:
    """The same in XYZ."""
    phase = 2 * np.pi * path_m
    xyz = np.zeros((len(path_m), 3))
    for height, centre, variance, which in _GAUSSIANS:
        width = height * np.sqrt(2 * np.pi * variance) / _EQUAL_ENERGY
        damped = width * np.exp(-variance * phase**2)
        xyz[:, which] += damped * np.cos(centre * phase + shift[..., which])
    return xyz


def _smith(cosine: Floats, square: float) -> Floats:
    return cosine + np.sqrt(square + (1 - square) * cosine**2)
