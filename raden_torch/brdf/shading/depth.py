"""Depth channels: what their values mean, where there are none, and how to difference them."""

from __future__ import annotations

import warnings
from typing import Literal, cast, get_args

import numpy as np
import torch
from torch import Tensor

from raden_torch.errors import InputError

DepthKind = Literal["planar", "distance", "negative"]
"""planar: along the camera's axis; distance: along the pixel's ray; negative: z of a camera that
looks along −z, minus the planar one."""
RENDERERS: dict[str, DepthKind] = {
    # Cycles, src/kernel/film/data_passes.h: camera_z_depth(kg, sd->P); 1e10 where nothing is
    "blender": "planar",
    # Karma's render variable "depth" is ray:hitPz, along the view axis (ray:hitdist is not)
    "karma": "planar",
    # Mitsuba's manual, "Arbitrary Output Variables integrator (aov)": distance from the pinhole;
    # Mitsuba 3.9 counts it from the near clipping plane (0.01 by default); 0 where nothing is
    "mitsuba": "distance",
}
"""What the depth of some renderers is."""
KINDS = (*get_args(DepthKind), *RENDERERS)

FAR = 1e9
"""Depth from which on there is nothing; so also 65504, the largest half."""
LARGEST_HALF = 65504.0
MAX_SMOOTH_PX = 100.0


def depth_kind(name: str) -> DepthKind:
    """A kind, or a renderer's.

    Raises:
        InputError: neither of `KINDS`.
    """
    if name not in KINDS:
        raise InputError(f"depth kind: expected {' or '.join(KINDS)}, got {name!r}")
    return RENDERERS.get(name) or cast(DepthKind, name)


def in_front(stored: Tensor, kind: DepthKind) -> Tensor:
    """Depth that is positive in front of the camera; still planar or a distance."""
    return -stored if kind == "negative" else stored


def to_planar(depth: Tensor, kind: DepthKind, rays: Tensor) -> Tensor:
    """z along the camera's axis from depth in front of it.

    A distance d on the ray (x, y, 1) is z = d / √(1 + x² + y²).

    Args:
        depth: `[B, 1, H, W]`, as `in_front` returns it.
        rays: `[B or 1, 3, H, W]` from the camera with ±1 along its axis.
    """
    if kind != "distance":
        return depth
    return depth / torch.linalg.vector_norm(rays, dim=1, keepdim=True).to(depth.dtype)


def is_depth(depth: Tensor) -> Tensor:
    """Where depth in front of the camera is that of something."""
    return torch.isfinite(depth) & (depth > 0) & (depth < FAR) & (depth != LARGEST_HALF)


def grown(depth: Tensor, there: Tensor, smooth_px: float) -> Tensor:
    """The depth, smoothed where that is asked for, and continued over its edge.

    So the differences at a silhouette are those of the surface, not of a surface and nothing.
    """
    from kornia.filters import gaussian_blur2d

    weight = there.to(depth.dtype)
    known = torch.where(there, depth, torch.zeros_like(depth))
    if smooth_px > 0:
        size = 2 * int(np.ceil(3 * smooth_px)) + 1
        smallest = min(depth.shape[-2:])
        size = min(size, 2 * ((smallest - 1) // 2) + 1)
        blur = ((size, size), (smooth_px, smooth_px), "replicate")
        total, share = gaussian_blur2d(known, *blur), gaussian_blur2d(weight, *blur)
    else:
        total, share = (torch.nn.functional.avg_pool2d(m, 3, 1, 1) for m in (known, weight))
    around = torch.where(share > 1e-6, total / share.clamp(min=1e-6), torch.full_like(share, -1.0))
    return around if smooth_px > 0 else torch.where(there, depth, around)


def warn_of_steps(path: object, depth: Tensor, matrix: Tensor) -> None:
    """Depth in steps of half precision that are coarse beside a pixel gives terraces."""
    if len(depth) == 0 or not torch.equal(depth.half().float(), depth):
        return
    middle = float(depth.median())
    step, pixel = float(np.spacing(np.float16(middle))), middle / float(matrix[0, 0])
    if step > pixel / 8 and len(torch.unique(depth)) > 16:
        warnings.warn(
            f"{path}: depth in half precision, in steps of {step:.2g} where a pixel is "
            f"{pixel:.2g} wide: the normals will be terraced; smooth it (smooth_px), or write the "
            "depth in 32 bits",
            stacklevel=5,
        )
