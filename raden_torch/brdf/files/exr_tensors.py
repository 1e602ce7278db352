"""Channels of an OpenEXR file as tensors: vectors, and scene-linear colours."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.files.normal_coding import Evidence
from raden_torch.brdf.shading.depth import LARGEST_HALF
from raden_torch.brdf.shading.radiance_std import RadianceStd
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.exr_file import ExrFile, Key
from raden_torch.images.exr_layers import Layers


def read_colour(
    path: str | os.PathLike[str], *, channels: Mapping[str, str] | None = None
) -> Tensor | None:
    """`[1, 3, H, W]` scene-linear RGB of the file, or None where it holds none.

    As OpenEXR has it, multiplied by alpha. The bare R, G, B, or a layer in `NAMES`; values that are
    not finite become 0. Bare colours that are unit vectors are normals, not colours.

    Args:
        channels: as for `read_gbuffer`, `{"colour": "Layer"}`.
    """
    file = ExrFile(path, at_once=True)
    layers = Layers.of(file, channels)
    keys, bare, height = layers.vector("colour"), layers.bare_vector(), file.size[0]
    if keys is None:
        return None
    may_be_normals = "colour" not in layers.chosen and layers.vector("normal") is None
    if bare is not None and may_be_normals and evidence(file, bare, [(0, height)]).is_normals:
        return None
    colour = stacked(file, keys, 0, height)
    return torch.where(torch.isfinite(colour), colour, torch.zeros_like(colour))


def write_image(
    image: Tensor,
    path: str | os.PathLike[str],
    *,
    chromaticities: tuple[float, ...] | None = None,
) -> None:
    """Write scene-linear `[1, 3, H, W]` RGB as an EXR of half floats, cut off at ±65504.

    Args:
        chromaticities: x, y of the primaries and of white; None: sRGB's, which go unsaid.
    """
    if image.ndim != 4 or image.shape[:2] != (1, 3):
        raise InputError(f"{path}: image: expected shape [1, 3, H, W], got {list(image.shape)}")
    write_channels(path, in_halves(image), half=True, chromaticities=chromaticities)


def write_std(std: RadianceStd, path: str | os.PathLike[str]) -> None:
    """Write standard deviations `[1, 3, H, W]` as an EXR of 32-bit floats, in the image's unit: the
    layers `own` and `systematic`, of R, G and B each."""
    layers = {"own": std.own, "systematic": std.systematic}
    channels = {
        f"{name}.{channel}": plane.detach().float().cpu().numpy()
        for name, image in layers.items()
        for channel, plane in zip("RGB", image[0], strict=True)
    }
    write_channels(path, channels)


def in_halves(image: Tensor) -> dict[str, NDArray[np.float16]]:
    """`[1, 3, H, W]` → the channels R, G, B as half floats, cut off at ±65504."""
    rgb = image[0].detach().float().clamp(-LARGEST_HALF, LARGEST_HALF).half()
    return dict(zip("RGB", rgb.cpu().numpy(), strict=True))


def stacked(file: ExrFile, keys: Sequence[Key], top: int, bottom: int) -> Tensor:
    """`[1, C, rows, W]` of these channels."""
    maps = np.empty((len(keys), bottom - top, file.size[1]), np.float32)
    found = file.read(keys, top, bottom)
    for pixels, key in zip(maps, keys, strict=True):
        pixels[:] = found[key]
    return torch.from_numpy(maps)[None]


def evidence(file: ExrFile, keys: Sequence[Key], bands: Sequence[tuple[int, int]]) -> Evidence:
    """Of vectors in the file, over all its bands."""
    return sum((Evidence.of(stacked(file, keys, *band)) for band in bands), Evidence())
