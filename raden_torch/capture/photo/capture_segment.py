"""Photographs of an inlay → the map of its materials, as `raden capture segment` proposes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.photograph import check_same_size, read_linear, shown
from raden_torch.capture.photo.segmentation import Segmentation, segment
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.images.pixels import draw_caption, write_pixels


def capture_segment(
    photographs: Sequence[Path],
    output: Path,
    picture: Path,
    shells: int,
    *,
    smallest_px: int = 16,
    coded: Coding = "auto",
) -> str:
    """Write the map, 8-bit indices, and a picture that shows it beside the photographs.

    Args:
        photographs: from one place, under different lamps.
        output: a .png; 0 is the ground, as the first member of a palette.
        shells, smallest_px: as for `segment`.

    Returns:
        What was found, in words.

    Raises:
        InputError: as for `read_linear` and `segment`; the message names the file.
    """
    photos = [read_linear(path, coded=coded) for path in photographs]
    check_same_size(photos)
    colours = [_in_three(photo.linear) for photo in photos]
    found = segment(colours, shells, smallest_px=smallest_px)
    write_pixels(found.index, output)
    write_pixels(_picture(colours, found), picture)
    shares = ", ".join(
        f"{'ground' if k == 0 else k}: {100 * area / found.index.size:.1f} %"
        for k, area in enumerate(found.areas)
    )
    return f"{found.pieces} pieces of {shells} shells; {shares}"


def _in_three(linear: NDArray[Any]) -> Floats32:
    return np.asarray(np.broadcast_to(linear, (*linear.shape[:2], 3)), np.float32)


def _picture(photographs: Sequence[Floats32], found: Segmentation) -> NDArray[np.uint8]:
    """The mean photograph, and the same with each shell in a colour of its own."""
    import cv2

    seen = shown(np.mean(np.stack(photographs), axis=0))
    count = len(found.areas) - 1
    hues = np.zeros((1, count + 1, 3), np.uint8)
    hues[0, 1:] = [(180 * k / count, 200, 255) for k in range(count)]
    colours = cv2.cvtColor(hues, cv2.COLOR_HSV2RGB)[0]
    tinted = seen // 3 + (colours[found.index] // 3) * 2
    both = np.ascontiguousarray(np.concatenate([seen, tinted], axis=1), np.uint8)
    draw_caption(both, f"{found.pieces} pieces, {count} shells (proposed)")
    return both
