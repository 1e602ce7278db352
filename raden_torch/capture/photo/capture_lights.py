"""Photographs of chrome balls and of a matt reference → lamps: what `raden capture lights` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.ball import Ball, ball_from_mask, find_ball
from raden_torch.capture.photo.camera import read_camera
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
from raden_torch.capture.photo.photometric_stereo import MIN_LAMPS, check_lights
from raden_torch.capture.photo.reference import (
    fit_response,
    relative_intensities,
    sphere_normals,
)
from raden_torch.errors import InputError
from raden_torch.files import is_same_file

_LIKELY = (0.7, 1.45)
"""Exponents of a response that a camera may have; sRGB taken as linear has about 2.2, linear taken
as sRGB 0.5."""
_DIM = 0.02
"""A channel darker than this share of the brightest says nothing of the lamps' colour."""


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
    photos = read_set(photographs, coded=coded, progress=lambda share: done(0.5 * share))
    lens = _Lens.of(camera, ball_radius_mm, photos.size)
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
    lamps = replace(lamps, distortion=lens.distortion)
    check_lights(torch.from_numpy(lamps.direction), f"{photographs[0]} … {photographs[-1]}")
    _warn_of_twins(lamps)
    done(0.6)
    if reference is not None:
        lamps = _with_reference(
            lamps, reference, lens, coded, lambda share: done(0.6 + 0.4 * share)
        )
    done(1.0)
    return FoundLamps(lamps, balls, seen, lens.straightened(photos, linear))


@dataclass(frozen=True, eq=False)
class _Lens:
    """The camera, if there is one: its matrix, and pictures without its distortion."""

    matrix: Floats | None = None
    distortion: Floats | None = None
    radius_mm: float = 1.0

    @classmethod
    def of(cls, path: Path | None, radius_mm: float | None, size: tuple[int, int]) -> _Lens:
        if path is None:
            if radius_mm is not None:
                raise InputError("the ball's radius is of use with a camera only; give its file")
            return cls()
        if radius_mm is None or not 0 < radius_mm < np.inf:
            raise InputError(f"{path}: with a camera the ball's radius in mm is needed, above 0")
        camera = read_camera(path)
        if camera.size != size:
            (h, w), (height, width) = camera.size, size
            raise InputError(
                f"{path}: expected the camera that took the photographs, at their size of {width} "
                f"x {height} pixels, got one of {w} x {h}"
            )
        return cls(camera.matrix, camera.distortion, radius_mm)

    def straight(self, image: NDArray[Any]) -> NDArray[Any]:
        import cv2

        if self.matrix is None or self.distortion is None:
            return image
        return cv2.undistort(image, self.matrix, self.distortion)

    def straightened(self, photos: PhotoSet, linear: list[NDArray[Any]]) -> PhotoSet:
        if self.matrix is None:
            return photos
        return replace(photos, images=torch.from_numpy(np.stack(linear)).movedim(-1, 1))


def _with_reference(
    lamps: Lamps,
    reference: Reference,
    lens: _Lens,
    coded: Coding,
    done: Callable[[float], None],
) -> Lamps:
    named = numbered_files(reference.pattern)
    paths = [path for path in named if not is_same_file(path, reference.mask)]
    if len(paths) != len(lamps):
        raise InputError(
            f"{reference.pattern}: expected one photograph of the reference per lamp, got "
            f"{len(paths)} for {len(lamps)} lamps"
        )
    photos = read_set(paths, coded=coded, progress=lambda share: done(0.5 * share))
    mask = read_mask(reference.mask, photos.size)
    check_exposure(photos, torch.from_numpy(mask)[None, None])
    photos = lens.straightened(
        photos, [lens.straight(i.movedim(0, -1).numpy()) for i in photos.images]
    )
    if reference.shape == "sphere":
        # of any radius: the normals that a pixel sees do not depend on it
        ball = ball_from_mask(lens.straight(mask), matrix=lens.matrix, name=reference.mask)
        normal, inside = sphere_normals(ball, photos.size)
    else:
        if reference.fit_response:
            raise InputError("the response needs a reference sphere: a card shows one normal only")
        normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        inside = torch.from_numpy(mask > 0.5)[None, None]
    lights = torch.from_numpy(lamps.direction).float()
    exponent = 1.0
    notes = list(lamps.notes)
    if reference.shape == "sphere":
        fit = fit_response(photos.images, lights, normal, inside, saturated=photos.saturated)
        if reference.fit_response:
            exponent = fit.exponent
            notes.append(str(fit))
        elif not _LIKELY[0] < fit.exponent < _LIKELY[1]:
            warnings.warn(
                f"{paths[0]}: with {fit}; this is not linear light: set `coded` to linear or srgb, "
                "whichever was not given, or `fit_response`",
                stacklevel=3,
            )
    done(0.9)

    def brightness(images: torch.Tensor) -> NDArray[Any]:
        found = relative_intensities(
            images, lights, normal, inside, saturated=photos.saturated, exponent=exponent
        )
        return found.double().numpy()

    intensity = brightness(photos.images)
    colour = photos.images[:, :, inside[0, 0]].mean(dim=(0, 2))
    tint = None
    if bool((colour > _DIM * colour.max()).all()):
        each = [brightness(photos.images[:, c : c + 1]) for c in range(3)]
        tint = np.stack(each, 1) / intensity[:, None]
    return replace(
        lamps,
        intensity=intensity,
        tint=tint,
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
