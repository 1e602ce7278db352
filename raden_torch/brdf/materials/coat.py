"""A clear coat of urushi over any base.

With l′ and v′ refracted into a coat of index η, absorption coefficient σ and thickness d,

    f_r(l, v) = gloss(l, v) + T(l) T(v) A(l′) A(v′) / η² · (f_base(l′, v′) + …),
    A(w) = exp(−σ d / cos w),

where … goes to and fro between base and face (`between_faces.py`). Sources: Weidlich & Wilkie,
Arbitrarily layered micro-facet surfaces (GRAPHITE 2007), for the layers; Walter et al. (2007) for
1/η², by which radiance falls on its way out (Nicodemus 1963); Saunderson (1942) is what the sum
becomes over Lambert's base.

The gloss is a GGX lobe, single scattering alone. What it does not reflect enters, so T = 1 − its
albedo rather than 1 − Fresnel's: the coupling of Kelemen & Szirmay-Kalos (Eurographics 2001) and
Kulla & Conty (2017). So no light is lost or made at any roughness. Refraction is that of a flat
face: a rough one scatters more within.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from raden_torch.brdf.materials.between_faces import BetweenFaces, between_faces
from raden_torch.brdf.materials.microfacet import OfCosine, albedo, checked_roughness, fresnel, lobe
from raden_torch.brdf.materials.runtime import (
    LEAST_BAKED,
    Formula,
    RuntimeBrdf,
    baked,
    kept,
    layout_for,
    like_of,
    state_of,
)
from raden_torch.brdf.materials.surface import (
    Reflection,
    Surface,
    SurfaceReflection,
    formula_of,
    reflected,
)
from raden_torch.errors import InputError, check_type
from raden_torch.geometry import dot

BaseIn = Literal["coat", "air"]
_INDEX = (1.0, 4.0)

Numbers = float | Sequence[float]


@dataclass(frozen=True, eq=False)
class Coated:
    """A base under a clear coat: anything that reflects, `RadenBrdf` included.

    The normal of the G-buffer is the coat's; its `layer_normal` turns the base below. Light that
    goes to and fro between the two is that of a base whose layers lie in the surface.

    As `RadenBrdf`, it has two forms: `formula`, the reference, and tables that are baked from it
    when it is first used, and again when the base has changed. A base without gradients, whose
    layers lie in the surface, is shaded with its coat in one read.

    Attributes:
        base: what is under the coat.
        index: of the coat, 1…4; clear urushi has some 1.53.
        absorption: per mm, one number or linear RGB, 0 or more.
        thickness: in mm, 0 or more. 0 is a face without absorption.
        roughness: GGX α of the face, above 0 and at most 1. 0.07 spreads a small lamp's highlight
            over some 8 degrees, as wide as a shaded lamp is in a polished coat.
        base_in: in what the base's f_r is: "coat": of directions within the coat, through no face,
            as formulas of pigments, metals and films have it, and as a measured base is taken by
            default: what was measured is what the layers do, whatever lies above. "air": of
            directions in air, through a polished face of about this index, as a polished shell is
            measured: that face becomes the coat's, so only absorption and gloss are added.

    Examples:
        A white base under a clear coat gives back all light:

        >>> import torch
        >>> from raden_torch.brdf.materials.urushi import Lambertian
        >>> coated = Coated(Lambertian((1.0, 1.0, 1.0)), index=1.53)
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        >>> side = torch.tensor([0.6, 0.0, 0.8]).view(1, 3, 1, 1)
        >>> [round(x, 3) for x in coated.of_unit_vectors(up, up, side).flatten().tolist()]
        [0.3, 0.3, 0.3]
    """

    base: Reflection
    index: float = 1.53
    absorption: Numbers = 0.0
    thickness: float = 0.0
    roughness: float = 0.07
    base_in: BaseIn = "coat"

    def __post_init__(self) -> None:
        if not callable(getattr(self.base, "of_unit_vectors", None)):
            raise InputError(
                "base: expected a material (RadenBrdf, Lambertian, …), got "
                f"{type(self.base).__name__}"
            )
        check_type("index", self.index, (float, int))
        if not _INDEX[0] <= self.index <= _INDEX[1]:
            raise InputError(f"index: expected {_INDEX[0]:g}…{_INDEX[1]:g}, got {self.index}")
        checked_roughness(self.roughness)
        check_type("thickness", self.thickness, (float, int))
        if not 0 <= self.thickness < float("inf"):
            raise InputError(f"thickness: expected 0 mm or more, got {self.thickness}")
        given = self.absorption
        each = (given,) * 3 if isinstance(given, (float, int)) else tuple(given)
        if len(each) != 3 or not all(0 <= float(x) < float("inf") for x in each):
            raise InputError(
                "absorption: expected one number or three, 0 or more per mm (a negative one would "
                f"be gain), got {given}"
            )
        object.__setattr__(self, "absorption", tuple(float(x) for x in each))
        if self.base_in not in get_args(BaseIn):
            raise InputError(f"base_in: expected 'coat' or 'air', got {self.base_in!r}")

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        return self.base.working_dtype(*maps)

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, 3, H, W]` f_r in 1/sr of unit (or zero) vectors; 0 below the horizon."""
        return self.of_surface(Surface(n, v), l)

    def of_surface(self, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
        n, v = surface.normal, surface.view
        if surface.layer_normal is None and not _reads_more(self.base):
            f = self._whole().of_unit_vectors(n, l, v)
        else:
            f = self._beside().of_unit_vectors(n, l, v) + self._through(surface, l)
        return f if self.roughness >= LEAST_BAKED else f + self.gloss(n, l, v)

    def runtime_brdf(self) -> RuntimeBrdf | None:
        """All of it in one table, which the fused kernels read; None where one cannot hold it, or
        where gradients are recorded, which the kernels for whole images have none of."""
        if self.roughness < LEAST_BAKED or _reads_more(self.base):
            return None
        whole = self._whole()
        return None if whole.values.requires_grad else whole

    def formula(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """f_r by the formula itself, of layers that lie in the surface: the reference, slower."""
        return self._parts(n, once=True, gloss=True)(n, l, v)

    def gloss(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """The face's own lobe, `[B, 1, H, W]` in 1/sr."""
        return lobe(n, l, v, self.roughness, lambda c: fresnel(c, self.index))

    def state(self) -> Any:
        """What differs whenever its reflection does, but for what the base is."""
        kind = self.index, self.absorption, self.thickness, self.roughness, self.base_in
        return kind, state_of(self.base)

    def _face(self) -> OfCosine:
        return albedo(self.roughness, self.index)

    def _depth(self, like: Tensor) -> Tensor:
        return like.new_tensor(self.absorption) * self.thickness

    def _passed(self, n_w: Tensor) -> Tensor:
        """`[B, 3, H, W]`: what of light along one direction, in or out, passes face and coat."""
        inside = torch.sqrt(1 - (1 - n_w.clamp(0, 1) ** 2) / self.index**2).clamp(min=1e-6)
        coat = torch.exp(-self._depth(n_w).view(3, 1, 1) / inside)
        return coat if self.base_in == "air" else coat * (1 - self._face()(n_w)) / self.index

    def _through(self, surface: Surface, l: Tensor) -> Tensor:  # noqa: E741
        """The base seen through the coat, reflected once."""
        n, v = surface.normal, surface.view
        n_l, n_v = dot(n, l), dot(n, v)
        if self.base_in == "air":
            at, w = surface, l
        else:
            at = replace(surface, view=refracted(n, v, n_v, self.index))
            w = refracted(n, l, n_l, self.index)
        if surface.layer_normal is None and not _reads_more(self.base):
            f = formula_of(self.base)(n, w, at.view)
        else:
            f = reflected(self.base, at, w)
        f = f * (self._passed(n_l) * self._passed(n_v))
        return torch.where((n_l > 0) & (n_v > 0), f, torch.zeros_like(f))

    def _more(self, n: Tensor, l: Tensor, v: Tensor, between: BetweenFaces) -> Tensor:  # noqa: E741
        """The base seen through the coat, reflected more than once."""
        n_l, n_v = dot(n, l), dot(n, v)
        f = between.at(n, l, v) * (self._passed(n_l) * self._passed(n_v))
        return torch.where((n_l > 0) & (n_v > 0), f, torch.zeros_like(f))

    def _between(self, like: Tensor) -> BetweenFaces | None:
        if self.base_in == "air":
            return None
        return between_faces(
            formula_of(self.base), self.index, self._face(), self._depth(like), like
        )

    def _parts(self, like: Tensor, *, once: bool, gloss: bool) -> Formula:
        """The formula of layers in the surface, with the first reflection or without."""
        between = self._between(like)

        def formula(n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
            f = torch.zeros((1, 3, 1, 1), dtype=n.dtype, device=n.device)
            if once:
                f = f + self._through(Surface(n, v), l)
            if between is not None:
                f = f + self._more(n, l, v, between)
            return f + self.gloss(n, l, v) if gloss else f

        return formula

    def _baked(self, *, once: bool, gloss: bool) -> RuntimeBrdf:
        def make() -> RuntimeBrdf:
            formula = self._parts(like_of(self), once=once, gloss=gloss)
            return baked(self, formula, layout_for(self.roughness))

        return kept(self, f"{once} {gloss}", self.state(), make)

    def without_gloss(self) -> RuntimeBrdf:
        """What comes from below the face: for who adds the face's mirror image by other means."""
        return self._baked(once=True, gloss=False)

    def _whole(self) -> RuntimeBrdf:
        return self._baked(once=True, gloss=self.roughness >= LEAST_BAKED)

    def _beside(self) -> RuntimeBrdf:
        return self._baked(once=False, gloss=self.roughness >= LEAST_BAKED)


def refracted(n: Tensor, w: Tensor, n_w: Tensor, index: float) -> Tensor:
    """The direction within a flat coat (Snell's law), unit; zero where `w` is.

    Both point away from the base; n_w is their product.
    """
    along = torch.sqrt(1 - (1 - n_w.clamp(-1, 1) ** 2) / index**2)
    inside = (w - n_w * n) / index + along * n
    return torch.where(n_w != 0, inside, torch.zeros_like(inside))


def _reads_more(base: Reflection) -> bool:
    """Whether a base may read more of the surface than its normal."""
    return isinstance(base, SurfaceReflection) and not hasattr(base, "formula")
