"""Photographs of chrome balls and of a matt reference → lamps: what `raden capture lights` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from raden_torch.capture.photo.ball import Ball, ball_from_mask, find_ball
from raden_torch.capture.photo.ball_lens import BallLens
from raden_torch.capture.photo.highlight import Highlight, find_highlight
from raden_torch.capture.photo.lamp_errors import direction_std_deg
from raden_torch.capture.photo.lamps import Lamps, lamps_from_balls
from raden_torch.capture.photo.lights_check import MIN_LAMPS, check_lights
from raden_torch.capture.photo.photo_set import (
    PhotoSet,
    check_masks,
    read_mask,
    read_set,
)
from raden_torch.capture.photo.reference_photos import Reference, lamps_by_reference
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class FoundLamps:
    """The lamps, and where they were seen: `highlights[k][b]` of lamp k in ball b."""

    lamps: Lamps
    balls: list[Ball]
    highlights: list[list[Highlight]]
    photos: PhotoSet


def capture_lights(
    photographs: Sequence[Path],
    masks: Sequence[Path] = (),
    *,
    camera: Path | None = None,
    ball_radius_mm: float | None = None,
    reference: Reference | None = None,
    coded: Coding = "auto",
    progress: Callable[[float], None] | None = None,
) -> FoundLamps:
    """Find each lamp's image in the balls, and from it the lamp.

    Args:
        masks: one a ball; where none, the ball is looked for in the photographs.
        camera: a camera file (`camera.read_camera`); None where the camera is far away.
        ball_radius_mm: with a camera; it gives positions their scale.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; the message names the file.
    """
    done = progress or (lambda share: None)
    if 0 < len(photographs) < MIN_LAMPS:
        raise InputError(
            f"{photographs[-1]}: expected at least {MIN_LAMPS} photographs of the ball, one per "
            f"lamp, got {len(photographs)}"
        )
    lens = BallLens.of(camera, ball_radius_mm)
    photos = read_set(
        photographs,
        coded=coded,
        orientation=lens.orientation,
        progress=lambda share: done(0.5 * share),
    )
    lens.check_size(camera, photos.size)
    check_masks(photos, masks)
    linear = [lens.straight(image.movedim(0, -1).numpy()) for image in photos.images]
    shape: dict[str, Any] = {"matrix": lens.matrix, "radius": lens.radius_mm}
    if masks:
        painted = [lens.straight(read_mask(path, photos.size)) for path in masks]
        balls = [
            ball_from_mask(mask, **shape, name=path)
            for mask, path in zip(painted, masks, strict=True)
        ]
    else:
        balls = [find_ball(linear, **shape, name=photographs[0])]
    seen = [
        [find_highlight(image, ball, name=path) for ball in balls]
        for image, path in zip(linear, photos.paths, strict=True)
    ]
    lamps = lamps_from_balls(balls, seen, unit="px" if camera is None else "mm")
    std_deg = direction_std_deg(lamps, balls, seen)
    way = photos.orientation if lens.orientation is None else lens.orientation
    lamps = replace(lamps, distortion=lens.distortion, std_deg=std_deg, orientation=way)
    check_lights(torch.from_numpy(lamps.direction), f"{photographs[0]} … {photographs[-1]}")
    _warn_of_twins(lamps)
    done(0.6)
    if reference is not None:
        lamps = lamps_by_reference(
            lamps, reference, lens, coded, lambda share: done(0.6 + 0.4 * share)
        )
    done(1.0)
    return FoundLamps(lamps, balls, seen, lens.straightened(photos, linear))


def _warn_of_twins(lamps: Lamps) -> None:
    """Two photographs of one lamp are rarely meant."""
    cosine = lamps.direction @ lamps.direction.T - 2 * np.eye(len(lamps))
    i, j = divmod(int(cosine.argmax()), len(lamps))
    if cosine[i, j] > np.cos(np.deg2rad(1.0)):
        warnings.warn(
            f"{lamps.names[i]} and {lamps.names[j]}: their lamps stand within a degree of each "
            "other; one photograph twice?",
            stacklevel=3,
        )
