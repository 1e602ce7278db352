"""Photographs by one camera that did not move, one a lamp, as a tensor; and a mask."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.capture.photo.photograph import Photograph, check_same_size, read_linear
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.errors import InputError
from raden_torch.images.mask import read_mask_pixels
from raden_torch.images.shot_settings import (
    ShotSettings,
    check_alike,
    relative_exposures,
)

MAX_VALUES = 2**31
"""The most values of a set that are read: 8 GiB."""

_RETAG = "give all one orientation (exiftool -n -Orientation={} FILES)"
_TOO_BRIGHT = 0.1
_USELESS = 0.8
_BLACK = 0.02


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """K photographs.

    Attributes:
        images: `[K, 3, H, W]` float32, linear light, at the first one's exposure.
        saturated: `[K, 1, H, W]` bool.
        paths: the files, in the order of the lamps.
        orientation: EXIF's, 1…8, by which they were turned; None where the first states none.
        stated: that of the first one's own file.
    """

    images: Tensor
    saturated: Tensor
    paths: tuple[Path, ...]
    orientation: int | None = None
    stated: int | None = None

    @property
    def size(self) -> tuple[int, int]:
        height, width = self.images.shape[2:]
        return height, width


def read_set(
    paths: Sequence[Path],
    *,
    coded: Coding = "auto",
    orientation: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> PhotoSet:
    """Read the photographs of a set; `coded` as for `read_linear`.

    Args:
        orientation: EXIF's, 1…8, by which those are turned whose files state one; None: as their
            own files say, which have to agree.

    Raises:
        InputError: as for `read_linear`; sizes, cameras, lenses, zoom or white balance that differ;
            or more than `MAX_VALUES` in all.

    Warns:
        UserWarning: photographs of other ISO, aperture or exposure time, which are scaled by it.
    """
    if not paths:
        raise InputError("photographs: expected one per lamp, got none")
    as_stated = read_linear(paths[0], coded=coded)
    first = as_stated.in_frame(orientation)
    height, width = first.size
    if 3 * height * width * len(paths) > MAX_VALUES:
        raise InputError(
            f"{paths[0]}: {len(paths)} photographs of {width} x {height} pixels do not fit into "
            "memory; give them cropped or smaller"
        )
    images = torch.empty(len(paths), 3, height, width)
    saturated = torch.empty(len(paths), 1, height, width, dtype=torch.bool)
    shots: list[tuple[Path, ShotSettings]] = []
    for k, path in enumerate(paths):
        photo = first if k == 0 else read_linear(path, coded=coded).in_frame(orientation)
        check_same_size([first, photo])
        if photo.bits != first.bits:
            raise InputError(
                f"{path}: expected photographs saved alike, got {_bits(photo)}, but {paths[0]} "
                f"has {_bits(first)} (16-bit data saved as 8-bit lose half of each value)"
            )
        shots.append((path, photo.settings))
        check_alike(shots)
        images[k] = torch.from_numpy(photo.linear).movedim(-1, 0)
        saturated[k, 0] = torch.from_numpy(photo.saturated)
        if progress is not None:
            progress((k + 1) / len(paths))
    brightness = relative_exposures(shots)
    if brightness is not None:
        images /= torch.tensor(brightness).view(-1, 1, 1, 1)
    turned, stated = first.settings.orientation, as_stated.settings.orientation
    return PhotoSet(images, saturated, tuple(paths), turned, stated)


def check_masks(photos: PhotoSet, masks: Sequence[str | os.PathLike[str]]) -> None:
    """Masks are painted over photographs as their own files turn them.

    Raises:
        InputError: a mask beside photographs that are read in another orientation.
    """
    wanted, own = photos.orientation, photos.stated
    if masks and own != wanted:
        advice = f"{_RETAG.format(wanted)}, and paint the mask over them"
        raise turned_mask(masks[0], wanted, photos.paths[0], own, advice)


def turned_mask(
    mask: str | os.PathLike[str], wanted: int | None, path: Path, own: int | None, advice: str
) -> InputError:
    """Of a mask beside a photograph that is read in the wanted orientation, not its file's own."""
    return InputError(
        f"{mask}: expected a mask beside photographs of the camera file's orientation, {wanted}, "
        f"got {path} of EXIF's orientation {own}; {advice}"
    )


