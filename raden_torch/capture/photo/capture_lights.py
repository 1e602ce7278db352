"""Photographs of chrome balls and of a matt reference → lamps: what `raden capture lights` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from raden_torch.capture.photo.ball import Ball, ball_from_mask, find_ball
from raden_torch.capture.photo.highlight import Highlight, find_highlight
from raden_torch.capture.photo.lamps import Lamps, lamps_from_balls
from raden_torch.capture.photo.photo_set import (
    PhotoSet,
    check_exposure,
    numbered_files,
    read_mask,
    read_set,
)
from raden_torch.capture.photo.photograph import Coding
from raden_torch.capture.photo.photometric_stereo import check_lights
from raden_torch.capture.photo.reference import (
    fit_response,
    relative_intensities,
    sphere_normals,
)
from raden_torch.errors import InputError


@dataclass(frozen=True)
class Reference:
    """A matt grey object of known shape under the same lamps.

    Attributes:
        pattern: its photographs, as "grey.*.png", one a lamp, numbered in the lamps' order.
        mask: white on it.
        shape: "sphere", or "card", which faces the camera.
        fit_response: also fit the exponent of the response; on a sphere only.
    """

    pattern: str
    mask: Path
    shape: Literal["sphere", "card"] | str = "sphere"
    fit_response: bool = False


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
    focal_px: float | None = None,
    ball_radius: float = 1.0,
    reference: Reference | None = None,
    coded: Coding = "auto",
    progress: Callable[[float], None] | None = None,
) -> FoundLamps:
    """Find each lamp's image in the balls, and from it the lamp.

    Args:
        masks: one a ball; where none, the ball is looked for in the photographs.
        focal_px: of a camera without distortion that looks through the picture's centre; None where
            it is far away.
        ball_radius: in mm, with a camera.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; the message names the file.
    """
    done = progress or (lambda share: None)
    photos = read_set(photographs, coded=coded, progress=lambda share: done(0.5 * share))
    matrix = None
    if focal_px is not None:
        if not (focal_px > 0 and ball_radius > 0):
            raise InputError("focal length and ball radius: positive numbers were wanted")
        height, width = photos.size
        matrix = np.array(
            [[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]]
        )
    linear = [image.movedim(0, -1).numpy() for image in photos.images]
    if masks:
        balls = [
            ball_from_mask(
                read_mask(path, photos.size), matrix=matrix, radius=ball_radius, name=path
            )
            for path in masks
        ]
    else:
        balls = [find_ball(linear, matrix=matrix, radius=ball_radius, name=photographs[0])]
    seen = [
        [find_highlight(image, ball, name=path) for ball in balls]
        for image, path in zip(linear, photos.paths, strict=True)
    ]
    lamps = lamps_from_balls(balls, seen, unit="px" if matrix is None else "mm")
    check_lights(torch.from_numpy(lamps.direction))
    _warn_of_twins(lamps)
    done(0.6)
    if reference is not None:
        lamps = _with_reference(lamps, reference, coded, lambda share: done(0.6 + 0.4 * share))
    done(1.0)
    return FoundLamps(lamps, balls, seen, photos)


def _with_reference(
    lamps: Lamps, reference: Reference, coded: Coding, done: Callable[[float], None]
) -> Lamps:
    paths = numbered_files(reference.pattern)
    if reference.mask in paths:
        paths.remove(reference.mask)
    if len(paths) != len(lamps):
        raise InputError(
            f"{reference.pattern}: {len(paths)} photographs of the reference, but {len(lamps)} "
            "lamps; one a lamp was wanted"
        )
    photos = read_set(paths, coded=coded, progress=lambda share: done(0.5 * share))
    mask = read_mask(reference.mask, photos.size)
    check_exposure(photos, torch.from_numpy(mask)[None, None])
    if reference.shape == "sphere":
        ball = ball_from_mask(mask, name=reference.mask)
        normal, inside = sphere_normals(ball, photos.size)
    else:
        if reference.fit_response:
            raise InputError("the response needs a reference sphere: a card shows one normal only")
        normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        inside = torch.from_numpy(mask > 0.5)[None, None]
    lights = torch.from_numpy(lamps.direction).float()
    exponent = 1.0
    notes = list(lamps.notes)
    if reference.fit_response:
        fit = fit_response(photos.images, lights, normal, inside, saturated=photos.saturated)
        exponent = fit.exponent
        notes.append(str(fit))
    done(0.9)
    intensity = relative_intensities(
        photos.images, lights, normal, inside, saturated=photos.saturated, exponent=exponent
    )
    return replace(
        lamps,
        intensity=intensity.double().numpy(),
        exponent=exponent,
        notes=tuple(notes),
    )


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
