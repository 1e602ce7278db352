"""Gold and silver: foil, and powder of flakes over a ground.

A facet reflects by Fresnel's equations with the measured complex index, wavelength by wavelength,
integrated to linear sRGB for D65 and the 2° observer: red of gold lies outside sRGB and is above 1
near normal incidence, though no wavelength is. Light that is reflected by several facets is the
reciprocal term of Kulla & Conty, Revisiting physically based shading at Imageworks (SIGGRAPH
course, 2017), so that a perfect mirror of any roughness reflects everything.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.arrays import Floats
from raden_torch.brdf.materials.microfacet import OfCosine, albedo, checked_roughness, lobe
from raden_torch.brdf.materials.runtime import (
    LEAST_BAKED,
    RuntimeBrdf,
    baked,
    kept,
    layout_for,
    least_roughness,
    state_of,
)
from raden_torch.brdf.materials.surface import (
    Reflection,
    Surface,
    SurfaceReflection,
    formula_of,
    reflected,
)
from raden_torch.brdf.model.model import version_of
from raden_torch.colorimetry import XYZ_TO_SRGB
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot
from raden_torch.optics.shell import BANDS_NM
from raden_torch.optics.specimens import bands_to_xyz

Metal = Literal["gold", "silver", "mirror"]

_NM = (
    *(381.5, 397.4, 413.3, 430.5, 450.9, 471.4, 495.9, 520.9),
    *(548.6, 582.1, 616.8, 659.5, 704.5, 756.0, 821.1),
)
_INDEX: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "gold": (
        (1.46, 1.47, 1.46, 1.45, 1.38, 1.31, 1.04, 0.62, 0.43, 0.29, 0.21, 0.14, 0.13, 0.14, 0.16),
        (1.933, 1.952, 1.958, 1.948, 1.914, 1.849, 1.833, 2.081, 2.455, 2.863, 3.272, 3.697, 4.103,
         4.542, 5.083),
    ),
    "silver": (
        (0.05, 0.05, 0.05, 0.04, 0.04, 0.05, 0.05, 0.05, 0.06, 0.05, 0.06, 0.05, 0.04, 0.03, 0.04),
        (1.864, 2.070, 2.275, 2.462, 2.657, 2.869, 3.093, 3.324, 3.586, 3.858, 4.152, 4.483, 4.838,
         5.242, 5.727),
    ),
}  # fmt: skip
"""n and k at `_NM`: Johnson & Christy, Phys. Rev. B 6, 4370 (1972), by
refractiveindex.info (CC0)."""


@dataclass(frozen=True)
class Foil:
    """Metal leaf: rough facets of a conductor.

    Attributes:
        metal: "gold", "silver", or "mirror", which reflects everything.
        roughness: GGX α of the facets; 0.15 of burnished leaf is an assumption.
        medium: index of what lies above: 1 for air, the coat's under a coat.

    Examples:
        >>> import torch
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        >>> f = Foil("gold").of_unit_vectors(up, up, up).flatten()
        >>> bool(f[0] > f[1] > f[2] > 0)
        True
    """

    metal: Metal
    roughness: float = 0.15
    medium: float = 1.0

    def __post_init__(self) -> None:
        if self.metal not in get_args(Metal):
            raise InputError(
                f"metal: expected one of {', '.join(get_args(Metal))}, got {self.metal!r}"
            )
        checked_roughness(self.roughness)
        check_type("medium", self.medium, (float, int))
        if not 1 <= self.medium <= 4:
            raise InputError(f"medium: expected an index in 1…4, got {self.medium}")

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        whole = self.runtime_brdf()
        return self.formula(n, l, v) if whole is None else whole.of_unit_vectors(n, l, v)

    def runtime_brdf(self) -> RuntimeBrdf | None:
        """All of it in one table, which the fused kernels read; None where one cannot hold it."""
        if self.roughness < LEAST_BAKED:
            return None
        layout = layout_for(self.roughness)
        return kept(self, "whole", self.state(), lambda: baked(self, self.formula, layout))

    def formula(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r by the formula itself: the reference, slower."""
        facet = facet_reflectance(self.metal, float(self.medium))
        once = lobe(n, l, v, self.roughness, facet)
        n_l, n_v = dot(n, l), dot(n, v)
        whole = albedo(self.roughness)
        mean = whole.mean()
        colour = facet.mean()
        # what is reflected once more and more: F̄² Ē / (1 − F̄ (1 − Ē))
        more = colour**2 * mean / (1 - colour * (1 - mean)) / (math.pi * (1 - mean))
        missing = (1 - whole(n_l)) * (1 - whole(n_v))
        f = once + missing * more.to(n).view(3, 1, 1)
        return torch.where((n_l > 0) & (n_v > 0), f, torch.zeros_like(f))

    def state(self) -> Any:
        return self.metal, self.roughness, self.medium


