"""Photographs of a matt reference under the lamps → their brightness, colour, and the response."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.capture.photo.ball import ball_from_mask
from raden_torch.capture.photo.ball_lens import BallLens
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.capture.photo.matt_reference import (
    ResponseFit,
    fit_response,
    relative_intensities,
    sphere_maps,
)
from raden_torch.capture.photo.photo_set import (
    PhotoSet,
    check_exposure,
    check_masks,
    check_orientation,
    numbered_files,
    read_mask,
    read_set,
)
from raden_torch.capture.photo.stored_photograph import Coding
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
        fit_response: also fit the exponent of the response, and find lamps that moved; on a sphere
            only.
    """

    pattern: str
    mask: Path
    shape: Literal["sphere", "card"] | str = "sphere"
    fit_response: bool = False


@dataclass(frozen=True, eq=False)
class _Matt:
    """A reference that was read: K photographs, `[1, 3, H, W]` its normals, `[1, 1, H, W]` where it
    is, `[1, 3, H, W]` directions to a camera that is not far away."""

    photos: PhotoSet
    normal: Tensor
    inside: Tensor
    view: Tensor | None = None

    def intensities(self, images: Tensor, lights: Tensor, exponent: float) -> NDArray[Any]:
        """`[K]` of these images of it, relative, under lamps `[K, 3]`."""
        found = relative_intensities(
            images,
            lights,
            self.normal,
            self.inside,
            saturated=self.photos.saturated,
            exponent=exponent,
        )
        return found.double().numpy()


def lamps_by_reference(
    lamps: Lamps, reference: Reference, lens: BallLens, coded: Coding, done: Callable[[float], None]
) -> Lamps:
    """The lamps with relative intensities, colours and the response's exponent.

    Args:
        done: called with the share that is done, 0…1.

    Raises:
        InputError: another number of photographs than of lamps; a response to be fitted on a card.

    Warns:
        UserWarning: a response that is not linear light's; with `fit_response`, a lamp that moved.
    """
    if reference.fit_response and reference.shape != "sphere":
        raise InputError("the response needs a reference sphere: a card shows one normal only")
    matt = _read(reference, lamps, lens, coded, lambda share: done(0.5 * share))
    lights = torch.from_numpy(lamps.direction).float()
    exponent, moved, notes = 1.0, None, lamps.notes
    if reference.shape == "sphere":
        fit = _response(matt, lights)
        if reference.fit_response:
            exponent = fit.exponent
            said = _moved(fit, lamps, matt.photos)
            moved = fit.body.moved if said else None
            notes = (*notes, str(fit), *said)
        else:
            _warn_of_response(fit, matt.photos)
    done(0.9)
    images = matt.photos.images
    intensity = matt.intensities(images, lights, exponent)
    colour = images[:, :, matt.inside[0, 0]].mean(dim=(0, 2))
    tint = None
    if bool((colour > _DIM * colour.max()).all()):
        each = [matt.intensities(images[:, c : c + 1], lights, exponent) for c in range(3)]
        tint = np.stack(each, 1) / intensity[:, None]
    return replace(
        lamps, intensity=intensity, tint=tint, exponent=exponent, notes=notes, moved=moved
    )


def _read(
    reference: Reference, lamps: Lamps, lens: BallLens, coded: Coding, done: Callable[[float], None]
) -> _Matt:
    named = numbered_files(reference.pattern)
    paths = [path for path in named if not is_same_file(path, reference.mask)]
    count = len(lamps)
    if len(paths) != count:
        raise InputError(
            f"{reference.pattern}: expected one photograph of the reference per lamp, got "
            f"{len(paths)} for {count} lamps"
        )
    photos = read_set(paths, coded=coded, orientation=lens.orientation, progress=done)
    check_masks(photos, [reference.mask])
    check_orientation(paths[0], photos.orientation, "the lamps", lamps.orientation)
    mask = read_mask(reference.mask, photos.size)
    check_exposure(photos, torch.from_numpy(mask)[None, None])
    photos = lens.straightened(
        photos, [lens.straight(i.movedim(0, -1).numpy()) for i in photos.images]
    )
    if reference.shape == "sphere":
        # of any radius: the normals that a pixel sees do not depend on it
        ball = ball_from_mask(lens.straight(mask), matrix=lens.matrix, name=reference.mask)
        normal, inside, view = sphere_maps(ball, photos.size)
        return _Matt(photos, normal, inside, None if lens.matrix is None else view)
    towards_camera = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    return _Matt(photos, towards_camera, torch.from_numpy(mask > 0.5)[None, None])


def _response(matt: _Matt, lights: Tensor) -> ResponseFit:
    photos = matt.photos
    return fit_response(
        photos.images,
        lights,
        matt.normal,
        matt.inside,
        view=matt.view,
        saturated=photos.saturated,
    )


def _moved(fit: ResponseFit, lamps: Lamps, photos: PhotoSet) -> list[str]:
    """A line for each lamp that moved, which is warned of, too."""
    usual = float(np.median(fit.body.residual[~fit.body.moved]))
    said = [
        f"{photos.paths[k].name}: it disagrees with the reference's shape "
        f"{fit.body.residual[k] / usual:.1f} times as much as usual: lamp {k + 1} stood elsewhere "
        f"than in {lamps.names[k]}; normals leave it out"
        for k in np.flatnonzero(fit.body.moved)
    ]
    for line in said:
        warnings.warn(line, stacklevel=4)
    return said


def _warn_of_response(fit: ResponseFit, photos: PhotoSet) -> None:
    """Of an unlikely one, which is not taken."""
    if not _LIKELY[0] < fit.exponent < _LIKELY[1]:
        warnings.warn(
            f"{photos.paths[0]}: with {fit}; this is not linear light: set `coded` to linear or "
            "srgb, whichever was not given, or `fit_response`",
            stacklevel=4,
        )
