"""Palettes, coats and metals in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.info.reflectance_info import describe_model, describe_spectral


def describe_material(material: Any) -> str:
    """One fact a line; the members of a palette, and what they are made of, are indented."""
    if not isinstance(material, Palette):
        return "\n".join(_lines(material))
    lines = [f"palette of {len(material)}: {', '.join(material.names)}"]
    for place, (name, member) in enumerate(zip(material.names, material, strict=True)):
        first, *others = _lines(member)
        lines += [f"{place}, {name}: {first}", *(f"  {line}" for line in others)]
    return "\n".join(lines)


def _lines(material: Any) -> list[str]:
    if isinstance(material, RadenBrdf):
        return describe_model(material).splitlines()
    if isinstance(material, AnisotropicBrdf):
        at = ", ".join(f"{x:g}" for x in material.azimuth_deg)
        each = zip(material.azimuth_deg, material, strict=True)
        return [
            f"model of {len(material)} sample azimuths: {at} deg, period "
            f"{material.period_deg:g} deg; `--tangent` chooses, else their mean",
            *(line for x, model in each for line in _below(f"{x:g} deg", model)),
        ]
    if isinstance(material, SpectralBrdf):
        return describe_spectral(material).splitlines()
    if isinstance(material, Coated):
        absorption = ", ".join(f"{x:g}" for x in material.absorption)  # type: ignore[union-attr]
        return [
            f"coat of index {material.index:g}, {material.thickness:g} mm, absorption "
            f"{absorption} per mm, roughness {material.roughness:g}",
            *_below(f"base, f_r in {material.base_in}", material.base),
        ]
    if isinstance(material, Powder):
        share = f"covers {100 * material.density:g} %"
        return [
            f"powder that {share}",
            *_below("flakes", material.flakes),
            *_below("ground", material.ground),
        ]
    if isinstance(material, Foil):
        return [
            f"{material.metal} foil, roughness {material.roughness:g}, under {material.medium:g}"
        ]
    if isinstance(material, Lambertian):
        return [f"matt body, albedo {', '.join(f'{x:g}' for x in material.albedo)}"]
    shape = " x ".join(map(str, material.layout.shape))
    return [f"runtime table of {shape} nodes, without what it was baked from"]


def _below(what: str, material: Any) -> list[str]:
    first, *others = _lines(material)
    return [f"{what}: {first}", *(f"  {line}" for line in others)]


def describe_model_file(path: Path) -> str:
    """Whatever `load_model` reads."""
    from raden_torch.brdf.files.model_file import load_model

    return describe_material(load_model(path))
