"""Raw Bayer mosaics: is this one, which patterns are possible, and its three colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.images.pixels import oriented
from raden_torch.packages import require

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""The colour of the pixels (0, 0), (0, 1), (1, 0), (1, 1): row by row from the upper left."""


def colour_masks(pattern: str, height: int, width: int) -> dict[str, NDArray[np.bool_]]:
    """`{"R": [H, W], "G": …, "B": …}`, true where the mosaic holds that colour."""
    phase = 2 * (np.arange(height)[:, None] % 2) + np.arange(width)[None] % 2
    cells = np.array(list(pattern))[phase]
    return {colour: cells == colour for colour in "RGB"}


def turned_cells(cells: NDArray[Any], orientation: int, size: tuple[int, int]) -> NDArray[Any]:
    """`[2, 2]` at the upper left of a mosaic that is turned as EXIF's orientation says.

    Args:
        cells: `[2, 2]`, what repeats in the mosaic as it is stored.
        size: its height and width as it is stored.
    """
    rows, columns = np.ogrid[: 2 + size[0] % 2, : 2 + size[1] % 2]
    return oriented(cells[rows % 2, columns % 2], orientation)[:2, :2]


def demosaiced(mosaic: NDArray[Any], pattern: str) -> NDArray[np.float32]:
    """`[H, W]` → `[H, W, 3]` by bilinear interpolation of each colour's own pixels.

    Linear in the values, unlike edge-directed methods: dark frames, flat fields and exposures may
    be combined before or after. Written as a normalised convolution, so that borders need no rule.
    """
    require("mosaics", "images")
    import cv2

    tent = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4  # green lies on diagonals
    planes = []
    for colour, mask in colour_masks(pattern, *mosaic.shape).items():
        there = mask.astype(np.float32)
        kernel = cross if colour == "G" else tent
        both = (
            cv2.filter2D(plane, -1, kernel, borderType=cv2.BORDER_CONSTANT)
            for plane in (mosaic.astype(np.float32) * there, there)
        )
        planes.append(np.divide(*both))
    return np.stack(planes, -1)


def looks_like_mosaic(pixels: NDArray[Any]) -> bool:
    """Whether neighbours differ more than pixels two apart: the mark of a mosaic.

    In a grey photograph it is the other way round; in noise alone they are equal.
    """
    values = pixels.astype(np.float32)
    if min(values.shape) < 8:
        return False
    near = np.abs(values[:, 1:-1] - values[:, :-2]).mean()
    far = np.abs(values[:, 2:] - values[:, :-2]).mean()
    return bool(near > 1.15 * far)


def possible_patterns(mosaic: NDArray[Any]) -> tuple[str, str]:
    """The two patterns that the mosaic can have, by where its green pixels are: on the diagonal
    whose two phases agree. Red and blue look alike without a known colour in the scene."""
    height, width = (n // 2 * 2 for n in mosaic.shape)
    p = mosaic[:height, :width].astype(np.float32)
    a, b, c, d = p[::2, ::2], p[::2, 1::2], p[1::2, ::2], p[1::2, 1::2]
    main, other = (np.abs(x - y).sum() / max((x + y).sum(), 1e-9) for x, y in ((a, d), (b, c)))
    return ("RGGB", "BGGR") if other < main else ("GRBG", "GBRG")
