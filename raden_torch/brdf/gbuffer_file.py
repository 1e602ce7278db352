"""G-buffers in OpenEXR files: which channels are the normals, the positions, the depth.

Whatever the file holds, the G-buffer is in one frame: x right, y up, z to the viewer. Normals and
positions are taken as they are; a renderer that writes world-space vectors must have looked along
−z, or the lights are in its world's frame. Positions and normals that come from depth have the
camera at the origin and the scene at z < 0.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from math import radians, tan

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from raden_torch.brdf.exr_layers import Layers
from raden_torch.brdf.gbuffer import GBuffer
from raden_torch.brdf.lights import Triple
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels

FAR = 1e9
"""Depth from which on there is nothing; so also 65504, the largest half."""
MAX_SMOOTH_PX = 100.0
_LARGEST_HALF = 65504.0
_Y_UP = (1.0, -1.0, -1.0)  # x right, y down, z forward → x right, y up, z to the viewer


def read_gbuffer(
    path: str | os.PathLike[str],
    *,
    channels: Mapping[str, str] | None = None,
    intrinsics: Tensor | ArrayLike | None = None,
    fov_deg: float | None = None,
    camera: Triple | None = None,
    view: Triple | None = None,
    smooth_px: float = 0.0,
) -> GBuffer:
    """The G-buffer in an EXR file; the frame is that of this module.

    Normals are found by name (`NAMES`, as "N.X", "Normal.R", "ViewLayer.Normal.X") or are the bare
    RGB of a file whose colours are unit vectors, not all positive. They are decoded from (n + 1)/2
    where no value is below −0.02 and the median vector comes nearer to unit length by it. Without
    normals they are made from depth, the distance along the camera's axis.

    The direction to the viewer is, the first that is given: `view`; from positions to `camera`; a
    pinhole's, by `intrinsics` or `fov_deg`; (0, 0, 1), a camera at infinity that looks along −z.

    Args:
        channels: layers by name, `{"normal": "MyLayer", "position": …, "depth": "Z2", "mask": …}`;
            a vector's three channels also as "nx,ny,nz".
        intrinsics: `[3, 3]` pinhole matrix in pixels of the display window, y down.
        fov_deg: instead, the horizontal angle of view of square pixels around the centre.
        camera: `[3]`, the viewer's position, for a file with positions.
        view: `[3]` towards a viewer at infinity, or a map `[1, 3, H, W]`.
        smooth_px: standard deviation of a Gaussian over the depth before normals are made of it;
            depth in half precision needs one of several pixels.

    Returns:
        A batch of 1 in float32. The mask is the file's mask or alpha, and 0 where the normal is
        zero or not finite, or the depth is: not finite, not positive, beyond `FAR` or 65504.

    Raises:
        InputError: no such channel (the message lists those there are), depth without a camera, no
            valid pixel, or a file that `read_parts` rejects.

    Warns:
        UserWarning: the steps of half-precision depth will show in the normals.
    """
    source = Layers.of(path, channels)
    if view is not None and camera is not None:
        raise InputError(f"{path}: view and camera are both given; one of them was wanted")
    normal, depth = source.normals(), source.scalar("depth")
    matrix = _matrix(intrinsics, fov_deg, source.size)
    if not 0 <= smooth_px <= MAX_SMOOTH_PX:
        raise InputError(f"smooth_px {smooth_px:g}; 0…{MAX_SMOOTH_PX:g} pixels were wanted")
    if normal is not None:
        gbuffer = _from_normals(source, normal, depth, matrix, camera, view)
    elif depth is None:
        raise source.missing("no normals and no depth")
    elif matrix is None:
        raise InputError(
            f"{path}: depth without normals; give intrinsics or fov_deg, or name the normals' "
            f"layer among its channels {source.listing}"
        )
    elif camera is not None:
        raise source.camera_is_at_origin()
    else:
        gbuffer = _from_depth(source, depth, matrix, view, smooth_px)
    if not (gbuffer.mask is None or bool((gbuffer.mask > 0).any())):
        raise InputError(
            f"{path}: no valid pixel; normals that are not zero, depth between 0 and {FAR:g} and a "
            "mask above 0 were wanted"
        )
    return gbuffer


def read_colour(
    path: str | os.PathLike[str], *, channels: Mapping[str, str] | None = None
) -> Tensor | None:
    """`[1, 3, H, W]` scene-linear RGB of the file, or None where it holds none.

    As OpenEXR has it, multiplied by alpha. The bare R, G, B, or a layer in `NAMES`; values that are
    not finite become 0. Bare colours that are unit vectors are normals, not colours.

    Args:
        channels: as for `read_gbuffer`, `{"colour": "Layer"}`.
    """
    source = Layers.of(path, channels)
    colour = source.vector("colour")
    if colour is None or ("colour" not in source.chosen and source.bare_normals() is not None):
        return None
    return torch.where(torch.isfinite(colour), colour, torch.zeros_like(colour))


def write_image(image: Tensor, path: str | os.PathLike[str]) -> None:
    """Write scene-linear `[1, 3, H, W]` RGB as an EXR of half floats, cut off at ±65504."""
    if image.ndim != 4 or image.shape[:2] != (1, 3):
        raise InputError(f"{path}: image of shape {list(image.shape)}; [1, 3, H, W] was wanted")
    rgb = image[0].detach().float().clamp(-_LARGEST_HALF, _LARGEST_HALF).cpu().numpy()
    write_channels(path, dict(zip("RGB", rgb, strict=True)), half=True)


def _from_normals(
    source: Layers,
    normal: Tensor,
    depth: Tensor | None,
    matrix: Tensor | None,
    camera: Triple | None,
    view: Triple | None,
) -> GBuffer:
    position = source.vector("position")
    mask = _mask(source, (normal != 0).any(dim=1, keepdim=True))
    if depth is not None:
        mask = mask * _is_depth(depth)
    rays = None if matrix is None else _rays(matrix, source.size)
    if position is None and depth is not None and rays is not None:
        position = torch.where(_is_depth(depth), depth, torch.ones_like(depth)) * rays
        if camera is not None:
            raise source.camera_is_at_origin()
        camera = (0.0, 0.0, 0.0) if view is None else None
    if camera is not None:
        if position is None:
            raise source.missing("camera is given, but there are no positions (position=LAYER)")
        return GBuffer(normal, position=position, camera=camera, mask=mask)
    if view is None:
        view = (0.0, 0.0, 1.0) if rays is None else -rays
    return GBuffer(normal, view=_as_view(view), position=position, mask=mask)


def _from_depth(
    source: Layers, depth: Tensor, matrix: Tensor, view: Triple | None, smooth_px: float
) -> GBuffer:
    there = _is_depth(depth)
    if smooth_px <= 0:
        _warn_of_steps(source, depth[there], matrix)
    made = GBuffer.from_depth(_grown(depth, there, smooth_px), matrix)
    y_up = depth.new_tensor(_Y_UP).view(3, 1, 1)
    normal = torch.where(there, made.normal * y_up, torch.zeros_like(made.normal))
    # the rays of the depth as it was stored, not of what the normals were made from
    position = torch.where(there, depth, torch.ones_like(depth)) * _rays(matrix, source.size)
    mask = _mask(source, there)
    if view is not None:
        return GBuffer(normal, view=_as_view(view), position=position, mask=mask)
    return GBuffer(normal, position=position, camera=(0.0, 0.0, 0.0), mask=mask)


def _mask(source: Layers, there: Tensor) -> Tensor:
    mask = source.scalar("mask")
    if mask is None:
        return there.float()
    return torch.nan_to_num(mask, nan=0.0).clamp(0, 1) * there


def _is_depth(depth: Tensor) -> Tensor:
    return torch.isfinite(depth) & (depth > 0) & (depth < FAR) & (depth != _LARGEST_HALF)


def _grown(depth: Tensor, there: Tensor, smooth_px: float) -> Tensor:
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


def _warn_of_steps(source: Layers, depth: Tensor, matrix: Tensor) -> None:
    """Depth in steps of half precision that are coarse beside a pixel gives terraces."""
    if len(depth) == 0 or not torch.equal(depth.half().float(), depth):
        return
    middle = float(depth.median())
    step, pixel = float(np.spacing(np.float16(middle))), middle / float(matrix[0, 0])
    if step > pixel / 8 and len(torch.unique(depth)) > 16:
        warnings.warn(
            f"{source.path}: depth in half precision, in steps of {step:.2g} where a pixel is "
            f"{pixel:.2g} wide: the normals will be terraced; smooth it (smooth_px), or write the "
            "depth in 32 bits",
            stacklevel=4,
        )


def _matrix(
    intrinsics: Tensor | ArrayLike | None, fov_deg: float | None, size: tuple[int, int]
) -> Tensor | None:
    """`[3, 3]` float32, or None."""
    if intrinsics is not None and fov_deg is not None:
        raise InputError("intrinsics and fov_deg are both given; one of them was wanted")
    height, width = size
    if fov_deg is not None:
        if not 0 < fov_deg < 180:
            raise InputError(f"fov_deg {fov_deg:g}; an angle between 0 and 180 was wanted")
        focal = width / 2 / tan(radians(fov_deg) / 2)
        centre_x, centre_y = (width - 1) / 2, (height - 1) / 2
        intrinsics = np.array([[focal, 0, centre_x], [0, focal, centre_y], [0, 0, 1]])
    if intrinsics is None:
        return None
    matrix = torch.as_tensor(intrinsics, dtype=torch.float32)
    usable = matrix.shape == (3, 3) and bool(torch.isfinite(matrix).all())
    if not usable or float(matrix[0, 0]) <= 0 or float(matrix[1, 1]) <= 0:
        raise InputError(
            f"intrinsics {matrix.tolist()}; a matrix [3, 3] with focal lengths above 0 was wanted"
        )
    return matrix


def _rays(matrix: Tensor, size: tuple[int, int]) -> Tensor:
    """`[1, 3, H, W]` from the camera through each pixel, with −1 along z (y up)."""
    height, width = size
    v, u = torch.meshgrid(
        torch.arange(height, dtype=torch.float64),
        torch.arange(width, dtype=torch.float64),
        indexing="ij",
    )
    pixels = torch.stack([u, v, torch.ones_like(u)])
    rays = torch.einsum("ij,jhw->ihw", torch.linalg.inv(matrix.double()), pixels)
    return (rays * rays.new_tensor(_Y_UP).view(3, 1, 1)).float()[None]


def _as_view(view: Tensor | Sequence[float]) -> Tensor:
    return torch.as_tensor(view, dtype=torch.float32)
