"""Into which bands of rows a G-buffer's file is cut, so that shading it fits the memory."""

from __future__ import annotations

from math import lcm

from raden_torch.errors import InputError
from raden_torch.images.exr import WRITTEN_LINES
from raden_torch.images.exr_file import ExrFile

BYTES_A_PIXEL, BYTES_A_CHANNEL, BYTES_GATHERED = 240, 10, 120
"""The most that reading, shading and writing some rows takes: that of the eager form. With the
fused kernel it is a third. What a palette gathers comes on top, once for each of its weights."""


def bands_of(file: ExrFile, memory: int | None, more: int) -> list[tuple[int, int]]:
    """(first row, row after the last) of each band.

    Args:
        memory: bytes that a band may take; None is one band.
        more: bytes a pixel than a model alone takes.

    Raises:
        InputError: the fewest rows that can be read at once need more memory, or the whole file is
            too large to be one band.
    """
    height, width = file.size
    a_row = width * (BYTES_A_PIXEL + more + BYTES_A_CHANNEL * len(file.keys))
    if memory is None:
        if not file.may_be_whole:
            raise InputError(
                f"{file.path}: expected a frame that can be read at once, got {width} x {height} "
                "pixels; `raden render` shades it in bands if it writes an .exr"
            )
        return [(0, height)]
    rows = min(memory // a_row, file.most_rows)
    if rows >= height:
        return [(0, height)]
    step = lcm(WRITTEN_LINES, file.chunk_rows)
    rows = rows // step * step
    if rows == 0:
        raise InputError(
            f"{file.path}: memory: expected at least {min(step, height) * a_row} bytes for "
            f"{min(step, height)} rows, the fewest that can be read at once, got {memory}"
        )
    return [(top, min(top + rows, height)) for top in range(0, height, rows)]
