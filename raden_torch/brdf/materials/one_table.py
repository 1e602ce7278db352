"""Any material as one runtime table, for what reads nothing else: exported shaders."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.runtime import (
    LEAST_BAKED,
    Formula,
    RuntimeBrdf,
    layout_for,
    least_roughness,
    parts_of,
    runtime_brdf,
)
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError


def one_table(material: Reflection, where: str = "material") -> RuntimeBrdf:
    """A material of the three angles, in single precision, baked where it is not a table yet.

    Args:
        where: for messages.

    Raises:
        InputError: a lobe narrower than a table holds, a density that is a map, or something that
            knows no angles.
    """
    if isinstance(material, RuntimeBrdf):
        return RuntimeBrdf(material.values.detach().float(), material.layout)
    if isinstance(material, RadenBrdf):
        return RuntimeBrdf(material.runtime_table().detach().float(), material.layout)
    if isinstance(material, AnisotropicBrdf):
        raise InputError(
            f"{where}: expected a material of three angles, got an AnisotropicBrdf, which turns "
            "with a tangent; give one azimuth (models[k]) or the mean (mean())"
        )
    if _has_a_map(material):
        raise InputError(
            f"{where}: density: expected one number, got a map: it belongs to a picture; give "
            "flakes and ground as two members, and their weights"
        )
    smoothest = least_roughness(material)
    if smoothest < LEAST_BAKED:
        raise InputError(
            f"{where}: roughness: expected at least {LEAST_BAKED:g}, whose highlight a table "
            f"holds, got {smoothest:g}"
        )
    formula: Formula = material.of_unit_vectors
    if isinstance(material, (Coated, Foil, Powder)):
        baked = material.runtime_brdf()
        if baked is not None:
            return RuntimeBrdf(baked.values.detach().float(), baked.layout)
        formula = material.formula
    with torch.no_grad():
        like = torch.zeros((), dtype=torch.float64, device="cpu")
        made = runtime_brdf(formula, like, layout_for(smoothest))
    return RuntimeBrdf(made.values.float(), made.layout)


def _has_a_map(material: Any) -> bool:
    """Whether something in it is a tensor for the pixels of one picture."""
    own = isinstance(getattr(material, "density", None), Tensor)
    return own or any(_has_a_map(part) for part in parts_of(material))
