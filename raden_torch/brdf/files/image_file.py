"""Photographs, normal maps and masks as files."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.files.display import Display
from raden_torch.brdf.files.exr_tensors import read_colour, stacked
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.files.normal_axes import Green, NormalAxes
from raden_torch.brdf.files.normal_check import warn_of_normals
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.errors import InputError
from raden_torch.geometry import normalised
from raden_torch.images.colour_space import (
    SRGB_SPACE,
    colour_space_of,
    exr_matrix,
    float_matrix,
    in_srgb,
    no_primaries,
)
from raden_torch.images.exr import write_channels
from raden_torch.images.exr_file import ExrFile
from raden_torch.images.exr_layers import Layers
from raden_torch.images.lookup_profile import LookupProfile
from raden_torch.images.mask import read_mask_pixels
from raden_torch.images.pixels import (
    OPAQUE_ENOUGH,
    draw_caption,
    read_image,
    read_pixels,
    write_pixels,
)
from raden_torch.images.raw import is_raw, read_raw
from raden_torch.images.raw_image import raw_in_colour

_FLOAT_SUFFIXES = (".exr", ".hdr", ".tif", ".tiff")
_WHOLE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".hdr")
_WITHOUT_ALPHA = (".jpg", ".jpeg", ".hdr")
_BEYOND_SRGB = 1e-3
"""Of linear light: colours with less than minus this are told."""


@dataclass(frozen=True)
class Photograph:
    """A photograph in linear light, and how it was stored.

    Attributes:
        linear: `[1, 3, H, W]`, linear RGB of sRGB's primaries, not multiplied by alpha.
        levels: the largest stored value: 255, 65535, or None for floating-point files.
        alpha: `[1, 1, H, W]`, 0…1; None where the file has none.
    """

    linear: Tensor
    levels: int | None
    alpha: Tensor | None = None


def read_photograph(
    path: str | os.PathLike[str], *, coded: Literal["srgb", "linear"] = "srgb"
) -> Photograph:
    """Read an 8- or 16-bit PNG, JPEG, TIFF, BMP, GIF, WebP or HEIC, a float TIFF, HDR or EXR
    (linear), or a camera's raw file, in the colours that it says itself.

    A colour profile, PNG's colour chunks and OpenEXR's chromaticities are followed: the result has
    sRGB's primaries, unclipped. EXIF's orientation is followed, as in every image that is read.

    Args:
        coded: whether whole numbers are what the file's profile says (sRGB where it has none), or
            linear light of its primaries, as a camera's raw converter may write it. A raw file is
            linear whatever is said here.

    Raises:
        InputError: as for `read_image`, `colour_space_of` and `float_matrix`, of a raw file as for
            `read_raw` and `raw_in_colour`; whole numbers of other sizes; linear light with a
            profile of lookup tables; an EXR without colours.

    Warns:
        UserWarning: an 8- or 16-bit photograph with colours that sRGB cannot hold; of a raw file
            where its colours are from, and what corrections it asks for.
    """
    if is_raw(path):
        return _raw_photograph(path)
    if Path(path).suffix.lower() == ".exr":
        return _exr_photograph(path)
    image = read_image(path)
    levels, tags = _levels(path, image.pixels), image.header.colour
    if levels is None:
        matrix = float_matrix(tags, path, is_linear=coded == "linear")
        rgb = _finite(image.rgb)
    elif isinstance(space := colour_space_of(tags, path) or SRGB_SPACE, LookupProfile):
        if coded == "linear":
            raise no_primaries(path)
        rgb, matrix = space.linear(image.rgb, levels), None
    else:
        ramp = np.linspace(0, 1, levels + 1, dtype=np.float32)[:, None].repeat(3, 1)
        table = ramp if coded == "linear" else space.table(levels)
        stored, matrix = image.rgb, space.matrix
        rgb = np.stack([table[:, c].take(stored[..., c]) for c in range(3)], -1)
    rgb = in_srgb(rgb, matrix)
    if levels is not None and (matrix is not None or isinstance(space, LookupProfile)):
        _warn_of_gamut(path, rgb)
    alpha = None
    if image.alpha is not None:
        alpha = _tensor(np.clip(_finite(image.alpha) / (levels or 1), 0, 1)[..., None])
    return Photograph(_tensor(rgb), levels, alpha)


_CLIPPED = Display(0.0, gamut="clip")


def check_photograph(
    photo: Photograph, path: str | os.PathLike[str], display: Display = _CLIPPED
) -> None:
    """Raise InputError where `write_photograph` could not write it under this suffix."""
    if display.colour_space != "srgb":  # which goes unsaid
        _check_suffix(path, display.suffixes, display.colour_space)
    if photo.levels is None:
        _check_suffix(path, _FLOAT_SUFFIXES, "a floating-point photograph")
    else:
        _check_suffix(path, _WHOLE_SUFFIXES, "a photograph")


def write_photograph(
    photo: Photograph,
    path: str | os.PathLike[str],
    caption: str | None = None,
    *,
    coded: Literal["srgb", "linear"] = "srgb",
    display: Display = _CLIPPED,
) -> None:
    """Write a photograph as it was stored: its bit depth, its alpha, sRGB for whole numbers; 8 bits
    into a JPEG, linear floats into an EXR or HDR.

    sRGB goes unsaid: whole numbers without a profile are sRGB, floats linear sRGB. An EXR's colours
    are multiplied by alpha, a PNG's and a TIFF's are not.

    Args:
        caption: a small line drawn into the lower left corner of a whole-number file.
        coded: "linear" leaves whole numbers without the sRGB curve, as normal maps and masks are.
        display: whose gamut and colour space the file has; the light is exposed and toned already.

    Raises:
        InputError: a suffix that cannot hold it.

    Warns:
        UserWarning: an alpha that the format has no place for, and that is not 1 everywhere.
    """
    check_photograph(photo, path, display)
    suffix = Path(path).suffix.lower()
    alpha = photo.alpha
    if alpha is not None and suffix in _WITHOUT_ALPHA:
        if bool((alpha < 1).any()):
            warnings.warn(f"{path}: alpha is left out: {suffix} has none", stacklevel=2)
        alpha = None
    rgb = photo.linear[0].detach().cpu().float()
    if suffix == ".exr":
        shown = Display(0.0, colour_space=display.colour_space)
        _write_exr(shown.linear(rgb), alpha, path, display.chromaticities)
        return
    levels = {".jpg": 255, ".jpeg": 255, ".hdr": None}.get(suffix, photo.levels)
    if levels is None:
        rgb = rgb.clamp(min=0) if suffix == ".hdr" else rgb
    else:
        shown = replace(display, exposure=0.0, tone="srgb")
        rgb = shown.picture(rgb[None])[0] if coded == "srgb" else rgb.clamp(0, 1)
    pixels = _stored(rgb.movedim(0, -1), levels)
    cover = None if alpha is None else _stored(alpha[0, 0].detach().cpu(), levels)
    if caption and levels is not None:
        draw_caption(pixels, caption, cover)
    write_pixels(pixels, path, cover, profile=display.profile)


def _stored(values: Tensor, levels: int | None) -> NDArray[Any]:
    if levels is None:
        return np.ascontiguousarray(values.numpy(), np.float32)
    whole = np.uint8 if levels == 255 else np.uint16
    return np.ascontiguousarray(np.rint(values.numpy() * levels), whole)


def _raw_photograph(path: str | os.PathLike[str]) -> Photograph:
    """As whole numbers of 16 bits: 1 is where a colour is saturated, balanced."""
    raw = read_raw(path)
    rgb = raw_in_colour(raw, path)
    said = [] if raw.colour is None else [f"colours by {raw.colour.source}"]
    for note in (*said, *raw.notes):
        warnings.warn(f"{path}: {note}", stacklevel=3)
    return Photograph(_tensor(rgb), int(np.iinfo(np.uint16).max))


def _exr_photograph(path: str | os.PathLike[str]) -> Photograph:
    """With the alpha of the layer that the colours are in."""
    colour = read_colour(path)
    file = ExrFile(path)
    grey = [(part, name) for _, part, name in file.keys if name == "Y"]
    if colour is None and len(grey) == 1:
        colour = torch.nan_to_num(stacked(file, grey * 3, 0, file.size[0]), posinf=0, neginf=0)
    if colour is None:
        names = ", ".join(key for key, _, _ in file.keys)
        raise InputError(f"{path}: expected channels R, G, B, got {names}")
    matrix = exr_matrix(path)
    if matrix is not None:
        colour = torch.einsum("ij,bjhw->bihw", torch.from_numpy(matrix).float(), colour)
    part, name = (Layers.of(file, None).vector("colour") or grey)[0]
    key = (part, name[:-1] + ("A" if name[-1].isupper() else "a"))
    if key not in {(part, channel) for _, part, channel in file.keys}:
        return Photograph(colour, None)
    alpha = torch.nan_to_num(stacked(file, (key,), 0, file.size[0]), nan=0.0).clamp(0, 1)
    return Photograph(colour / _divisor(alpha), None, alpha)


def _write_exr(
    rgb: Tensor,
    alpha: Tensor | None,
    path: str | os.PathLike[str],
    chromaticities: tuple[float, ...] | None,
) -> None:
    channels = dict(zip("RGB", (rgb if alpha is None else rgb * _divisor(alpha[0])), strict=True))
    if alpha is not None:
        channels["A"] = alpha[0, 0]
    arrays = {name: m.detach().cpu().numpy() for name, m in channels.items()}
    write_channels(path, arrays, chromaticities=chromaticities)


def _divisor(alpha: Tensor) -> Tensor:
    """What an EXR's colours are multiplied by: alpha, but 1 where that is 0 (glowing pixels)."""
    return torch.where(alpha > OPAQUE_ENOUGH, alpha, torch.ones_like(alpha))


