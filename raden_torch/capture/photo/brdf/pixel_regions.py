"""Which pixels lie inside a polygon, and which of them far enough from its edge."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Bools, Floats

MARGIN_PX = 2
"""Pixels so near to the edge of sample or white are left out: what lies behind shines into them."""
_SUBPIXEL_BITS = 4


def polygon_pixels(corners_px: Floats, size: tuple[int, int]) -> Bools:
    """`[H, W]`: the pixels inside corners `[n, 2]`; a whole coordinate is a pixel's centre."""
    import cv2

    drawn = np.zeros(size, np.uint8)
    fixed_point = np.rint(corners_px * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.fillPoly(drawn, [fixed_point], 1, shift=_SUBPIXEL_BITS)
    return np.asarray(drawn > 0)


def eroded(inside: Bools, margin_px: int = MARGIN_PX) -> Bools:
    """Without the pixels near its edge, or the frame's."""
    import cv2

    side = 2 * margin_px + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    kept = cv2.erode(inside.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(kept > 0)
