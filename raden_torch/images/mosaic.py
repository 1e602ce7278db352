"""Raw Bayer mosaics: is this one, which patterns are possible, and its three colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.images.pixels import oriented
from raden_torch.packages import require

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""The colour of the pixels (0, 0), (0, 1), (1, 0), (1, 1): row by row from the upper left."""


def turned_cells(cells: NDArray[Any], orientation: int, size: tuple[int, int]) -> NDArray[Any]:
    """`[2, 2]` at the upper left of a mosaic that is turned as EXIF's orientation says.

    Args:
        cells: `[2, 2]`, what repeats in the mosaic as it is stored.
        size: its height and width as it is stored.
    """
    rows, columns = np.ogrid[: 2 + size[0] % 2, : 2 + size[1] % 2]
    return oriented(cells[rows % 2, columns % 2], orientation)[:2, :2]


def turned_pattern(pattern: str, orientation: int, size: tuple[int, int]) -> str:
    """The Bayer pattern of a mosaic that is turned, with the arguments of `turned_cells`."""
    cells = np.array(list(pattern)).reshape(2, 2)
    return "".join(turned_cells(cells, orientation, size).ravel())


def demosaiced(mosaic: NDArray[Any], pattern: str) -> NDArray[np.float32]:
    """`[H, W]` → `[H, W, 3]` by bilinear interpolation of each colour's own pixels.

    Linear in the values, unlike edge-directed methods: dark frames, flat fields and exposures may
    be combined before or after. Mirrored at its borders, a mosaic goes on in its own pattern.
    """
    require("mosaics", "images")
    import cv2

    tent = np.array([0.5, 1, 0.5], np.float32)
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4  # green lies on diagonals
    found = np.empty((*mosaic.shape, 3), np.float32)
    for number, colour in enumerate("RGB"):
        plane = np.zeros(mosaic.shape, np.float32)
        for cell in (k for k, name in enumerate(pattern) if name == colour):
            own = np.s_[cell // 2 :: 2, cell % 2 :: 2]
            plane[own] = mosaic[own]
        border = cv2.BORDER_REFLECT_101
        if colour == "G":
            plane = cv2.filter2D(plane, -1, cross, borderType=border)
        else:
            plane = cv2.sepFilter2D(plane, -1, tent, tent, borderType=border)
        found[..., number] = plane
    return found


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
