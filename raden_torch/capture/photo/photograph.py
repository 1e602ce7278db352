"""Photograph files → linear light, what is saturated, and what the file says of the exposure."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.stored_photograph import (
    Coding,
    bayer_pattern,
    exr_colour,
    read_photograph,
)
from raden_torch.capture.photo.stored_values import LinearValues, linear_values
from raden_torch.errors import InputError
from raden_torch.images.colour_space import SRGB_SPACE, in_srgb
from raden_torch.images.header import read_header
from raden_torch.images.mosaic import demosaiced
from raden_torch.images.other_formats import other_format
from raden_torch.images.pixels import read_image, turned_to
from raden_torch.images.raw import is_raw
from raden_torch.images.raw_image import RawColour
from raden_torch.images.shot_settings import UNKNOWN, ShotSettings, orientation_of


@dataclass(frozen=True, eq=False)
class Photograph:
    """One photograph in linear light.

    Attributes:
        linear: `[H, W, 3]` RGB, or `[H, W, 1]` for a mosaic that was kept; 1 is the white level of
            whole-number files, float files keep their own unit.
        saturated: `[H, W]`, true where a stored value reached the white level, so that `linear`
            means only "at least"; after demosaicing also the pixels that were made of such values.
        rounding: `[H, W, C]`, the standard deviation of `linear` that comes of whole numbers alone.
        path: the file, for messages.
        bits: of one stored value; None for floats.
        exposure_s: as stated, or as the file's EXIF says; None where nobody does.
        settings: of the camera, as EXIF says.
        pattern: the Bayer pattern of a raw mosaic, row by row from the upper left corner ("RGGB").
        colour: of a raw file, whose `linear` is the camera's own RGB: its way to sRGB's; None
            where nobody knows it, and for all others.
    """

    linear: Floats32
    saturated: NDArray[np.bool_]
    rounding: Floats32
    path: Path
    bits: int | None = None
    exposure_s: float | None = None
    settings: ShotSettings = UNKNOWN
    pattern: str | None = None
    colour: RawColour | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.saturated.shape
        return height, width

    @property
    def seen(self) -> NDArray[np.uint8]:
        """`[H, W, 3]` of an RGB photograph for a person or a detector, by `shown`; the camera's RGB
        where nobody knows its way to sRGB's."""
        return shown(in_srgb(self.linear, None if self.colour is None else self.colour.to_srgb))

    def turned_to(self, orientation: int) -> Photograph:
        """The same, turned by this EXIF orientation instead of its own (1 where its file states
        none).

        Raises:
            InputError: a mosaic that was kept, whose pattern would be another.
        """
        if self.linear.shape[2] == 1 and self.pattern is not None:
            raise InputError(f"{self.path}: turning: expected RGB, got a mosaic that was kept")
        own = self.settings.turned
        return replace(
            self,
            linear=turned_to(self.linear, own, orientation),
            saturated=turned_to(self.saturated, own, orientation),
            rounding=turned_to(self.rounding, own, orientation),
            settings=replace(self.settings, orientation=orientation),
        )

    def in_frame(self, orientation: int | None) -> Photograph:
        """Turned by this EXIF orientation where the file states one of its own: a photograph
        without lies as its camera's others. None: as the file says.

        Raises:
            InputError: as for `turned_to`.
        """
        if orientation is None or self.settings.orientation is None:
            return self
        return self.turned_to(orientation)


