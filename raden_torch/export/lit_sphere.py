"""How unlike a model and a material look, on a sphere under one lamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.files.display import Display, auto_exposure_ev
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.export.forms import RuntimeForm
from raden_torch.export.material_fit import Material
from raden_torch.packages import require

LAMP = (0.4, 0.5, 0.75)
"""The direction to it; the viewer is towards z."""
_SIZE = 128


@dataclass(frozen=True)
class SphereDifference:
    """ΔE2000 over the lit pixels: the `median`, and what 95 % of them are within (`most`)."""

    median: float
    most: float


def sphere_difference(form: RuntimeForm, material: Material) -> SphereDifference:
    """Both are exposed as the model's picture is by itself, and shown by sRGB.

    Raises:
        MissingPackageError: colour-science is not installed.
    """
    require("colour differences", "spectral")
    import colour

    pictures, lit = lit_spheres(form, material)
    lab = [
        colour.XYZ_to_Lab(colour.sRGB_to_XYZ(p[0].movedim(0, -1)[lit].double().numpy()))
        for p in pictures
    ]
    off = np.asarray(colour.delta_E(*lab, method="CIE 2000"))
    return SphereDifference(float(np.median(off)), float(np.quantile(off, 0.95)))


def lit_spheres(
    form: RuntimeForm, material: Material, size: int = _SIZE
) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Pictures `[1, 3, size, size]` in 0…1 of the model and of the material, and which pixels are
    lit and seen, `[size, size]`."""
    gbuffer = sphere(size, samples=1)
    n = geometry.normalised(gbuffer.normal).double()
    l = geometry.normalised(torch.tensor(LAMP, dtype=torch.float64).view(1, 3, 1, 1))  # noqa: E741
    l = l.expand_as(n)  # noqa: E741
    v = geometry.normalised(gbuffer.view_map(gbuffer.normal).double())
    pairs = [geometry.dot(n, x) for x in (l, v)]
    lit = (pairs[0] > 0) & (pairs[1] > 0)
    h = geometry.normalised(l + v)
    every = (*pairs, geometry.dot(n, h), geometry.dot(v, h))
    cosines = [x.clamp(1e-4, 1)[lit].numpy() for x in every]
    with torch.no_grad():
        model = form.of_unit_vectors(n, l, v).double()
    other = torch.zeros_like(model)
    other.movedim(1, -1)[lit[:, 0]] = torch.from_numpy(material.f_r(*cosines))
    light = [torch.where(lit, f * pairs[0], 0.0) for f in (model, other)]
    display = Display(exposure=auto_exposure_ev(light[0]))
    return (display.picture(light[0]), display.picture(light[1])), lit[0, 0]
