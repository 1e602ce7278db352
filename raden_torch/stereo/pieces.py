"""The pieces of an inlay in its photographs: by a map, or looked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.brdf.files.material_map import stored_indices
from raden_torch.capture.photo.capture_normals import LitSet
from raden_torch.capture.photo.segmentation import segment
from raden_torch.errors import InputError

_FEWEST_PX = 4
"""Of a piece, whatever is asked for."""


def pieces_of(
    given: LitSet, path: Path | None, shells: int, smallest_px: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Pieces numbered from 1 by falling area, `[H, W]`; and the shell of each, from 0: by
    the map, else by its colours.

    Args:
        path: the map of shells, from 1; where None, pieces are looked for.
        shells: how many there are.
        smallest_px: an area of fewer pixels is no piece, nor is one of fewer than 4.

    Raises:
        InputError: a map that does not fit, or no piece.
    """
    if path is None:
        photos = [p.movedim(0, -1).numpy() for p in given.photos.images]
        index = segment(photos, shells, smallest_px=smallest_px).index.astype(np.int64)
    else:
        index = _read_map(path, given.photos.size, shells)
    index = np.where(given.mask > 0.5, index, 0)
    fewest = max(smallest_px, _FEWEST_PX)
    pieces, shell_of = numbered(index, fewest)
    if not len(shell_of):
        raise InputError(
            f"{path or 'photographs'}: expected at least one piece of {fewest} pixels within the "
            "mask, got none"
        )
    return pieces, shell_of


def numbered(
    index: NDArray[np.int64], fewest: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """What hangs together and is of one shell, numbered from 1 by falling area; and the shell of
    each, from 0.

    Args:
        index: `[H, W]` shells from 1, 0 for the ground.
        fewest: pixels; a smaller area is none.
    """
    import cv2

    sizes: list[tuple[int, int, int]] = []
    labels = {}
    for value in range(1, int(index.max(initial=0)) + 1):
        count, labels[value], stats, _ = cv2.connectedComponentsWithStats(
            (index == value).astype(np.uint8), connectivity=4
        )
        areas = stats[:, cv2.CC_STAT_AREA]
        sizes += [(int(areas[k]), value, k) for k in range(1, count)]
    kept = sorted((s for s in sizes if s[0] >= fewest), reverse=True)
    numbers = {value: np.zeros(labelled.max() + 1, np.int32) for value, labelled in labels.items()}
    for number, (_, value, k) in enumerate(kept, 1):
        numbers[value][k] = number
    pieces = np.zeros(index.shape, np.int32)
    for value, labelled in labels.items():
        pieces += numbers[value][labelled]
    return pieces, np.array([value - 1 for _, value, _ in kept], np.int64)


def shells_of(path: Path) -> int:
    """How many shells a map tells apart.

    Raises:
        InputError: none.
    """
    highest = int(stored_indices(path).max())
    if highest == 0:
        raise InputError(f"{path}: expected indices from 1 where there is shell, got 0 everywhere")
    return highest


def _read_map(path: Path, size: tuple[int, int], shells: int) -> NDArray[np.int64]:
    pixels = stored_indices(path).numpy()
    if pixels.shape != size:
        raise InputError(
            f"{path}: expected the photographs' {size[1]} x {size[0]} pixels, got "
            f"{pixels.shape[1]} x {pixels.shape[0]}"
        )
    if int(pixels.max()) > shells:
        raise InputError(
            f"{path}: expected indices 0…{shells}, 0 for the ground and one a shell, got "
            f"{int(pixels.max())}"
        )
    return pixels.astype(np.int64)
