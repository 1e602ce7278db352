"""Photometric stereo: photographs under several lamps → normals, albedo and how sure they are.

A matt surface under lamp k shines with I_k = s_k ρ (N·L_k), N the normal and L_k the direction to
the lamp (Woodham 1980, eq. (9)). With b = ρ N this is linear in b, and three lamps determine it.
Shadows and highlights break the law; so each pixel takes the lamps that light it, and weighs them
by how well they agree (iteratively reweighted least squares, which minimises Σ |I_k − s_k b·L_k|).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.capture.photo.intensity_fit import refined_intensity
from raden_torch.capture.photo.lambert_fit import (
    METHODS,
    Method,
    inverse_moments,
    length,
    scaled_lights,
    toward,
    weighted_fit,
)
from raden_torch.capture.photo.lights_check import MIN_LAMPS, check_lights
from raden_torch.capture.photo.lit_pixels import LitPixels, PixelStack
from raden_torch.capture.photo.tile_threads import in_threads
from raden_torch.errors import InputError

FULL_CONFIDENCE_DEG = 5.0
"""The standard error at which a normal's confidence is one half."""

_TILE = 1 << 15
_SAMPLE = 1 << 13
"""Pixels that the intensities are refined on."""
_UNSEEN = 0.01
"""A residual, relative to the albedo, that is granted where the lamps agree perfectly."""
_PLANES = 6
"""Of the maps beside the albedo: normal, confidence, error, lamps."""


def confidence_of(error_deg: Tensor) -> Tensor:
    """1/(1 + (e/5°)²) of standard errors."""
    return 1 / (1 + (error_deg / FULL_CONFIDENCE_DEG) ** 2)


@dataclass(frozen=True, eq=False)
class SurfaceNormals:
    """What the photographs say of the surface.

    Attributes:
        normal: `[1, 3, H, W]` unit normals (not directions to a lamp) in the frame of the lamps:
            x right, y up, z to the viewer. Zero where there is none: outside the mask, or black.
        albedo: `[1, C, H, W]`, ρ of each channel in the photographs' unit: what the surface
            shines with when it faces a lamp of intensity 1.
        confidence: `[1, 1, H, W]`, 1/(1 + (e/5°)²) with e = `error_deg`; 0 where no normal is.
        error_deg: `[1, 1, H, W]`, the standard error of the normal as the lamps' disagreement and
            their directions give it. It does not include errors that all lamps share.
        lamps_used: `[1, 1, H, W]`, how many lamps light the pixel and are not saturated there.
        lamp_residual: `[K]`, median of |I − s ρ N·L| / ρ over the pixels that the lamp lights.
        intensity: `[K]`, s: as given, or refined.
    """

    normal: Tensor
    albedo: Tensor
    confidence: Tensor
    error_deg: Tensor
    lamps_used: Tensor
    lamp_residual: Tensor
    intensity: Tensor