def check_orientation(
    of: str | os.PathLike[str],
    orientation: int | None,
    lights: str | os.PathLike[str],
    theirs: int | None,
) -> None:
    """Lamps are as seen in the photographs that showed them.

    Args:
        of: a photograph, which is turned by `orientation`.
        theirs: EXIF's orientation by which the photographs were turned that gave the lamps.

    Raises:
        InputError: both are known, and differ.
    """
    if None not in (orientation, theirs) and orientation != theirs:
        raise InputError(
            f"{of}: orientation by EXIF: expected {theirs}, as the photographs were read that gave "
            f"{lights}, got {orientation}; a camera that looks down guesses how it is held: where "
            f"it was not turned, {_RETAG.format(theirs)}"
        )


def read_mask(path: str | os.PathLike[str], size: tuple[int, int]) -> NDArray[Any]:
    """`[H, W]` float32, 0…1, as `read_mask_pixels` does; some of it above one half.

    Raises:
        InputError: as for `read_mask_pixels`, and a mask that is nowhere above one half.
    """
    mask = read_mask_pixels(path, size)
    if not (mask > 0.5).any():
        raise InputError(
            f"{path}: expected a mask that is white on the object, got one that is nowhere above "
            "half grey"
        )
    return mask


def numbered_files(pattern: str) -> list[Path]:
    """The files of a pattern as "grey.*.png", by the numbers in their names (2 before 10)."""
    found = [Path(name) for name in glob.glob(pattern)]
    if not found:
        raise InputError(
            f"{pattern}: expected a pattern of files, in quotes, got one that fits no file"
        )
    return sorted(found, key=lambda p: [int(n) for n in re.findall(r"\d+", p.name)] or [0])


def _bits(photo: Photograph) -> str:
    return "floats" if photo.bits is None else f"{photo.bits} bits a value"


def check_exposure(photos: PhotoSet, mask: Tensor) -> None:
    """Raise InputError, naming the file, where photographs are over-exposed or black in the mask.

    Args:
        mask: `[1, 1, H, W]`.
    """
    inside = mask[0, 0] > 0.5
    clipped = photos.saturated[:, 0, inside]
    share = clipped.float().mean(dim=1)
    if float(share.max()) > _USELESS:
        worst = int(share.argmax())
        raise InputError(
            f"{photos.paths[worst]}: over-exposed: {100 * share[worst]:.0f} % of the object is "
            "saturated in it; expose shorter, or leave out this photograph and its lamp"
        )
    lost = float((clipped.sum(dim=0) > max(0, len(clipped) - 3)).float().mean())
    if lost > _TOO_BRIGHT:
        worst = int(share.argmax())
        raise InputError(
            f"{photos.paths[worst]}: over-exposed: {100 * share[worst]:.0f} % of "
            f"the object is saturated in it, and {100 * lost:.0f} % of the object in all but two "
            "photographs; expose shorter"
        )
    # a tenth of the object in light is enough to tell that the lamp was on
    brightness = photos.images[:, :, inside].mean(dim=1)
    level = brightness.kthvalue(max(1, int(0.9 * brightness.shape[1])), dim=1).values
    darkest = int(level.argmin())
    if float(level[darkest]) <= _BLACK * float(level.median()):
        raise InputError(
            f"{photos.paths[darkest]}: the object is black in it; was the lamp on? Leave out this "
            "photograph and its lamp, or take it again"
        )


def lamp_numbers(names: Sequence[str]) -> list[int] | None:
    """The last number in each name, or None where one has none or two have the same."""
    found = [re.findall(r"\d+", Path(name).stem) for name in names]
    if not all(found):
        return None
    last = [int(n[-1]) for n in found]
    return last if len(set(last)) == len(last) else None
