"""Files of one view → one photograph in linear light: stacks, dark frames, a flat field."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from raden_torch.capture.photo.camera_response import recover_response
from raden_torch.capture.photo.dark_and_flat import flat_field, flatten, subtract_dark
from raden_torch.capture.photo.exposures import Radiance, merge_exposures
from raden_torch.capture.photo.photograph import Photograph, check_same_size, read_linear
from raden_torch.capture.photo.stored_photograph import Coding, read_photograph
from raden_torch.errors import InputError

PathLike = str | os.PathLike[str]
_OVER = 0.5


@dataclass(frozen=True)
class Development:
    """How a step reads its photographs.

    Attributes:
        coded: what the stored values mean: "auto", "srgb", "linear", or a response, as for
            `read_linear`.
        pattern: of a Bayer mosaic: "RGGB", "BGGR", "GRBG" or "GBRG"; "none" for a grey picture;
            None: by its CFA tag.
        white_level: the stored value at which the sensor saturates, 2…255 or 2…65535; None: by its
            tags, or the largest that fits.
        exposures_s: exposure times in seconds, above 0, one for each photograph; empty: as EXIF
            says.
        darks: frames taken with the lens covered.
        dark_exposures_s: seconds, one for each dark frame; empty: as EXIF says.
        flat: a frame of an evenly lit white sheet.
        orientation: EXIF's, 1…8, by which all are turned; None: as `frame_orientation` says.
        frame_orientation: EXIF's, 1…8, by which those are turned whose files state one, others
            stay as they are; None: the photographs as their own files say, dark frames and the
            flat as the first photograph's file does.
        response: recover the response from the photographs, which are an exposure stack of 8 bits.
    """

    coded: Coding = "auto"
    pattern: str | None = None
    white_level: float | None = None
    exposures_s: tuple[float, ...] = ()
    darks: tuple[Path, ...] = ()
    dark_exposures_s: tuple[float, ...] = ()
    flat: Path | None = None
    orientation: int | None = None
    frame_orientation: int | None = None
    response: bool = False


def developed(
    paths: Sequence[PathLike], how: Development | None = None
) -> tuple[Photograph, Radiance | None]:
    """One photograph in linear light; several as an exposure stack, merged.

    Dark frames are subtracted and the flat field divided by. A merged stack has the unit white
    levels per second; pixels saturated in every exposure are marked.

    Raises:
        InputError: whatever reading, correcting and merging raise; over-exposed all over.
    """
    how = how or Development()
    times = _times(paths, how.exposures_s, "photographs")
    if how.response:
        how = replace(how, coded=recover_response(paths, _stated(paths, times)), response=False)
    photos = [_read(path, how, t) for path, t in zip(paths, times, strict=True)]
    check_same_size(photos)
    how = replace(how, frame_orientation=photos[0].settings.orientation)
    dark_times = _times(how.darks, how.dark_exposures_s, "dark frames")
    darks = [_read(path, how, t) for path, t in zip(how.darks, dark_times, strict=True)]
    if darks:
        photos = [subtract_dark(photo, darks) for photo in photos]
    if how.flat is not None:
        flat = _read(how.flat, how, None)
        matching = [dark for dark in darks if dark.exposure_s in (None, flat.exposure_s)]
        share = flat_field(subtract_dark(flat, matching) if matching else flat)
        photos = [flatten(photo, share) for photo in photos]
    if len(photos) > 1:
        merged = merge_exposures(photos)
        return (
            replace(
                photos[0],
                linear=merged.radiance,
                saturated=~merged.valid,
                rounding=np.where(np.isfinite(merged.sigma), merged.sigma, 0),
                bits=None,
                exposure_s=None,
            ),
            merged,
        )
    if photos[0].saturated.mean() > _OVER:
        raise InputError(
            f"{photos[0].path}: over-exposed, {100 * photos[0].saturated.mean():.0f} % of it is "
            "saturated; expose less"
        )
    return photos[0], None


def _read(path: PathLike, how: Development, exposure_s: float | None) -> Photograph:
    photo = read_linear(
        path,
        coded=how.coded,
        pattern=how.pattern,
        white_level=how.white_level,
        exposure_s=exposure_s,
    )
    if how.orientation is not None:
        return photo.turned_to(how.orientation)
    return photo.in_frame(how.frame_orientation)


def _times(paths: Sequence[PathLike], stated: Sequence[float], what: str) -> Sequence[float | None]:
    if stated and len(stated) != len(paths):
        raise InputError(
            f"exposure times: expected none, or one for each of {len(paths)} {what}, got "
            f"{len(stated)}"
        )
    return stated or [None] * len(paths)


def _stated(paths: Sequence[PathLike], times: Sequence[float | None]) -> list[float]:
    found = []
    for path, stated in zip(paths, times, strict=True):
        seconds = stated
        if seconds is None:
            seconds = read_photograph(Path(path)).settings.exposure_s
        if seconds is None:
            raise InputError(f"{path}: no exposure time in its EXIF; state it for each photograph")
        found.append(seconds)
    return found