def solve_normals(
    images: Tensor,
    lights: Tensor,
    mask: Tensor | None = None,
    *,
    method: Method = "robust",
    intensity: Tensor | None = None,
    refine_intensity: bool = False,
    saturated: Tensor | None = None,
    shadow: float = 0.1,
    exponent: float = 1.0,
    progress: Callable[[float], None] | None = None,
) -> SurfaceNormals:
    """Normals and albedo of each pixel from K photographs by one camera.

    Args:
        images: `[K, C, H, W]` linear light, C = 1 or 3; the normals come of the channels' mean.
        lights: `[K, 3]` directions TO the lamps (not normals), or `[K, 3, H, W]` for near lamps,
            whose length then multiplies the intensity (see `lamps.towards`).
        mask: `[1, 1, H, W]`; pixels above ½ are solved. All where None.
        method: "robust" minimises the absolute residuals; "least-squares" the squares; "selection"
            drops, pixel by pixel, the third of the lamps that agree least, then takes squares.
        intensity: `[K]` relative intensities; alike where None.
        refine_intensity: also fit the intensities, starting from these; their mean is kept.
        saturated: `[K, 1, H, W]` bool: values that are not to be used.
        shadow: a lamp counts as shadowed where it gives less than this share of the pixel's third
            brightest; 0 takes all that are not black.
        exponent: of the response: the images are taken to this power first (1: linear).
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: fewer than three lamps, lamps in one plane with the object, sizes that differ,
            an empty mask.
    """
    _check(images, lights, mask, intensity, saturated, method, shadow, exponent)
    stack = _stacked(images, lights, saturated, shadow, exponent)
    inside = _inside(images, mask)
    scale = torch.ones(len(images)) if intensity is None else intensity
    scale = scale.to(images.device, stack.dtype) / scale.mean().to(images.device, stack.dtype)
    if refine_intensity:
        sample = inside[:: max(1, len(inside) // _SAMPLE)]
        scale = refined_intensity(stack.at(sample), scale, method)
    maps, residual = _solved(stack, inside, scale, method, progress)
    found = maps.reshape(1, -1, *images.shape[2:])
    return SurfaceNormals(
        normal=found[:, :3],
        confidence=found[:, 3:4],
        error_deg=found[:, 4:5],
        lamps_used=found[:, 5:6],
        albedo=found[:, _PLANES:],
        lamp_residual=torch.nanmedian(residual, dim=1).values,
        intensity=scale,
    )


def _stacked(
    images: Tensor, lights: Tensor, saturated: Tensor | None, shadow: float, exponent: float
) -> PixelStack:
    count, channels = images.shape[:2]
    dtype = torch.float64 if images.dtype == torch.float64 else torch.float32
    lights = lights.to(images.device, dtype)
    if lights.ndim == 2:
        lights = lights / lights.norm(dim=1, keepdim=True)
    full = None if saturated is None else saturated.to(images.device).reshape(count, -1)
    flat = images.reshape(count, channels, -1)
    return PixelStack(flat, full, lights, shadow, exponent, dtype)


def _inside(images: Tensor, mask: Tensor | None) -> Tensor:
    """`[P]` the numbers in H·W of the pixels that are solved."""
    height, width = images.shape[2:]
    if mask is None:
        return torch.arange(height * width, device=images.device)
    inside = (mask.to(images.device).reshape(-1) > 0.5).nonzero()[:, 0]
    if len(inside) == 0:
        raise InputError("mask: expected white where the object is, got an empty mask")
    return inside


def _solved(
    stack: PixelStack,
    inside: Tensor,
    scale: Tensor,
    method: Method,
    progress: Callable[[float], None] | None,
) -> tuple[Tensor, Tensor]:
    """`[6 + C, H·W]` maps as `_solve_tile` has them, 0 outside; `[K, …]` residuals, thinned out."""
    channels, pixels = stack.images.shape[1:]
    maps = torch.zeros(channels + _PLANES, pixels, dtype=stack.dtype, device=stack.images.device)
    residuals = []
    thinned = max(1, len(inside) // _TILE)

    def solve(index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        solved, residual = _solve_tile(stack.at(index), scale, method)
        return index, solved, residual[:, ::thinned]

    tiles = inside.split(_TILE)
    results = in_threads(solve, tiles, maps.device)
    for k, (index, solved, residual) in enumerate(results):
        maps[:, index] = solved
        residuals.append(residual)
        if progress is not None:
            progress((k + 1) / len(tiles))
    return maps, torch.cat(residuals, dim=1)


def _solve_tile(part: LitPixels, scale: Tensor, method: Method) -> tuple[Tensor, Tensor]:
    """`[6 + C, P]` normal, confidence, error, lamps, albedo; and `[K, P]` relative residuals."""
    lights = scaled_lights(part.lights, scale)
    b, weight = weighted_fit(part, lights, method)
    rho = length(b)
    solved = (part.lit.sum(dim=0) >= MIN_LAMPS) & (rho > 0) & torch.isfinite(rho)
    normal = torch.where(solved, b / torch.where(solved, rho, 1.0), 0.0)
    predicted = toward(lights, normal)
    relative = (part.grey / torch.where(solved, rho, 1.0) - predicted).abs()
    error = _standard_error_deg(part, lights, normal, relative, weight)
    error = torch.where(solved, error, 0.0)
    confidence = torch.where(solved, confidence_of(error), 0.0)
    facing = weight * predicted.clamp(min=0)
    norm = (facing * predicted).sum(dim=0)
    albedo = (facing[:, None] * part.value).sum(dim=0) / norm.clamp(min=1e-12)
    rows = [normal, confidence[None], error[None], part.lit.sum(dim=0)[None], albedo * solved]
    return torch.cat(rows), torch.where(solved & (part.lit > 0), relative, torch.nan)


def _standard_error_deg(
    part: LitPixels, lights: Tensor, normal: Tensor, relative: Tensor, weight: Tensor
) -> Tensor:
    """The normal's standard error `[P]`: σ √(trace of (Σ w L Lᵀ)⁻¹ across N), w of mean 1.

    σ² is the weighted mean square of the residuals over K − 3 degrees of freedom.
    """
    total = weight.sum(dim=0).clamp(min=1e-12)
    used = part.lit.sum(dim=0)
    variance = (weight * relative * relative).sum(dim=0) / total * used
    variance = variance / (used - MIN_LAMPS).clamp(min=1) + _UNSEEN**2
    a, d, f, b, c, e = inverse_moments(lights, weight / total * used)
    x, y, z = normal
    along = a * x * x + d * y * y + f * z * z + 2 * (b * x * y + c * x * z + e * y * z)
    across = (a + d + f - along).clamp(min=0)
    return torch.rad2deg((variance * across).sqrt()).clamp(max=90.0)


def _check(
    images: Tensor,
    lights: Tensor,
    mask: Tensor | None,
    intensity: Tensor | None,
    saturated: Tensor | None,
    method: str,
    shadow: float,
    exponent: float,
) -> None:
    if images.ndim != 4 or images.shape[1] not in (1, 3) or not images.is_floating_point():
        raise InputError(
            f"images: expected floating-point [K, 1 or 3, H, W], got {images.dtype} "
            f"{list(images.shape)}"
        )
    count, _, height, width = images.shape
    if lights.shape not in ((count, 3), (count, 3, height, width)):
        raise InputError(
            f"lights: expected shape [{count}, 3] or [{count}, 3, {height}, {width}] for {count} "
            f"photographs, got {list(lights.shape)}"
        )
    check_lights(lights if lights.ndim == 2 else lights.mean(dim=(2, 3)))
    for name, m, n in (("mask", mask, 1), ("saturated", saturated, count)):
        if m is not None and m.shape != (n, 1, height, width):
            raise InputError(f"{name}: expected shape {[n, 1, height, width]}, got {list(m.shape)}")
    if intensity is not None and (
        intensity.shape != (count,) or not bool((intensity > 0).all() & intensity.isfinite().all())
    ):
        raise InputError(
            f"intensity: expected {count} positive numbers, one per lamp, got {intensity.tolist()}"
        )
    if method not in METHODS:
        raise InputError(f"method: expected {', '.join(METHODS)}, got {method!r}")
    if not 0 <= shadow < 1:
        raise InputError(f"shadow: expected a share of the brightest lamp, 0…1, got {shadow:g}")
    if not 0.2 <= exponent <= 5:
        raise InputError(f"exponent: expected a camera's response, 0.2…5, got {exponent:g}")
