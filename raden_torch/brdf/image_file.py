"""Photographs, normal maps and masks as files, through OpenCV."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.gbuffer import GBuffer
from raden_torch.brdf.normal_axes import Green, NormalAxes
from raden_torch.brdf.normal_check import warn_of_normals
from raden_torch.errors import InputError
from raden_torch.images.mask import read_mask_pixels
from raden_torch.images.pixels import draw_caption, read_pixels, write_pixels

_FLOAT_SUFFIXES = (".exr", ".hdr", ".tif", ".tiff")


@dataclass(frozen=True)
class Photograph:
    """A photograph in linear light, and how it was stored.

    Attributes:
        linear: `[1, 3, H, W]`, RGB; sRGB files are decoded, float files are taken as linear.
        levels: the largest stored value: 255, 65535, or None for floating-point files.
    """

    linear: Tensor
    levels: int | None


def read_photograph(
    path: str | os.PathLike[str], *, coded: Literal["srgb", "linear"] = "srgb"
) -> Photograph:
    """Read an 8- or 16-bit PNG, JPEG or TIFF, or a float TIFF, HDR or EXR (linear).

    Args:
        coded: whether whole numbers are sRGB, or linear light as a camera's raw converter may
            write it.

    Raises:
        InputError: missing, not an image, or too large.
    """
    if Path(path).suffix.lower() == ".exr":
        return Photograph(_exr_colour(path), None)
    from kornia.color import rgb_to_linear_rgb

    pixels = read_pixels(path, colour=True)
    levels = _levels(pixels)
    rgb = _tensor(pixels)
    if levels is None:
        return Photograph(rgb, None)
    stored = rgb / levels
    return Photograph(stored if coded == "linear" else rgb_to_linear_rgb(stored), levels)


def write_photograph(
    photo: Photograph,
    path: str | os.PathLike[str],
    caption: str | None = None,
    *,
    coded: Literal["srgb", "linear"] = "srgb",
) -> None:
    """Write a photograph as it was stored: its bit depth, sRGB for whole numbers.

    Args:
        caption: a small line drawn into the lower left corner of a whole-number file.
        coded: "linear" leaves whole numbers without the sRGB curve, as normal maps and masks are.

    Raises:
        InputError: a suffix that cannot hold it.
    """
    from kornia.color import linear_rgb_to_rgb

    suffix = Path(path).suffix.lower()
    rgb = photo.linear[0].detach().cpu()
    pixels: NDArray[Any]
    if photo.levels is None:
        _check_suffix(path, _FLOAT_SUFFIXES, "a floating-point photograph")
        pixels = rgb.movedim(0, -1).numpy()
    else:
        _check_suffix(path, (".png", ".jpg", ".jpeg", ".tif", ".tiff"), "a photograph")
        levels = 255 if suffix in (".jpg", ".jpeg") else photo.levels
        shown = rgb[None].clamp(0, 1)
        shown = linear_rgb_to_rgb(shown) if coded == "srgb" else shown
        pixels = np.rint(shown[0].movedim(0, -1).numpy() * levels).astype(
            np.uint8 if levels == 255 else np.uint16
        )
    if suffix == ".exr":
        from raden_torch.brdf.gbuffer_file import write_image

        write_image(photo.linear, path)
        return
    if caption and photo.levels is not None:
        pixels = np.ascontiguousarray(pixels)
        draw_caption(pixels, caption)
    write_pixels(pixels, path)


def _exr_colour(path: str | os.PathLike[str]) -> Tensor:
    from raden_torch.brdf.gbuffer_file import read_colour
    from raden_torch.images.exr import list_channels

    colour = read_colour(path)
    if colour is None:
        raise InputError(f"{path}: no R, G, B; it has {', '.join(list_channels(path))}")
    return colour


def read_normal_map(
    path: str | os.PathLike[str],
    green: Green = "opengl",
    *,
    xyz: str = "r,g,b",
    fov_deg: float | None = None,
    depth: str | None = None,
) -> Tensor:
    """Read a normal map, x right, y up, z to the viewer.

    Whole-number files hold (n + 1)/2; float files hold n itself, or (n + 1)/2 where nothing in them
    is negative. Black pixels, and pixels with alpha 0, have no normal.

    Args:
        green: "opengl" where green points up, "directx" where it points down.
        xyz: the channels that hold x, y and z, as in "b,g,r", with a minus where one points the
            other way: "r,g,-b".
        fov_deg, depth: horizontal field of view, and what the depth is (as for `read_gbuffer`), of
            an EXR that holds depth instead of normals.

    Returns:
        `[1, 3, H, W]` unit normals, zero where there is none.

    Raises:
        InputError: not an image of three channels.

    Warns:
        UserWarning: a JPEG, whose blocks tilt the normals; a map that by its lengths, directions or
            slopes is stored otherwise (see `normal_check`).
    """
    axes = NormalAxes.of(xyz, green)
    if Path(path).suffix.lower() == ".exr":
        from raden_torch.brdf.gbuffer_file import read_gbuffer

        normal = _masked_normals(read_gbuffer(path, fov_deg=fov_deg, depth=depth, xyz=str(axes)))
    else:
        pixels = read_pixels(path, colour=False)
        if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
            raise InputError(f"{path}: a normal map of three channels was wanted")
        if Path(path).suffix.lower() in (".jpg", ".jpeg"):
            warnings.warn(
                f"{path}: an 8-bit JPEG holds normals badly (its blocks tilt them by degrees); "
                "a 16-bit PNG or an EXR holds them well",
                stacklevel=2,
            )
        coded, levels = _tensor(pixels[..., :3]), _levels(pixels)
        stored = decoded_normals(coded, levels)
        if pixels.shape[2] == 4:
            stored = stored * (_tensor(pixels[..., 3:]) > 0)
        is_coded = levels is not None or not bool((coded < 0).any())
        step = 2 / levels if levels else 1e-3
        warn_of_normals(path, stored, axes, is_coded=is_coded, step=step)
        normal = axes.of_map(stored)
    return torch.nn.functional.normalize(normal, dim=1)


def _masked_normals(gbuffer: GBuffer) -> Tensor:
    if gbuffer.mask is None:
        return gbuffer.normal
    return torch.where(gbuffer.mask > 0, gbuffer.normal, torch.zeros_like(gbuffer.normal))


def decoded_normals(coded: Tensor, levels: int | None) -> Tensor:
    """(n + 1)/2 → n, where it is coded so; zero where all three channels are 0."""
    signed = levels is None and bool((coded < 0).any())
    there = (coded != 0).any(dim=1, keepdim=True)
    return (coded if signed else 2 * coded / (levels or 1) - 1) * there


def read_mask(path: str | os.PathLike[str]) -> Tensor:
    """Read a mask `[1, 1, H, W]`, 0…1, as `read_mask_pixels` does."""
    return torch.from_numpy(read_mask_pixels(path))[None, None]


def _levels(pixels: NDArray[Any]) -> int | None:
    return None if pixels.dtype.kind == "f" else int(np.iinfo(pixels.dtype).max)


def _tensor(pixels: NDArray[Any]) -> Tensor:
    """`[H, W, C]` → `[1, C, H, W]` float32."""
    return torch.from_numpy(np.ascontiguousarray(pixels, np.float32)).movedim(-1, 0)[None]


def _check_suffix(path: str | os.PathLike[str], suffixes: tuple[str, ...], what: str) -> None:
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes:
        raise InputError(
            f"{path}: {what} goes into {', '.join(suffixes)}, not {suffix or '(none)'}"
        )