def read_linear(
    path: str | os.PathLike[str],
    *,
    coded: Coding = "auto",
    pattern: str | None = None,
    keep_mosaic: bool = False,
    white_level: float | None = None,
    exposure_s: float | None = None,
) -> Photograph:
    """Read a photograph: 8- or 16-bit PNG, JPEG or TIFF, HEIC, float TIFF, EXR, Radiance HDR, a
    camera's raw file, or a raw Bayer mosaic as a TIFF or PNG of one channel.

    A colour profile (or PNG's colour chunks, or OpenEXR's chromaticities) is followed to linear RGB
    of sRGB's primaries, except in raw files, mosaics and with a response, which stay the camera's
    own RGB. Alpha is left out.

    Args:
        coded: what the stored values mean. "linear": light of the profile's primaries; "srgb": sRGB
            whatever the profile's curve is; a response as `recover_response` gives it, `[levels]`
            or `[levels, 3]`; "auto": linear for mosaics and floats, the profile's curve for the
            rest, sRGB where there is none.
        pattern: "RGGB", "BGGR", "GRBG" or "GBRG" for a mosaic; without it the file's CFA tag is
            taken. "none" says that the one channel is grey.
        keep_mosaic: leave the mosaic `[H, W, 1]` as it is.
        white_level: the stored value at which the sensor saturates, where that is not the largest
            that fits (4095 for 12-bit values in a 16-bit file).
        exposure_s: exposure time in seconds, before what EXIF says.

    Raises:
        InputError: not readable; a JPEG that is said to be linear; a mosaic whose pattern is not
            known; whole numbers of which only the low bytes are left.

    Warns:
        UserWarning: a 16-bit file that holds 8-bit values; a raw file that asks for corrections
            which are not made.
    """
    photo = read_photograph(Path(path), coded)
    mosaic = bayer_pattern(photo, pattern)
    found = linear_values(photo, coded, white_level, mosaic)
    if mosaic is None or not keep_mosaic:
        found = _in_colour(found, mosaic)
    seconds = photo.settings.exposure_s if exposure_s is None else exposure_s
    if seconds is not None and not 0 < seconds < np.inf:
        raise InputError(f"{path}: exposure: expected a positive time, got {seconds} s")
    return Photograph(
        found.linear,
        found.saturated,
        found.rounding,
        photo.path,
        photo.bits,
        seconds,
        photo.settings,
        mosaic,
        None if photo.raw is None else photo.raw.colour,
    )


def read_stored(path: str | os.PathLike[str]) -> NDArray[Any]:
    """`[H, W, 3]` RGB as stored, for what looks at a picture rather than measures it.

    Float and raw files come as 8-bit sRGB with their brightest hundredth clipped; 16-bit ones as
    8-bit.

    Raises:
        InputError: as for `read_linear`.
    """
    return read_turned(path)[0]


def read_turned(path: str | os.PathLike[str]) -> tuple[NDArray[Any], int | None]:
    """What `read_stored` gives, and the EXIF orientation, 1…8, by which it was turned; None where
    the file says none."""
    path = Path(path)
    if is_raw(path):
        photo = read_linear(path)
        return photo.seen, photo.settings.orientation
    if path.suffix.lower() == ".exr":
        return shown(exr_colour(path)), None
    image = read_image(path)
    pixels, orientation = image.rgb, orientation_of(image.header.tags)
    if pixels.dtype == np.uint8:
        return pixels, orientation
    if pixels.dtype.kind == "u":
        return (pixels >> 8).astype(np.uint8), orientation
    return shown(pixels), orientation


def stated_orientation(path: str | os.PathLike[str]) -> int | None:
    """EXIF's orientation of a photograph, 1…8, None where the file says none; of its header alone
    where that can be read alone.

    Raises:
        InputError: as for `read_header`, or `read_linear`.
    """
    if is_raw(path) or other_format(path) is not None:
        return read_turned(path)[1]
    return orientation_of(read_header(path).tags)


def shown(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Linear `[H, W, 3]` → 8-bit sRGB for a person or a detector, the brightest 1 % clipped."""
    top = float(np.quantile(linear.max(axis=-1), 0.99))
    scaled = np.clip(linear / top if top > 0 else linear, 0, 1)
    return (
        np.searchsorted(SRGB_SPACE.table(255)[:, 0], scaled.ravel())
        .reshape(linear.shape)
        .astype(np.uint8)
    )


def check_same_size(photos: Sequence[Photograph]) -> None:
    """Raise InputError, naming the file, where a photograph differs in size from the first."""
    for photo in photos[1:]:
        if photo.size != photos[0].size:
            (h, w), (height, width) = photos[0].size, photo.size
            raise InputError(
                f"{photo.path}: expected photographs of one size, got {width} x {height} pixels, "
                f"but {photos[0].path} has {w} x {h} (was the camera turned?)"
            )


def _in_colour(found: LinearValues, mosaic: str | None) -> LinearValues:
    """`[H, W, 3]` of one channel: a mosaic is demosaiced, a grey picture is grey in all three."""
    linear, rounding, saturated = found.linear, found.rounding, found.saturated
    if mosaic is not None:
        linear = demosaiced(linear[..., 0], mosaic)
        is_even = bool((rounding == rounding.flat[0]).all())  # and stays so
        rounding = (
            np.full_like(linear, rounding.flat[0])
            if is_even
            else demosaiced(rounding[..., 0], mosaic)
        )
        saturated = _spread(saturated)
    elif linear.shape[2] == 1:
        linear, rounding = np.repeat(linear, 3, 2), np.repeat(rounding, 3, 2)
    return LinearValues(linear, rounding, saturated)


def _spread(saturated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    import cv2

    return cv2.dilate(saturated.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