def _warn_of_gamut(path: str | os.PathLike[str], rgb: NDArray[np.float32]) -> None:
    outside = float((rgb.min(axis=2) < -_BEYOND_SRGB).mean())
    if outside > 0:
        warnings.warn(
            f"{path}: {100 * outside:.2g} % of its pixels are outside sRGB: 8- or 16-bit pictures "
            "clip them, an EXR keeps them",
            stacklevel=3,
        )


def _finite(values: NDArray[Any]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        return np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0)


def read_normal_map(
    path: str | os.PathLike[str], green: Green = "opengl", **reading: Any
) -> Tensor:
    """Read a normal map, x right, y up, z to the viewer.

    Whole-number files hold (n + 1)/2; float files hold n itself, or (n + 1)/2 where nothing in them
    is negative. Black pixels, and pixels with alpha 0, have no normal.

    Args:
        green: "opengl" where green points up, "directx" where it points down.
        reading: attributes of `GBufferReading`: `xyz`, and what an EXR with other layers needs, as
            `fov_deg` and `depth` where it holds depth instead of normals.

    Returns:
        `[1, 3, H, W]` unit normals, zero where there is none.

    Raises:
        InputError: not an image of three channels.

    Warns:
        UserWarning: a JPEG, whose blocks tilt the normals; a map that by its lengths, directions or
            slopes is stored otherwise (see `normal_check`).
    """
    axes = NormalAxes.of(GBufferReading(**reading).xyz, green)
    if Path(path).suffix.lower() == ".exr":
        normal = masked_normals(read_gbuffer(path, **{**reading, "xyz": str(axes)}))
    else:
        pixels = read_pixels(path, colour=False)
        if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
            raise InputError(
                f"{path}: expected a normal map of three channels, got an image of shape "
                f"{list(pixels.shape)}"
            )
        if Path(path).suffix.lower() in (".jpg", ".jpeg"):
            warnings.warn(
                f"{path}: an 8-bit JPEG holds normals badly (its blocks tilt them by degrees); "
                "a 16-bit PNG or an EXR holds them well",
                stacklevel=2,
            )
        coded, levels = _tensor(pixels[..., :3]), _levels(path, pixels)
        stored = decoded_normals(coded, levels)
        if pixels.shape[2] == 4:
            stored = stored * (_tensor(pixels[..., 3:]) > 0)
        is_coded = levels is not None or not bool((coded < 0).any())
        step = 2 / levels if levels else 1e-3
        warn_of_normals(path, stored, axes, is_coded=is_coded, step=step)
        normal = axes.of_map(stored)
    return normalised(normal)


def masked_normals(gbuffer: GBuffer) -> Tensor:
    """A G-buffer's normals, zero where its mask is."""
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


def _levels(path: str | os.PathLike[str], pixels: NDArray[Any]) -> int | None:
    if pixels.dtype.kind == "f":
        return None
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: expected 8 or 16 bits or floats, got {pixels.dtype}")
    return int(np.iinfo(pixels.dtype).max)


def _tensor(pixels: NDArray[Any]) -> Tensor:
    """`[H, W, C]` → `[1, C, H, W]` float32."""
    return torch.from_numpy(np.ascontiguousarray(pixels, np.float32)).movedim(-1, 0)[None]


def _check_suffix(path: str | os.PathLike[str], suffixes: tuple[str, ...], what: str) -> None:
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes:
        raise InputError(
            f"{path}: {what}: expected a file name that ends in {', '.join(suffixes)}, got "
            f"{suffix or '(none)'}"
        )
