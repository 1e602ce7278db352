"""Several exposures of one view → radiance, each pixel weighted by its noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.exposure_weights import Noise, exposure_weight, weighted_mean
from raden_torch.capture.photo.linearity import Linearity, linearity_of
from raden_torch.capture.photo.noise_fit import fit_noise
from raden_torch.capture.photo.photograph import Photograph, check_same_size
from raden_torch.errors import InputError
from raden_torch.images.shot_settings import check_alike, same_setting

CEILING = 0.9
"""Share of the white level above which a value counts as saturated too: sensors bend there."""
MARGIN_PX = 2
"""Pixels so near to a saturated one are left out: blooming, resampling and JPEG blocks bring light
from it (on downsampled raw mosaics their 95 % error is ten times that of the rest)."""


@dataclass(frozen=True, eq=False)
class Radiance:
    """Merged exposures.

    Attributes:
        radiance: `[H, W, C]`, white levels per second, relative to the camera's sensitivity.
        sigma: `[H, W, C]`, its standard deviation by the noise model.
        valid: `[H, W]`, false where every exposure is saturated; `radiance` is a lower bound there.
        noise: the camera's noise, as stated or as found in the stack.
        linearity: None where no pixel is usable in two exposures of different length.
    """

    radiance: Floats32
    sigma: Floats32
    valid: NDArray[np.bool_]
    noise: Noise
    linearity: Linearity | None


def merge_exposures(
    photos: Sequence[Photograph], *, ceiling: float = CEILING, noise: Noise | None = None
) -> Radiance:
    """Merge photographs of one view, each as `subtract_dark` and `flatten` left it.

    The minimum-variance mean over the unsaturated exposures: weights t² / variance, the variance
    taken at the *expected* signal, since a weight from the noisy value itself would prefer the
    values that fell low.

    Args:
        photos: with exposure times, one camera setting otherwise.
        ceiling: share of the white level from which a value counts as saturated.
        noise: the camera's; else it is found from how the exposures scatter.

    Raises:
        InputError: no photographs; one without exposure time; different sizes, channels, bits, ISO,
            apertures, cameras, lenses, focal lengths or white balances; saturated nearly everywhere
            in every exposure.
    """
    times = _checked(photos)
    usable = [unsaturated(photo, ceiling) for photo in photos]
    found = noise or Noise(read=0.002, gain=0.0005)
    total, weight = _sums(photos, times, usable, found, None)
    for _ in range(2):
        expected = weighted_mean(total, weight)
        if noise is None:
            found = fit_noise(photos, times, usable, found, expected, weight) or found
        total, weight = _sums(photos, times, usable, found, expected)
    radiance, covered = weighted_mean(total, weight), weight > 0
    valid: NDArray[np.bool_] = np.asarray(covered.all(axis=2))
    shortest = int(np.argmin(times))
    if valid.mean() < 0.01:
        raise InputError(
            f"{photos[shortest].path}: over-exposed nearly everywhere, as are the longer exposures;"
            " add a shorter one"
        )
    floor = photos[shortest].linear / times[shortest]
    radiance = np.where(covered, radiance, floor)
    sigma = np.where(covered, 1 / np.sqrt(np.maximum(weight, 1e-30)), np.inf).astype(np.float32)
    line = linearity_of(photos, times, usable, found, total, weight)
    return Radiance(radiance.astype(np.float32), sigma, valid, found, line)


def unsaturated(photo: Photograph, ceiling: float) -> NDArray[np.bool_]:
    """`[H, W]`: below the ceiling, and not beside a saturated pixel."""
    import cv2

    size = 2 * MARGIN_PX + 1
    near = cv2.dilate(photo.saturated.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    bright = np.zeros_like(near) if photo.bits is None else (photo.linear > ceiling).any(axis=2)
    return np.asarray(~(near | bright) & np.isfinite(photo.linear).all(axis=2))


def _checked(photos: Sequence[Photograph]) -> list[float]:
    if not photos:
        raise InputError("photographs to merge: expected at least one, got none")
    check_same_size(photos)
    check_alike([(photo.path, photo.settings) for photo in photos])
    first = photos[0]
    for photo in photos:
        if photo.exposure_s is None:
            raise InputError(
                f"{photo.path}: no exposure time in its EXIF; state it, in seconds, for each file"
            )
        if photo.linear.shape != first.linear.shape or photo.bits != first.bits:
            raise InputError(
                f"{photo.path}: {photo.bits or 'float'} bits and {photo.linear.shape[2]} channels, "
                f"but {first.path} has {first.bits or 'float'} and {first.linear.shape[2]}; "
                "export the stack in one way"
            )
        own, wanted_of = photo.settings, first.settings
        for name, have, wanted in (
            ("ISO", own.iso, wanted_of.iso),
            ("aperture f/", own.f_number, wanted_of.f_number),
        ):
            if have and wanted and not same_setting(have, wanted):
                raise InputError(
                    f"{photo.path}: expected {name} {wanted:g} as in {first.path}, got {have:g}; "
                    "only the exposure time may change"
                )
    return [photo.exposure_s for photo in photos if photo.exposure_s is not None]


def _sums(
    photos: Sequence[Photograph],
    times: Sequence[float],
    usable: Iterable[NDArray[np.bool_]],
    noise: Noise,
    expected: Floats32 | None,
) -> tuple[Floats32, Floats32]:
    """Σ w x / t and Σ w with w = t² / variance."""
    total = np.zeros_like(photos[0].linear)
    weight = np.zeros_like(total)
    for photo, t, use in zip(photos, times, usable, strict=True):
        w = exposure_weight(photo, t, use, noise, expected)
        total += w * photo.linear / t
        weight += w
    return total, weight
