"""A pearl: a body, concentric layers of nacre around it, and the polished face of the outermost.

Dobashi, Nagata, Manabe, Usami & Inokuchi, Simulation and evaluation of virtual pearl (1), IEICE
General Conference, p. 422 (1996), and Nagata et al., Modeling and visualization for a pearl-quality
evaluation simulator, IEEE TVCG 3(4), 307 (1997), tell three parts of a pearl's light apart: body
colour, surface gloss, interference. (Known to us by their abstracts; the formulas are our own
choice.) Here

    gloss         a smooth face of nacre's mean index: `Coated`
    interference  f = R(θ) D G₂ / (4 cos θi cos θr): facets of film planes, rougher than the face,
                  as the terraces of growing tablets are; R is the mean reflectance of random
                  stacks (`optics.nacre`), integrated to linear sRGB at every angle
    body          (1 − E(l)) (1 − E(v)) ρ / (π (1 − ρ Ē)): Lambert's body below films that pass what
                  they do not reflect, E their albedo; Ashikhmin & Shirley's coupling (JGT 5(2),
                  2000) with Saunderson's sum. So the body shows the colour that is left over.

The layers are concentric, so on a sphere they lie in the surface everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.microfacet import OfCosine, checked_roughness, facet_mean, lobe
from raden_torch.brdf.materials.urushi import RGB, Lambertian
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot
from raden_torch.optics.nacre import Stack, mean_reflectance
from raden_torch.optics.shell import BANDS_NM
from raden_torch.optics.spectral_colour import spectrum_to_rgb

PEARL = "pearl"
"""What stands for a model's file to light a simulated pearl."""
NACRE_INDEX = 1.66
"""Tablets of 1.683 and organic sheets of 1.50, by their share of the thickness."""
BODY: RGB = (0.80, 0.75, 0.67)
"""Cream white, an assumption: Akoya pearls are sold as white to cream with rosé, silver or green
overtones."""
AKOYA = Stack(tablet_nm=360.0, tablet_spread=0.03)
"""Orders at 640 and 430 nm: rosé at the middle, greener towards the rim. Within the 330…440 nm and
the spread of 3.5 (strong lustre) to 9 %, taken as ± 2 σ, of trade reports (docs/shells.md)."""

_COSINES, _STACKS = 33, 60


@dataclass(frozen=True)
class NacreLayers:
    """A body below layers of nacre, of directions within nacre: the base of a `Coated`.

    Attributes:
        stack: the layers.
        roughness: GGX α of the film planes, an assumption.
        body: diffuse reflectance below them, linear RGB, 0…1.
        medium: index of what is above them, 1…2.
    """

    stack: Stack = AKOYA
    roughness: float = 0.22
    body: RGB = BODY
    medium: float = NACRE_INDEX

    def __post_init__(self) -> None:
        checked_roughness(self.roughness)
        Lambertian(self.body)
        check_type("stack", self.stack, Stack)
        check_type("medium", self.medium, (float, int))
        if not 1 <= self.medium <= 2:
            raise InputError(f"medium: expected an index in 1…2, got {self.medium}")

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return geometry.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        films = layer_reflectance(self.stack, float(self.medium))
        albedo = _layer_albedo(self.stack, float(self.medium), self.roughness)
        n_l, n_v = dot(n, l), dot(n, v)
        body = n.new_tensor(self.body)
        below = (body / (math.pi * (1 - body * albedo.mean().to(n)))).view(3, 1, 1)
        f = lobe(n, l, v, self.roughness, films) + (1 - albedo(n_l)) * (1 - albedo(n_v)) * below
        return torch.where((n_l > 0) & (n_v > 0), f, torch.zeros_like(f))

    def state(self) -> Any:
        return self.stack, self.roughness, self.body, self.medium


def pearl(
    stack: Stack = AKOYA,
    *,
    body: RGB = BODY,
    gloss_roughness: float = 0.05,
    layer_roughness: float = 0.22,
) -> Coated:
    """A pearl for `shade`.

    Args:
        stack: the layers; a larger `tablet_spread` gives weaker, paler colours.
        body: diffuse reflectance of what lies below them, linear RGB, 0…1.
        gloss_roughness, layer_roughness: GGX α of the face and of the film planes, assumptions.

    Examples:
        >>> pearl().base.stack.tablet_nm
        360.0
    """
    base = NacreLayers(stack, layer_roughness, body)
    return Coated(base, index=NACRE_INDEX, roughness=gloss_roughness)


def is_pearl(material: object) -> bool:
    """Whether a material is what `pearl` makes."""
    return isinstance(material, Coated) and isinstance(material.base, NacreLayers)


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def layer_reflectance(stack: Stack, medium: float = NACRE_INDEX) -> OfCosine:
    """The films' mean reflectance in linear sRGB, by the cosine of incidence in the medium."""
    cosine = np.linspace(0, 1, _COSINES).clip(1e-3)
    q_squared = medium**2 * (1 - cosine**2)
    spectral = mean_reflectance(stack, BANDS_NM, q_squared, ambient_n=medium, stacks=_STACKS)
    rgb, at = spectrum_to_rgb(spectral, BANDS_NM), OfCosine.nodes().numpy()
    return OfCosine(torch.from_numpy(np.stack([np.interp(at, cosine, c) for c in rgb.T], axis=-1)))


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def _layer_albedo(stack: Stack, medium: float, roughness: float) -> OfCosine:
    """What the film planes reflect of light from one direction, `[nodes, 3]`."""
    table = layer_reflectance(stack, medium).values

    def one(channel: int) -> Tensor:
        of_facet = OfCosine(table[:, channel : channel + 1])
        return facet_mean(roughness, lambda c: of_facet(c[:, None])[:, 0])

    return OfCosine(torch.cat([one(channel) for channel in range(3)], dim=1))
