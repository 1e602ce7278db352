"""Photometric stereo: photographs under several lamps → normals, albedo and how sure they are.

A matt surface under lamp k shines with I_k = s_k ρ (N·L_k), N the normal and L_k the direction to
the lamp (Woodham 1980, eq. (9)). With b = ρ N this is linear in b, and three lamps determine it.
Shadows and highlights break the law; so each pixel takes the lamps that light it, and weighs them
by how well they agree (iteratively reweighted least squares, which minimises Σ |I_k − s_k b·L_k|).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from raden_torch.errors import InputError

_Solved = tuple[Tensor, Tensor, Tensor]

Method = Literal["robust", "least-squares", "selection"]
METHODS: tuple[Method, ...] = ("robust", "least-squares", "selection")

MIN_LAMPS = 3
MIN_SPREAD = 0.03
"""Smallest singular value of the unit directions over √K below which they count as coplanar: errors
of the photographs would reach the normals thirtyfold."""
FULL_CONFIDENCE_DEG = 5.0
"""The standard error at which a normal's confidence is one half."""

_TILE = 1 << 15
_SAMPLE = 1 << 13
"""Pixels that the intensities are refined on."""
_SMALLEST_RESIDUAL = 1e-2
"""Of the albedo: below it lamps weigh alike, lest the L1 fit lock on to three of them."""
_UNSEEN = 0.01
"""A residual, relative to the albedo, that is granted where the lamps agree perfectly."""
_RIDGE = 1e-6
_ROUNDS = 12
_TURNS = 6
_TRUST, _INDEPENDENT = 0.1, 1.0
"""Relative standard deviation of intensities said to be slightly wrong; see `_refined`."""
_KEPT = 2 / 3
"""The share of the lit lamps that "selection" keeps."""


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
    count, channels, height, width = images.shape
    dtype = torch.float64 if images.dtype == torch.float64 else torch.float32
    device = images.device
    scale = torch.ones(count) if intensity is None else intensity
    scale = scale.to(device, dtype) / scale.mean().to(device, dtype)
    lights = lights.to(device, dtype)
    if lights.ndim == 2:
        lights = lights / lights.norm(dim=1, keepdim=True)
    inside = (
        torch.arange(height * width, device=device)
        if mask is None
        else (mask.to(device).reshape(-1) > 0.5).nonzero()[:, 0]
    )
    if len(inside) == 0:
        raise InputError("mask: expected white where the object is, got an empty mask")
    flat = images.reshape(count, channels, -1)
    full = None if saturated is None else saturated.to(device).reshape(count, -1)
    if refine_intensity:
        sample = inside[:: max(1, len(inside) // _SAMPLE)]
        part = _Pixels.of(flat, full, lights, sample, shadow, exponent, dtype)
        scale = _refined(part, scale, method)
    maps = torch.zeros(channels + 6, height * width, dtype=dtype, device=device)
    residuals = []
    thinned = max(1, len(inside) // _TILE)

    def solve(index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        part = _Pixels.of(flat, full, lights, index, shadow, exponent, dtype)
        solved, residual = _solve_tile(part, scale, method)
        return index, solved, residual[:, ::thinned]

    tiles = inside.split(_TILE)
    for k, (index, solved, residual) in enumerate(_in_threads(solve, tiles, device)):
        maps[:, index] = solved
        residuals.append(residual)
        if progress is not None:
            progress((k + 1) / len(tiles))
    found = maps.reshape(1, channels + 6, height, width)
    return SurfaceNormals(
        normal=found[:, :3],
        confidence=found[:, 3:4],
        error_deg=found[:, 4:5],
        lamps_used=found[:, 5:6],
        albedo=found[:, 6:],
        lamp_residual=torch.nanmedian(torch.cat(residuals, dim=1), dim=1).values,
        intensity=scale,
    )


def check_lights(lights: Tensor, name: object = "lights") -> None:
    """Raise InputError unless `[K, 3]` directions (or their means) determine a normal.

    Args:
        name: of the file or argument they come from, for messages.
    """
    count = len(lights)
    if count < MIN_LAMPS:
        raise InputError(f"{name}: expected at least {MIN_LAMPS} lamps, not in a row, got {count}")
    directions = lights.detach().double().cpu()
    length = directions.norm(dim=1, keepdim=True)
    if not bool(torch.isfinite(directions).all()) or bool((length == 0).any()):
        raise InputError(
            f"{name}: expected vectors to the lamps, got a direction that is zero or not finite"
        )
    spread = float(torch.linalg.svdvals(directions / length)[-1]) / count**0.5
    if spread < MIN_SPREAD:
        raise InputError(
            f"{name}: expected lamps of spread {MIN_SPREAD} or more, got {spread:.3f}: they lie "
            "in one plane with the object; move one of them out of the row"
        )


@dataclass(frozen=True)
class _Pixels:
    """P pixels: `[K, C, P]` values, `[K, P]` their mean, `[K, 3]` or `[K, 3, P]` lights, and
    `[K, P]` 1 where the lamp lights the pixel, else 0."""

    value: Tensor
    grey: Tensor
    lights: Tensor
    lit: Tensor

    @classmethod
    def of(
        cls,
        flat: Tensor,
        full: Tensor | None,
        lights: Tensor,
        index: Tensor,
        shadow: float,
        exponent: float,
        dtype: torch.dtype,
    ) -> _Pixels:
        value = flat[:, :, index].to(dtype).clamp(min=0)
        if exponent != 1:
            value = value**exponent
        value = torch.nan_to_num(value, posinf=0.0)
        grey = value[:, 0] if value.shape[1] == 1 else value.mean(dim=1)
        usable = grey if full is None else grey * ~full[:, index]
        # the third brightest: one or two highlights must not make shadows of the rest
        level = _sorted(usable)[-MIN_LAMPS]
        lit = ((usable > shadow * level) & (usable > 0)).to(dtype)
        # with fewer than three lamps lit, the three brightest unsaturated ones
        few = lit.sum(dim=0) < MIN_LAMPS
        if bool(few.any()):
            lit[:, few] = ((usable[:, few] >= level[few]) & (usable[:, few] > 0)).to(dtype)
        near = lights if lights.ndim == 2 else lights.reshape(len(lights), 3, -1)[:, :, index]
        return cls(value, grey, near, lit)


def _in_threads(
    solve: Callable[[Tensor], _Solved], tiles: Sequence[Tensor], device: torch.device
) -> Iterator[_Solved]:
    """A tile a thread, on the CPU: many small operators wait for each other if torch divides each
    of them among the threads, the longer the busier the machine is."""
    threads = torch.get_num_threads()
    if device.type != "cpu" or threads == 1:
        yield from map(solve, tiles)
        return
    pool = ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
    try:
        yield from pool.map(solve, tiles)
    finally:
        pool.shutdown(cancel_futures=True)
        torch.set_num_threads(threads)  # what the workers set reaches parts of torch for all


def _solve_tile(part: _Pixels, scale: Tensor, method: Method) -> tuple[Tensor, Tensor]:
    """`[6 + C, P]` normal, confidence, error, lamps, albedo; and `[K, P]` relative residuals."""
    lights = part.lights * scale.view(-1, *[1] * (part.lights.ndim - 1))
    b, weight = _fitted(part, lights, method)
    rho = _length(b)
    solved = (part.lit.sum(dim=0) >= MIN_LAMPS) & (rho > 0) & torch.isfinite(rho)
    normal = torch.where(solved, b / torch.where(solved, rho, 1.0), 0.0)
    predicted = _toward(lights, normal)
    relative = (part.grey / torch.where(solved, rho, 1.0) - predicted).abs()
    error = _standard_error_deg(part, lights, normal, relative, weight)
    error = torch.where(solved, error, 0.0)
    confidence = torch.where(solved, 1 / (1 + (error / FULL_CONFIDENCE_DEG) ** 2), 0.0)
    facing = weight * predicted.clamp(min=0)
    norm = (facing * predicted).sum(dim=0)
    albedo = (facing[:, None] * part.value).sum(dim=0) / norm.clamp(min=1e-12)
    rows = [normal, confidence[None], error[None], part.lit.sum(dim=0)[None], albedo * solved]
    return torch.cat(rows), torch.where(solved & (part.lit > 0), relative, torch.nan)


def _fitted(part: _Pixels, lights: Tensor, method: Method) -> tuple[Tensor, Tensor]:
    """b `[3, P]` and the weights `[K, P]` that it was found with."""
    weight = part.lit
    b = _least_squares(part.grey, lights, weight)
    if method == "robust":
        for _ in range(_ROUNDS):
            rho = _length(b)
            residual = (part.grey - _toward(lights, b)).abs_()
            weight = part.lit / torch.maximum(residual, _SMALLEST_RESIDUAL * rho).clamp_(min=1e-12)
            weight *= rho  # so that sums of weights do not depend on the exposure
            b = _least_squares(part.grey, lights, weight)
    elif method == "selection":
        kept = (part.lit.sum(dim=0) * _KEPT).ceil().clamp(min=MIN_LAMPS + 1).long() - 1
        for _ in range(_ROUNDS):
            residual = (part.grey - _toward(lights, b)).abs_()
            residual = torch.where(part.lit > 0, residual, torch.inf)
            limit = _sorted(residual).gather(0, kept.clamp(max=len(lights) - 1)[None])
            weight = part.lit * (residual <= limit)
            b = _least_squares(part.grey, lights, weight)
    return b, weight


def _least_squares(grey: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """b `[3, P]` that minimises Σ w (I − L·b)²."""
    weighted = weight * grey
    if lights.ndim == 2:
        p, q, r = lights.T @ weighted
    else:
        p, q, r = (lights * weighted[:, None]).sum(dim=0)
    a, d, f, b, c, e = _inverse(lights, weight)
    return torch.stack([a * p + b * q + c * r, b * p + d * q + e * r, c * p + e * q + f * r])


def _inverse(lights: Tensor, weight: Tensor) -> tuple[Tensor, ...]:
    """xx, yy, zz, xy, xz, yz `[P]` of (Σ w L Lᵀ)⁻¹, by the adjugate."""
    x, y, z = lights.unbind(1)
    pairs = torch.stack([x * x, y * y, z * z, x * y, x * z, y * z])
    if lights.ndim == 2:
        xx, yy, zz, xy, xz, yz = pairs @ weight
    else:
        xx, yy, zz, xy, xz, yz = (pairs * weight).sum(dim=1)
    # two lamps alone leave a direction free; a ridge of 1e-6 keeps it finite
    trace = (xx + yy + zz).clamp(min=torch.finfo(weight.dtype).tiny)
    xx, yy, zz, xy, xz, yz = (m / trace for m in (xx, yy, zz, xy, xz, yz))
    xx, yy, zz = xx + _RIDGE, yy + _RIDGE, zz + _RIDGE
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = 1 / ((xx * a + xy * b + xz * c).clamp(min=_RIDGE**3) * trace)
    return a * scale, d * scale, f * scale, b * scale, c * scale, e * scale


def _length(b: Tensor) -> Tensor:
    """|b| `[P]`; `Tensor.norm` over the first dimension takes fifty times as long."""
    return (b * b).sum(dim=0).sqrt()


def _sorted(m: Tensor) -> Tensor:
    """`[K, P]` sorted along K, smallest first, by odd-even transposition: for K of a few dozen and
    many P it is far faster than `torch.sort`, which goes down each column by itself."""
    m = m.clone()
    for i in range(len(m)):
        low, high = m[i % 2 : -1 : 2], m[i % 2 + 1 :: 2]
        smaller = torch.minimum(low, high)
        torch.maximum(low, high, out=high)
        low.copy_(smaller)
    return m


def _toward(lights: Tensor, b: Tensor) -> Tensor:
    """L·b `[K, P]`."""
    return lights @ b if lights.ndim == 2 else (lights * b).sum(dim=1)


def _standard_error_deg(
    part: _Pixels, lights: Tensor, normal: Tensor, relative: Tensor, weight: Tensor
) -> Tensor:
    """The normal's standard error `[P]`: σ √(trace of (Σ w L Lᵀ)⁻¹ across N), w of mean 1.

    σ² is the weighted mean square of the residuals over K − 3 degrees of freedom.
    """
    total = weight.sum(dim=0).clamp(min=1e-12)
    used = part.lit.sum(dim=0)
    variance = (weight * relative * relative).sum(dim=0) / total * used
    variance = variance / (used - MIN_LAMPS).clamp(min=1) + _UNSEEN**2
    a, d, f, b, c, e = _inverse(lights, weight / total * used)
    x, y, z = normal
    along = a * x * x + d * y * y + f * z * z + 2 * (b * x * y + c * x * z + e * y * z)
    across = (a + d + f - along).clamp(min=0)
    return torch.rad2deg((variance * across).sqrt()).clamp(max=90.0)


def _refined(part: _Pixels, scale: Tensor, method: Method) -> Tensor:
    """Intensities that fit best; their mean stays 1.

    Σ w (I_k/s_k − L_k·b)² is a square form in t = 1/s once b is eliminated, pixel by pixel. Its
    minimum alone would take up the directions' errors, which neighbouring pixels share; so all
    pixels together count as `_INDEPENDENT` measurements with the variance that is seen, beside the
    intensities given, which are believed to `_TRUST`. Directions and intensities together determine
    both but for a common factor, where K ≥ 5.
    """
    given = scale
    bare = part.lights if part.lights.ndim == 3 else part.lights[..., None]
    for _ in range(_TURNS):
        lights = part.lights * scale.view(-1, *[1] * (part.lights.ndim - 1))
        b, weight = _fitted(part, lights, method)
        weight = weight / _length(b).clamp(min=1e-12) ** 2
        xx, yy, zz, xy, xz, yz = _inverse(part.lights, weight)
        inverse = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz]).reshape(3, 3, -1)
        weighted = weight[:, None] * bare * part.grey[:, None]
        seen = torch.einsum("kip,ijp,mjp->km", weighted, inverse, weighted)
        form = torch.diag((weight * part.grey**2).sum(dim=1)) - seen
        form = form.double() / part.grey.shape[1]
        reciprocal = 1 / scale.double()
        variance = float(reciprocal @ form @ reciprocal) / max(1, len(scale) - MIN_LAMPS)
        prior = torch.diag(given.double() ** 2) / _TRUST**2
        data = form * (_INDEPENDENT / max(variance, 1e-10))
        solved = torch.linalg.solve(data + prior, prior @ (1 / given.double()))
        reciprocal = solved.to(scale.dtype)
        if not bool((reciprocal > 0).all()):
            return scale
        scale = 1 / reciprocal
        scale = scale / scale.mean()
    return scale


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
