"""A mask as a file: how much of each pixel belongs to the object."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.images.pixels import read_image

_OVERSHOOT = 0.01
"""By which a resampling filter may have left 0…1."""


def read_mask_pixels(
    path: str | os.PathLike[str], size: tuple[int, int] | None = None
) -> NDArray[Any]:
    """`[H, W]` float32, 0…1: a grey picture, alpha where there is one, or the brightest channel.

    An alpha that is opaque everywhere says nothing: the picture itself counts then. Whole numbers
    none of which is above 1 are 0 and 1. An EXR's mask is its channel A, Y or only one, or the
    brightest of its R, G and B.

    Args:
        size: height and width of the photographs.

    Raises:
        InputError: not an image, all black, of another size than the photographs, or of values that
            are not a mask's.
    """
    is_exr = Path(path).suffix.lower() == ".exr"
    values = _exr_mask(path) if is_exr else _stored_mask(path)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError(f"{path}: expected a mask from 0 to 1, got values that are not finite")
    darkest, brightest = float(values.min()), float(values.max())
    top = 1.0 if values.dtype.kind == "f" or brightest <= 1 else np.iinfo(values.dtype).max
    is_eight_in_sixteen = values.dtype == np.uint16 and 1 < brightest <= 255
    is_wide = values.dtype not in (np.uint8, np.uint16) and brightest > 1 + _OVERSHOOT
    if darkest < -_OVERSHOOT or is_eight_in_sixteen or is_wide:
        raise InputError(
            f"{path}: expected a mask of 0…1, of 8 bits (0…255) or of 16 bits (0…65535), got "
            f"{values.dtype} from {darkest:g} to {brightest:g}"
        )
    mask = np.clip(values.astype(np.float32) / np.float32(top), 0, 1)
    if size is not None and mask.shape != size:
        (h, w), (height, width) = mask.shape, size
        raise InputError(
            f"{path}: expected a mask of {width} x {height} pixels, the size of the photographs, "
            f"got {w} x {h}"
        )
    if not (mask > 0).any():
        raise InputError(
            f"{path}: expected a mask that is white on the object, got an empty one (all black)"
        )
    return mask


def _stored_mask(path: str | os.PathLike[str]) -> NDArray[Any]:
    image = read_image(path)
    alpha = image.alpha
    if alpha is not None and (alpha != (1 if alpha.dtype.kind == "f" else alpha.max())).any():
        return alpha
    return image.pixels if image.pixels.ndim == 2 else image.pixels.max(axis=2)


def _exr_mask(path: str | os.PathLike[str]) -> NDArray[Any]:
    from raden_torch.images.exr import read_channels

    channels = read_channels(path)
    for name in ("A", "Y", next(iter(channels)) if len(channels) == 1 else "Y"):
        if name in channels:
            return channels[name]
    if not {"R", "G", "B"} <= set(channels):
        raise InputError(
            f"{path}: expected a mask in A, Y or R, G and B, got {', '.join(channels)}"
        )
    return np.maximum.reduce([channels[name] for name in "RGB"])