@dataclass(frozen=True, eq=False)
class Powder:
    """Metal flakes sprinkled over a ground: f_r is the mean of the two by covered area.

    Both may be coated, or the whole of it where the density is one number; with a map, put the coat
    on each: `Powder(Coated(flakes), Coated(ground), density)`. Light does not go from one to the
    other.

    Attributes:
        flakes: `Foil("gold", roughness=0.4)`: flakes lie less flat than leaf (an assumption).
        ground: what is seen between them.
        density: the share of the area that flakes cover, 0…1: one number, or a map
            `[B, 1, H, W]` as in `GBuffer.mask`.
    """

    flakes: Reflection
    ground: Reflection
    density: float | Tensor = 0.5

    def __post_init__(self) -> None:
        check_type("density", self.density, (float, int, Tensor))
        given = torch.as_tensor(self.density)
        if given.ndim not in (0, 4) or (given.ndim == 4 and given.shape[1] != 1):
            raise InputError(
                f"density: expected a number or a map [B, 1, H, W], got {list(given.shape)}"
            )
        low, high = float(given.detach().amin()), float(given.detach().amax())
        if not (low >= 0 and high <= 1):
            raise InputError(
                "density: expected 0…1, the share of the area that is covered, got "
                f"{low:g}…{high:g}; coverage(n) makes it of the flakes' area per area"
            )

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(
            *(m.new_empty((), dtype=x.working_dtype(*maps)) for x in (self.flakes, self.ground)
              for m in maps[:1])
        )  # fmt: skip

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        return self.of_surface(Surface(n, v), l)

    def of_surface(self, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
        """The same; the ground's layers may be turned."""
        if surface.layer_normal is None and self._fits_one_table():
            return self._whole().of_unit_vectors(surface.normal, l, surface.view)
        return self._mixed(*(reflected(x, surface, l) for x in (self.flakes, self.ground)))

    def runtime_brdf(self) -> RuntimeBrdf | None:
        """All of it in one table, which the fused kernels read; None where one cannot hold it, or
        where gradients are recorded."""
        if not self._fits_one_table():
            return None
        whole = self._whole()
        return None if whole.values.requires_grad else whole

    def formula(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r by the formulas of the parts: the reference, slower."""
        return self._mixed(*(formula_of(x)(n, l, v) for x in (self.flakes, self.ground)))

    def _mixed(self, flakes: Tensor, ground: Tensor) -> Tensor:
        density = self.density
        share = density.to(flakes) if isinstance(density, Tensor) else density
        return share * flakes + (1 - share) * ground

    def _fits_one_table(self) -> bool:
        of_parts = all(
            hasattr(x, "formula") or not isinstance(x, SurfaceReflection)
            for x in (self.flakes, self.ground)
        )
        return of_parts and not self.varies and least_roughness(self) >= LEAST_BAKED

    def _whole(self) -> RuntimeBrdf:
        layout = layout_for(least_roughness(self))
        return kept(self, "whole", self.state(), lambda: baked(self, self.formula, layout))

    @property
    def varies(self) -> bool:
        """Whether the density is a map."""
        return isinstance(self.density, Tensor) and self.density.ndim > 0

    def state(self) -> Any:
        density = self.density
        own = (id(density), version_of(density)) if isinstance(density, Tensor) else density
        return own, state_of(self.flakes), state_of(self.ground)


def coverage(flake_area: float | Tensor) -> float | Tensor:
    """The share of the area that flakes cover which fall anywhere, over each other too.

    1 − exp(−x), from Poisson's distribution, with x the flakes' own area per area.

    Examples:
        >>> round(coverage(1.0), 3)
        0.632
    """
    if isinstance(flake_area, Tensor):
        return -torch.expm1(-flake_area)
    return -math.expm1(-flake_area)


def fresnel_conductor(cosine: Floats, index: Floats) -> Floats:
    """Unpolarised reflectance of a conductor of complex index n + ik (Born & Wolf, §14.2).

    Args:
        cosine: of the incidence, broadcastable to `index`, which is relative to the medium above.
    """
    inside = np.sqrt(index**2 - (1 - cosine**2))
    s = (cosine - inside) / (cosine + inside)
    p = (index**2 * cosine - inside) / (index**2 * cosine + inside)
    return np.asarray((np.abs(s) ** 2 + np.abs(p) ** 2) / 2)


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def facet_reflectance(metal: Metal, medium: float = 1.0) -> OfCosine:
    """Fresnel's reflectance of a metal in linear sRGB, by the cosine of incidence."""
    cosine = OfCosine.nodes().numpy()[:, None]
    if metal == "mirror":
        return OfCosine(torch.ones(len(cosine), 3, dtype=torch.float64, device="cpu"))
    n, k = (np.interp(BANDS_NM, _NM, x) for x in _INDEX[metal])
    spectral = fresnel_conductor(cosine, (n + 1j * k) / medium)
    to_rgb = bands_to_xyz() / bands_to_xyz().sum(0)[1] @ XYZ_TO_SRGB.T
    # the white is 1, 1, 1 exactly, which the matrix's four digits miss
    return OfCosine(torch.from_numpy(spectral @ (to_rgb / to_rgb.sum(0))))
