"""Which pixels of a photographed inlay are lacquer, and which shell of several the others are.

Shell is brighter or more colourful than urushi in most of several photographs under different
lamps, a lamp's mirror image in the urushi only in one. What hangs together is a piece of one shell:
a piece's colours over all photographs, as a histogram of a* and b*, tell which, where the colour of
a single pixel, which changes with angle and place, would not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.errors import InputError

_WHITE_SHARE = 99.5
"""The percentile of each photograph's luminance that is shown as white."""
_BINS, _WIDEST = 16, 60.0
"""Of a* and b*, each from -60 to 60."""
_COPIES = 12
"""A large piece counts as so many of the median's size, at most."""


@dataclass(frozen=True)
class Segmentation:
    """What was found.

    Attributes:
        index: `[H, W]`, 0 for the ground, 1…K for the shells, by falling area.
        pieces: how many hang together by themselves.
        areas: pixels of each index.
    """

    index: NDArray[np.uint8]
    pieces: int
    areas: tuple[int, ...]


def segment(photographs: Sequence[Floats32], shells: int, *, smallest_px: int = 16) -> Segmentation:
    """Propose the map of an inlay's materials.

    Args:
        photographs: `[H, W, 3]` linear RGB each, from one place under different lamps; one will do.
        shells: how many different ones there are beside the ground.
        smallest_px: an area below this is no piece.

    Raises:
        InputError: no photograph, photographs of different sizes, not 1…254 shells, or fewer pieces
            than shells.
    """
    import cv2

    _check(photographs, shells, smallest_px)
    labs = [_lab(photograph) for photograph in photographs]
    inside = _pieces_from_ground(labs)
    count, pieces, about, _ = cv2.connectedComponentsWithStats(inside, connectivity=4)
    areas = about[:, cv2.CC_STAT_AREA]
    kept = [k for k in range(1, count) if areas[k] >= smallest_px]
    if len(kept) < shells:
        raise InputError(
            f"photographs: expected at least {shells} pieces of {smallest_px} pixels or more, got "
            f"{len(kept)}; brighter lamps, or `smallest_px`, may show more"
        )
    features = _histograms(labs, pieces, count)[kept]
    groups = _grouped(features, areas[kept], shells)
    of_piece = np.zeros(count, np.uint8)
    of_piece[kept] = _by_area(groups, areas[kept], shells)
    index = of_piece[pieces]
    found = np.bincount(index.ravel(), minlength=shells + 1)
    return Segmentation(index, len(kept), tuple(int(area) for area in found))


def _check(photographs: Sequence[Floats32], shells: int, smallest_px: int) -> None:
    if not photographs:
        raise InputError("photographs: expected at least one, got none")
    if not 1 <= shells <= 254:
        raise InputError(f"shells: expected 1…254 beside the ground, got {shells}")
    if smallest_px < 1:
        raise InputError(f"smallest_px: expected at least 1, got {smallest_px}")
    sizes = {photograph.shape[:2] for photograph in photographs}
    if len(sizes) > 1:
        (h, w), (other_h, other_w) = sorted(sizes)[:2]
        raise InputError(
            f"photographs: expected one size, got {w} x {h} and {other_w} x {other_h} pixels"
        )


def _lab(photograph: Floats32) -> Floats32:
    """`[H, W, 3]` CIELAB, exposed for the photograph's bright parts."""
    import cv2

    white = max(float(np.percentile(photograph[..., 1], _WHITE_SHARE)), 1e-9)
    shown = np.clip(photograph / white, 0, 1).astype(np.float32)
    return np.asarray(cv2.cvtColor(shown, cv2.COLOR_LRGB2Lab), np.float32)


def _pieces_from_ground(labs: Sequence[Floats32]) -> NDArray[np.uint8]:
    """1 where there is shell: by Otsu's threshold on lightness and chroma, median photograph."""
    import cv2

    each = [lab[..., 0] + np.hypot(lab[..., 1], lab[..., 2]) for lab in labs]
    median = np.median(np.stack(each), axis=0)
    scaled = np.clip(np.rint(median * (255 / max(float(median.max()), 1e-9))), 0, 255)
    _, inside = cv2.threshold(scaled.astype(np.uint8), 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return np.asarray(inside, np.uint8)


def _histograms(labs: Sequence[Floats32], pieces: NDArray[np.int32], count: int) -> Floats32:
    """`[pieces, photographs · bins]`: roots of each piece's histogram of a* and b*.

    The distance between two of them is Hellinger's.
    """
    import cv2

    made = []
    sizes = np.maximum(np.bincount(pieces.ravel(), minlength=count), 1)[:, None]
    for lab in labs:
        a, b = (
            np.clip((lab[..., k] + _WIDEST) / (2 * _WIDEST) * _BINS, 0, _BINS - 1).astype(np.int64)
            for k in (1, 2)
        )
        place = (pieces.astype(np.int64) * _BINS + a) * _BINS + b
        cells = np.bincount(place.ravel(), minlength=count * _BINS**2).reshape(count, _BINS, _BINS)
        smooth = np.stack([cv2.GaussianBlur(c, (0, 0), 1.0) for c in cells.astype(np.float32)])
        made.append(np.sqrt(np.maximum(smooth.reshape(count, -1), 0) / sizes))
    return np.concatenate(made, 1).astype(np.float32)


def _grouped(features: Floats32, areas: NDArray[np.int32], shells: int) -> NDArray[np.int32]:
    """Which of so many groups each piece is of, by k-means; larger pieces count more."""
    import cv2

    copies = np.clip(np.rint(areas / np.median(areas)), 1, _COPIES).astype(int)
    samples = np.repeat(np.arange(len(areas)), copies)
    cv2.setRNGSeed(0)
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    _, labels, _ = cv2.kmeans(
        np.ascontiguousarray(features[samples]), shells, None, end, 20, cv2.KMEANS_PP_CENTERS
    )
    first = np.concatenate([[0], np.cumsum(copies)[:-1]])
    return np.asarray(labels[first, 0], np.int32)


def _by_area(groups: NDArray[np.int32], areas: NDArray[np.int32], shells: int) -> NDArray[np.uint8]:
    """The groups numbered from 1, the largest first."""
    sizes = np.bincount(groups, weights=areas, minlength=shells)
    rank = np.empty(shells, np.uint8)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(1, shells + 1)
    return rank[groups]
