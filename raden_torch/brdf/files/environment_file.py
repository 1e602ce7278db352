"""Environment maps as files: Radiance .hdr and OpenEXR, lat-long, linear."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch

from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.brdf.shading.environment import EnvironmentLight, check_map
from raden_torch.brdf.shading.triples import Colour
from raden_torch.errors import InputError
from raden_torch.images.colour_space import exr_matrix, in_srgb
from raden_torch.images.exr import list_channels, read_channels

SUFFIXES = (".hdr", ".exr")


def load_environment(
    path: str | os.PathLike[str], *, rotation_deg: float = 0.0, intensity: Colour = 1.0
) -> EnvironmentLight:
    """Read a lat-long map of light; other primaries (a file's PRIMARIES, chromaticities) become
    sRGB's, and what the conversion makes negative is 0.

    Args:
        path: an .hdr, or an .exr with channels R, G, B.
        rotation_deg, intensity: of the light.

    Raises:
        InputError: another suffix or shape, no R, G, B, or values that are NaN, infinite or
            negative.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"{path}: suffix: expected .hdr or .exr, which hold linear light, got "
            f"{suffix or '(none)'}"
        )
    if suffix == ".hdr":
        radiance = read_photograph(path).linear[0]
    else:
        names = list_channels(path)
        if not {"R", "G", "B"} <= set(names):
            raise InputError(f"{path}: expected channels R, G, B, got {', '.join(names)}")
        channels = read_channels(path)
        rgb = np.stack([channels[name] for name in "RGB"], axis=-1)
        check_map(str(path), torch.from_numpy(rgb).movedim(-1, 0))
        matrix = exr_matrix(path)
        radiance = torch.from_numpy(in_srgb(rgb, matrix)).movedim(-1, 0).contiguous()
        if matrix is not None:
            radiance = radiance.clamp(min=0)
    check_map(str(path), radiance)
    return EnvironmentLight(radiance, rotation_deg, intensity)
