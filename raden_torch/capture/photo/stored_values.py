"""Stored values → linear light, through a table of all whole numbers that there may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats32
from raden_torch.capture.photo.stored_photograph import JPEG_SUFFIXES, Coding, StoredPhotograph
from raden_torch.errors import InputError
from raden_torch.images.colour_space import SRGB_SPACE, in_srgb
from raden_torch.images.lookup_profile import LookupProfile
from raden_torch.images.raw_image import RawImage


@dataclass(frozen=True, eq=False)
class LinearValues:
    """Light that was stored.

    Attributes:
        linear: `[H, W, C]`, 1 at the white level; floats keep their unit.
        rounding: `[H, W, C]` the standard deviation of `linear` by whole numbers alone.
        saturated: `[H, W]` a stored value reached the white level.
    """

    linear: Floats32
    rounding: Floats32
    saturated: Bools


def linear_values(
    photo: StoredPhotograph, coded: Coding, white_level: float | None, mosaic: str | None
) -> LinearValues:
    """Decode a photograph, to sRGB's primaries where its file says others.

    Args:
        coded: as for `read_linear`.
        white_level: before what the file says.
        mosaic: the Bayer pattern; None where the picture is none.

    Raises:
        InputError: a white level that the values cannot have, or a coding that does not fit.
    """
    if photo.raw is not None:
        return _of_raw(photo, photo.raw, white_level)
    linear, rounding, top = _decoded(photo, coded, white_level or photo.white_level, mosaic)
    if photo.matrix is not None and linear.shape[2] == 3:
        linear = in_srgb(linear, photo.matrix)
        rounding = np.sqrt(in_srgb(rounding**2, photo.matrix**2))
    values = photo.values.reshape(*photo.values.shape[:2], -1)
    full = values >= (np.inf if top is None else top)
    return LinearValues(linear, rounding, np.asarray(full.any(axis=2)))


def _of_raw(photo: StoredPhotograph, raw: RawImage, white_level: float | None) -> LinearValues:
    """The camera's own RGB, or its mosaic."""
    top, dark = white_level or raw.white, float(raw.black.max())
    if not dark + 1 < top <= 65535:
        raise InputError(f"{photo.path}: white level: expected {dark + 2:g}…65535, got {top:g}")
    linear = raw.linear(top)
    step = np.float32(1 / (top - dark) / np.sqrt(12))
    values = raw.values.reshape(*raw.values.shape[:2], -1)
    full = np.asarray((values >= top).any(axis=2))
    return LinearValues(linear, np.full_like(linear, step), full)


def _decoded(
    photo: StoredPhotograph, coded: Coding, white: float | None, mosaic: str | None
) -> tuple[Floats32, Floats32, float | None]:
    """Linear and its rounding, `[H, W, C]`, and the stored value that is saturated."""
    stored = photo.values
    values = stored if stored.ndim == 3 else stored[..., None]
    if stored.dtype.kind == "f":
        linear = np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0)
        return linear, np.zeros_like(linear), white
    levels = int(np.iinfo(stored.dtype).max)
    top = float(levels if white is None else white)
    if not 1 < top <= levels:
        raise InputError(f"{photo.path}: white level: expected 2…{levels}, got {top:g}")
    if isinstance(photo.space, LookupProfile) and mosaic is None:
        rgb = values if values.shape[2] == 3 else np.repeat(values, 3, 2)
        return *_by_tables(photo.space, rgb, top), top
    table = _table(photo, coded, levels, top, mosaic)
    slope = np.gradient(table, axis=0)
    grain = (slope / np.sqrt(12)).astype(np.float32)
    linear, rounding = np.empty(values.shape, np.float32), np.empty(values.shape, np.float32)
    for c in range(values.shape[2]):
        column = min(c, table.shape[1] - 1)
        linear[..., c] = table[:, column].take(values[..., c])
        rounding[..., c] = grain[:, column].take(values[..., c])
    return linear, rounding, top


def _by_tables(space: LookupProfile, values: NDArray[Any], top: float) -> tuple[Floats32, Floats32]:
    """`[H, W, 3]` linear, and its rounding by the slope along grey, over a hundredth of the range:
    the tables' own steps are as small as those of 16 bits."""
    stored, step = values.astype(np.float32), np.float32(top / 100)
    slope = space.linear(stored + step / 2, top) - space.linear(stored - step / 2, top)
    return space.linear(stored, top), np.abs(slope) / (step * np.float32(np.sqrt(12)))


def _table(
    photo: StoredPhotograph, coded: Coding, levels: int, top: float, mosaic: str | None
) -> Floats32:
    """Stored value → linear, `[levels + 1, 1 or 3]`."""
    path, space = photo.path, photo.space
    if isinstance(space, LookupProfile):  # of a mosaic, whose colours are the camera's own
        space = None
    if not isinstance(coded, str):
        table = np.asarray(coded, np.float32).reshape(len(coded), -1)
        if table.shape not in ((levels + 1, 1), (levels + 1, 3)):
            raise InputError(
                f"{path}: response: expected {levels + 1} x 1 or 3 values, got {list(table.shape)}"
            )
        return table
    if coded not in ("auto", "srgb", "linear"):
        raise InputError(f"coded: expected auto, srgb or linear, got {coded!r}")
    if coded == "linear" and path.suffix.lower() in JPEG_SUFFIXES:
        raise InputError(
            f"{path}: a JPEG is never linear; give the raw file or a linear TIFF, take it as sRGB, "
            "or recover its response from an exposure stack"
        )
    ramp = np.arange(levels + 1, dtype=np.float32)[:, None] / top
    if coded == "linear" or (coded == "auto" and mosaic is not None):
        return ramp
    return (SRGB_SPACE if space is None or coded == "srgb" else space).table(levels, top)
