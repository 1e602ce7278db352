"""A G-buffer made by code: a sphere seen by a pinhole camera (Take 2012, fig. 10)."""

from __future__ import annotations

import torch
from torch import Tensor

from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.errors import InputError


def sphere(
    size: int = 512,
    camera: tuple[float, float, float] = (0.0, 0.0, 6.0),
    *,
    samples: int = 2,
    margin: float = 1.08,
) -> GBuffer:
    """A unit sphere at the origin, filling the picture up to a margin.

    Args:
        size: width and height of the picture in pixels.
        camera: the camera's position, outside the sphere; it looks at the centre, y is up.
        samples: rays per pixel along each side; the maps are `samples` times larger than `size`
            (see `average_samples`).
        margin: half the picture's width over the sphere's apparent radius.

    Returns:
        Maps `[1, …, size·samples, size·samples]`; the mask is 1 on the sphere.
    """
    check_rays("sphere", size, samples)
    eye = torch.tensor(camera, dtype=torch.float64, device="cpu")
    distance = float(eye.norm())
    if not distance > 1.0:
        raise InputError(
            f"sphere: camera: expected a position outside the unit sphere, got {camera}"
        )
    half_width = margin / (distance**2 - 1) ** 0.5  # tangent of the half field of view
    rays = camera_rays(eye, size * samples, half_width)
    along = (rays * eye.view(3, 1, 1)).sum(0)
    square = (rays * rays).sum(0)
    root = along**2 - square * (distance**2 - 1)
    hit = (root >= 0)[None]
    reach = (-along - root.clamp(min=0).sqrt()) / square
    point = torch.where(hit, eye.view(3, 1, 1) + reach * rays, eye.new_zeros(3, 1, 1))
    maps = point.float()[None]
    return GBuffer(maps, position=maps, camera=camera, mask=hit.float()[None])


def check_rays(shape: str, size: int, samples: int) -> None:
    if size < 1 or samples < 1 or size * samples > 16384:
        raise InputError(
            f"{shape}: `size`: expected 1…16384 rays a side, got {size} with {samples} samples "
            "a pixel"
        )


def average_samples(image: Tensor, samples: int) -> Tensor:
    """Average the rays of each pixel, in linear light: `[B, C, H·s, W·s]` → `[B, C, H, W]`."""
    return torch.nn.functional.avg_pool2d(image, samples)


def camera_rays(eye: Tensor, n: int, half_width: float) -> Tensor:
    """`[3, n, n]` rays of a pinhole camera that looks at the origin, the first row on top."""
    forward = -eye / eye.norm()
    up = eye.new_tensor([0.0, 1.0, 0.0])
    if float(torch.linalg.cross(forward, up).norm()) < 1e-6:
        up = eye.new_tensor([0.0, 0.0, -1.0])
    right = torch.linalg.cross(forward, up)
    right = right / right.norm()
    up = torch.linalg.cross(right, forward)
    across = (2 * (torch.arange(n, dtype=eye.dtype, device=eye.device) + 0.5) / n - 1) * half_width
    return (
        forward.view(3, 1, 1)
        + right.view(3, 1, 1) * across.view(1, 1, n)
        - up.view(3, 1, 1) * across.view(1, n, 1)
    )
