"""Dark frames are subtracted, and a flat field divided by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.photograph import Photograph, check_same_size
from raden_torch.errors import InputError


def subtract_dark(photo: Photograph, darks: Sequence[Photograph]) -> Photograph:
    """Take the mean of the dark frames of the same exposure time away.

    Values below the dark level become negative: cutting them off would lift the shadows.

    Raises:
        InputError: no dark frame with this exposure time (those without any time fit every
            photograph), another size, or frames that are not dark.
    """
    matching = [dark for dark in darks if _same_time(dark.exposure_s, photo.exposure_s)]
    if not matching:
        there = sorted({f"{dark.exposure_s:g} s" for dark in darks if dark.exposure_s})
        raise InputError(
            f"{photo.path}: no dark frame of {photo.exposure_s} s (there are "
            f"{', '.join(there) or 'none'}); take one with the lens covered"
        )
    check_same_size([photo, *matching])
    for dark in matching:
        if dark.linear.shape != photo.linear.shape:
            raise InputError(f"{dark.path}: read it in the same way as {photo.path}")
        if np.median(dark.linear) > 0.2:
            raise InputError(
                f"{dark.path}: not dark (median {np.median(dark.linear):.2f} of white); "
                "dark frames are taken with the lens covered"
            )
    level = np.mean([dark.linear for dark in matching], axis=0, dtype=np.float32)
    return replace(photo, linear=photo.linear - level)


def flat_field(flat: Photograph, *, smooth: float = 0.01) -> Floats32:
    """`[H, W, C]`, the share of light that arrives at each pixel, 1 where most does.

    Args:
        flat: an evenly lit white sheet that fills the frame, out of focus, dark frame subtracted.
        smooth: standard deviation of a Gaussian, as a share of the longer side; 0 keeps the single
            pixels' differences (and the noise).

    Raises:
        InputError: saturated, or too dark somewhere to be divided by.
    """
    import cv2

    if flat.saturated.mean() > 0.001:
        raise InputError(
            f"{flat.path}: a flat field that is saturated in {100 * flat.saturated.mean():.1f} % "
            "of its pixels; expose it to about half"
        )
    sigma = smooth * max(flat.size)
    level = cv2.GaussianBlur(flat.linear, (0, 0), sigma) if sigma > 0 else flat.linear
    level = level.reshape(flat.linear.shape)
    share = level / np.quantile(level, 0.999, axis=(0, 1))
    if not share.min() > 0.02:
        raise InputError(
            f"{flat.path}: expected a flat field (an evenly lit white sheet that fills the "
            f"frame), got one that falls to {100 * share.min():.1f} % of its brightest"
        )
    return np.asarray(share, np.float32)


def flatten(photo: Photograph, share: Floats32) -> Photograph:
    """Divide by what `flat_field` found.

    Raises:
        InputError: another size.
    """
    if share.shape != photo.linear.shape:
        height, width = photo.size
        raise InputError(
            f"{photo.path}: expected the flat field's size of {share.shape[1]} x {share.shape[0]} "
            f"pixels, got {width} x {height}; take both with one camera"
        )
    return replace(photo, linear=photo.linear / share, rounding=photo.rounding / share)


def _same_time(a: float | None, b: float | None) -> bool:
    return a is None or (b is not None and abs(a / b - 1) < 0.02)
