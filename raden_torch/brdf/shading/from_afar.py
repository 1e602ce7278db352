"""Frames of a camera at infinity: whether a lit sphere serves, and how fine it has to be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from raden_torch.brdf.model import shading_kernel
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.lights import DirectionalLight, Light
from raden_torch.brdf.shading.lit_sphere import LitSphere, lit_sphere, sphere_of_side
from raden_torch.brdf.shading.surroundings import PROBES, SURE, lamps_of
from raden_torch.brdf.shading.triples import checked
from raden_torch.geometry import normalised

_SIDES = (129, 193, 289, 433)
"""Nodes along each side of a sphere under an environment, coarsest first."""


def lamps_from_afar(
    model: RadenBrdf,
    normal: Tensor,
    view: Tensor,
    lights: Sequence[Light],
    lamps: Tensor,
    tolerance: float,
) -> LitSphere | None:
    """The lit sphere of a frame under distant lamps, where N is all that differs and it pays.

    Args:
        lamps: what `packed` makes of the lights.
        tolerance: the largest error allowed, in radiance.
    """
    distant = all(isinstance(light, DirectionalLight) for light in lights)
    if not (distant and lights and _is_one_view(view) and lamps.shape[1] == 1):
        return None
    light_normals = _lighting(model, view, lamps)
    pixels = normal.numel() // 3
    return lit_sphere(light_normals, view.flatten(), len(lights), pixels, tolerance)


def surroundings_from_afar(
    model: RadenBrdf,
    normal: Tensor,
    mask: Tensor | None,
    view: Tensor,
    lights: Sequence[EnvironmentLight],
) -> Tensor | None:
    """`[B, 3, H, W]` float32 radiance under environments, times the mask.

    A lit sphere is made anew for every frame and light, and read by the fused kernel in one pass.
    None where views differ, and where `shade_surroundings` is done sooner.

    Args:
        normal: `[B, 3, H, W]`, of any length.
        mask: `[B or 1, 1, H or 1, W or 1]`, floating-point.
        view: of any length.
    """
    if not _is_one_view(view):
        return None
    view = normalised(view.float().view(1, 3, 1, 1))
    probes, share = _probes_of(normal, mask, view.flatten())
    image = None
    for light in lights:
        sphere = _sphere_under(model, light, view, probes, share * normal.numel() / 3)
        if sphere is None:
            return None
        found = shading_kernel.look_up(sphere, normal, mask)
        image = found if image is None else image.add_(found)
    return image


def _sphere_under(
    model: RadenBrdf, light: EnvironmentLight, view: Tensor, probes: Tensor, pixels: float
) -> LitSphere | None:
    """The coarsest sphere that `light.tolerance` allows."""
    light_normals = _lighting(model, view, lamps_of(light))
    truth = None
    for side in _SIDES:
        if side * side > pixels / 2:
            return None
        truth = light_normals(probes) if truth is None else truth
        sphere = sphere_of_side(light_normals, view.flatten(), side)
        error = (shading_kernel.look_up(sphere, probes, None) - truth).abs().amax(1)
        if float(error.quantile(SURE)) <= light.tolerance * float(truth.abs().max()):
            factor = checked("intensity", light.intensity, may_be_one=True).float()
            return replace(sphere, radiance=sphere.radiance.mul_(factor))
    return None


def _is_one_view(view: Tensor) -> bool:
    return view.numel() == 3 and bool(torch.isfinite(view).all() and (view != 0).any())


def _lighting(model: RadenBrdf, view: Tensor, lamps: Tensor) -> Callable[[Tensor], Tensor]:
    def light_normals(normal: Tensor) -> Tensor:
        return shading_kernel.shade(model, normal, view, None, None, None, lamps)

    return light_normals


def _probes_of(normal: Tensor, mask: Tensor | None, view: Tensor) -> tuple[Tensor, float]:
    """Normals `[1, 3, 1, P]` of pixels that are seen, evenly among them; the share that is."""
    b, _, h, w = normal.shape
    total = b * h * w
    at = torch.linspace(0, max(total - 1, 0), min(4 * PROBES, total), dtype=torch.float64).long()
    image, row, column = at // (h * w), at // w % h, at % w
    found = normalised(normal[image, :, row, column].float()[..., None, None])[..., 0, 0]
    seen = found @ view > 0
    if mask is not None:
        seen &= mask.expand(b, -1, h, w)[image, 0, row, column] > 0
    found = found[seen]
    kept = torch.linspace(0, max(len(found) - 1, 0), min(PROBES, len(found))).long()
    return found[kept].T.reshape(1, 3, 1, -1), len(found) / max(len(at), 1)
