"""The lamp's mirror image in a chrome ball, to a fraction of a pixel."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.ball import Ball
from raden_torch.errors import InputError

_HALF = 0.5
_LARGEST = 0.05
"""Of the ball's area: a larger blob is a window or an over-exposed ball, not a lamp."""
_RIVAL = 0.5
_FOOT, _FLANK_PX = 0.05, 2
_OUTSTANDING = 4.0
"""How many times brighter than the ball around it the lamp's image has to be."""
_RIM = 0.985


@dataclass(frozen=True)
class Highlight:
    """The lamp's image: its centroid, and how many pixels are brighter than half of its peak."""

    x_px: float
    y_px: float
    area_px: int
    found_in: str


def find_highlight(
    linear: NDArray[Any], ball: Ball, *, name: str | os.PathLike[str] = "photograph"
) -> Highlight:
    """The centroid of the brightest blob on the ball and of its flanks.

    A blob is what exceeds half of the peak; the weights are what exceeds a twentieth of it, within
    two pixels.

    A lamp is brighter than white by far, so its image is clipped; clipped on all sides alike, its
    centroid stays where it is.

    Args:
        linear: `[H, W, C]` in linear light.

    Raises:
        InputError: nothing that stands out, two blobs alike, or one too large.
    """
    import cv2

    grey = np.asarray(linear, np.float64).mean(-1)
    inside = ball.inside(grey.shape, _RIM)
    if not inside.any():
        raise InputError(f"{name}: the ball lies outside the photograph; the mask of another one?")
    on_ball = np.where(inside, grey, 0.0)
    peak, ground = float(on_ball.max()), float(np.median(grey[inside]))
    if peak <= 0 or peak < _OUTSTANDING * ground:
        raise InputError(
            f"{name}: expected a chrome ball under one small lamp, exposed so that the ball is "
            f"dark, got no highlight on the ball (brightest {peak:.3g}, median {ground:.3g})"
        )
    limit = ground + _HALF * (peak - ground)
    above = (on_ball > limit).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(above, connectivity=8)
    excess = (on_ball - limit) * above
    weight = np.bincount(labels.ravel(), excess.ravel(), minlength=count)
    weight[0] = 0
    best = int(weight.argmax())
    area = int(stats[best, cv2.CC_STAT_AREA])
    if area > _LARGEST * float(inside.sum()):
        raise InputError(
            f"{name}: its highlight covers {100 * area / inside.sum():.0f} % of the ball; expose "
            "shorter, or use a smaller lamp"
        )
    others = np.delete(weight, best)
    if len(others) and others.max() > _RIVAL * weight[best]:
        raise InputError(
            f"{name}: expected one highlight on the ball, from one lamp, got two (cover windows "
            "and shiny things)"
        )
    # a small lamp's image is as wide as the lens is sharp: its flanks, below half of the peak, tell
    # where between the pixels it lies
    near = cv2.dilate((labels == best).astype(np.uint8), np.ones((2 * _FLANK_PX + 1,) * 2)) > 0
    foot = ground + _FOOT * (peak - ground)
    chosen = np.where(near, np.clip(on_ball - foot, 0, None), 0.0)
    y, x = np.mgrid[: grey.shape[0], : grey.shape[1]]
    total = chosen.sum()
    return Highlight(
        float((chosen * x).sum() / total), float((chosen * y).sum() / total), area, str(name)
    )
