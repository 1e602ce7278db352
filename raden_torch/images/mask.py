"""A mask as a file: how much of each pixel belongs to the object."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.images.pixels import read_pixels


def read_mask_pixels(
    path: str | os.PathLike[str], size: tuple[int, int] | None = None
) -> NDArray[Any]:
    """`[H, W]` float32, 0…1: a grey picture, the alpha of one that has it, or the brightest
    channel. Whole numbers none of which is above 1 are 0 and 1.

    Args:
        size: height and width of the photographs.

    Raises:
        InputError: not an image, all black, or of another size than the photographs.
    """
    pixels = read_pixels(path, colour=False)
    if pixels.ndim == 3:
        pixels = pixels[..., 3] if pixels.shape[2] == 4 else pixels.max(axis=2)
    top = 1.0 if pixels.dtype.kind == "f" or pixels.max() <= 1 else np.iinfo(pixels.dtype).max
    mask = np.clip(pixels.astype(np.float32) / top, 0, 1)
    if size is not None and mask.shape != size:
        (h, w), (height, width) = mask.shape, size
        raise InputError(
            f"{path}: {w} x {h} pixels, but the photographs have {width} x {height}; a mask of "
            "their size was wanted"
        )
    if not (mask > 0).any():
        raise InputError(f"{path}: the mask is empty (all black); white on the object was wanted")
    return mask
