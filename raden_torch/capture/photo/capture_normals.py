"""Photographs of an object under known lamps → its normals: what `raden capture normals` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.capture.photo.lambert_fit import Method
from raden_torch.capture.photo.lamp_order import OrderCheck, check_order, under_lamps
from raden_torch.capture.photo.lamps import Lamps, read_lamps
from raden_torch.capture.photo.lights_check import check_lights
from raden_torch.capture.photo.photo_set import (
    PhotoSet,
    check_exposure,
    check_masks,
    check_orientation,
    lamp_numbers,
    read_mask,
    read_set,
)
from raden_torch.capture.photo.photometric_stereo import SurfaceNormals, solve_normals
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.errors import InputError

_ODD = 3.0
"""A lamp whose residual is this many times the median of all is named."""


@dataclass(frozen=True, eq=False)
class FoundNormals:
    """The surface, and what it was found with; `mask` is `[H, W]`, 0…1."""

    surface: SurfaceNormals
    lamps: Lamps
    mask: NDArray[Any]
    exponent: float
    order: OrderCheck | None
    notes: tuple[str, ...]


def capture_normals(
    photographs: Sequence[Path],
    lights: Path,
    mask: Path | None = None,
    *,
    method: Method = "robust",
    refine_intensity: bool = False,
    exponent: float | None = None,
    shadow: float = 0.1,
    plane_z: float = 0.0,
    keep_order: bool = False,
    coded: Coding = "auto",
    progress: Callable[[float], None] | None = None,
) -> FoundNormals:
    """Read photographs and lamps, check that they belong together, and solve.

    Args:
        lights: a lights file; photograph k was taken under its lamp k.
        exponent: of the response; None takes the lights file's.
        plane_z: of the object, for near lamps, which are taken to light a plane that faces the
            camera: in the frame and unit of the lamps' positions.
        keep_order: warn instead of raising where another order of the lamps fits clearly better.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for what it is made of; the message names the file.
    """
    done = progress or (lambda share: None)
    given = read_lit_set(
        photographs,
        lights,
        mask,
        exponent=exponent,
        plane_z=plane_z,
        coded=coded,
        progress=lambda share: done(0.4 * share),
    )
    order = _checked_order(given, keep_order)
    surface = solve_normals(
        given.photos.images,
        given.directions,
        given.mask_map,
        method=method,
        intensity=given.intensity,
        refine_intensity=refine_intensity,
        saturated=given.photos.saturated,
        shadow=shadow,
        exponent=given.exponent,
        progress=lambda share: done(0.4 + 0.6 * share),
    )
    notes = odd_lamps(surface.lamp_residual, photographs)
    for note in notes:
        warnings.warn(note, stacklevel=2)
    return FoundNormals(surface, given.lamps, given.mask, given.exponent, order, tuple(notes))


@dataclass(frozen=True, eq=False)
class LitSet:
    """Photographs and the lamps that they were taken under.

    Attributes:
        photos: as if all lamps had one colour.
        mask: `[H, W]`, 0…1.
        exponent: of the response, still to be applied.
        directions: `[K, 3]`, or `[K, 3, H, W]` for near lamps, whose length is the irradiance.
    """

    photos: PhotoSet
    lamps: Lamps
    mask: NDArray[Any]
    exponent: float
    directions: Tensor

    @property
    def mask_map(self) -> Tensor:
        """`[1, 1, H, W]`"""
        return torch.from_numpy(self.mask)[None, None]

    @property
    def intensity(self) -> Tensor:
        """`[K]`"""
        return torch.from_numpy(self.lamps.intensity).float()

    @cached_property
    def view(self) -> Tensor:
        """`[3, H·W]` unit vectors to the camera; `[3, 1]` where it is far away."""
        if self.lamps.matrix is None:
            return torch.tensor([[0.0], [0.0], [1.0]])
        through = torch.from_numpy(self.lamps.plane(self.photos.size, -1.0)).float().flatten(1)
        return -through / through.norm(dim=0)


def read_lit_set(
    photographs: Sequence[Path],
    lights: Path,
    mask: Path | None,
    *,
    exponent: float | None = None,
    plane_z: float = 0.0,
    coded: Coding = "auto",
    progress: Callable[[float], None] | None = None,
) -> LitSet:
    """Photographs, mask and lamps that belong together; arguments as for `capture_normals`.

    Photographs under lamps that moved count as saturated everywhere, so that nothing uses them.
    """
    lamps = _read_lamps(lights, photographs)
    # lamps with a camera are in the frame of its file, which says how photographs are turned
    way = None if lamps.matrix is None else lamps.orientation
    photos = read_set(photographs, coded=coded, orientation=way, progress=progress)
    check_masks(photos, [] if mask is None else [mask])
    check_orientation(photos.paths[0], photos.orientation, lights, lamps.orientation)
    inside = np.ones(photos.size, np.float32) if mask is None else read_mask(mask, photos.size)
    check_exposure(photos, torch.from_numpy(inside)[None, None])
    power = lamps.exponent if exponent is None else exponent
    if lamps.tint is not None:
        tint = torch.from_numpy(lamps.tint).float() ** (1 / power)
        photos.images.div_(tint[:, :, None, None])
    if lamps.moved is not None:
        photos.saturated[torch.from_numpy(lamps.moved)] = True
    return LitSet(photos, lamps, inside, power, _directions(lamps, photos.size, plane_z))


def _read_lamps(lights: Path, photographs: Sequence[Path]) -> Lamps:
    """One lamp a photograph, that together determine a normal."""
    lamps = read_lamps(lights)
    if len(lamps) != len(photographs):
        raise InputError(
            f"{lights}: expected one lamp per photograph, in their order, got {len(lamps)} lamps "
            f"for {len(photographs)} photographs"
        )
    used = slice(None) if lamps.moved is None else ~lamps.moved
    check_lights(torch.from_numpy(lamps.direction[used]), lights)
    _warn_of_names(photographs, lamps, lights)
    return lamps


def _directions(lamps: Lamps, size: tuple[int, int], plane_z: float) -> Tensor:
    """`[K, 3]`, or `[K, 3, H, W]` for near lamps over a plane that faces the camera."""
    if lamps.position is None:
        return torch.from_numpy(lamps.direction).float()
    return torch.from_numpy(lamps.towards(lamps.plane(size, plane_z))).float()


def _checked_order(given: LitSet, keep_order: bool) -> OrderCheck | None:
    photos = given.photos
    linear = photos.images.clamp(min=0).mean(dim=1, keepdim=True) ** given.exponent
    order = check_order(
        linear / given.intensity.view(-1, 1, 1, 1),
        torch.from_numpy(given.lamps.direction),
        given.mask_map,
    )
    if order is None or not order.uncertain:
        return order
    text = (
        f"the photographs seem to be in another order than the lamps: {100 * order.outside:.1f} % "
        f"of the light fits no surface, {100 * order.best:.1f} % with "
        f"{under_lamps(order.order, photos.paths)}"
    )
    if order.doubtful and not keep_order:
        raise InputError(f"{photos.paths[order.moved()[0]]}: {text}; give them in the lamps' order")
    warnings.warn(text, stacklevel=3)
    return order


def _warn_of_names(photographs: Sequence[Path], lamps: Lamps, lights: Path) -> None:
    """Numbers in the names that are in another order than those of the lamps' photographs."""
    own, theirs = lamp_numbers([p.name for p in photographs]), lamp_numbers(lamps.names)
    if own is None or theirs is None or own == theirs or set(own) != set(theirs):
        return
    k = next(k for k, (a, b) in enumerate(zip(own, theirs, strict=True)) if a != b)
    warnings.warn(
        f"{photographs[k]} is photograph {k + 1}, but lamp {k + 1} of {lights} was found in "
        f"{lamps.names[k]}; are the photographs in the lamps' order?",
        stacklevel=4,
    )


def odd_lamps(residual: Tensor, photographs: Sequence[Path]) -> list[str]:
    """A line a photograph that disagrees with the others, of residuals `[K]`."""
    usual = float(residual.nanmedian())
    return [
        f"{photographs[k].name}: it disagrees with the others {float(r) / usual:.1f} times as much "
        "as usual; did its lamp, the camera or the object move?"
        for k, r in enumerate(residual)
        if float(r) > max(_ODD * usual, 0.02)
    ]
