"""Several exposures of one view → radiance, each pixel weighted by its noise; and is it linear?"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats32
from raden_torch.capture.photo.photograph import Photograph, check_same_size, read_stored
from raden_torch.errors import InputError
from raden_torch.images.pixels import read_pixels

CEILING = 0.9
"""Share of the white level above which a value counts as saturated too: sensors bend there."""
MARGIN_PX = 2
"""Pixels so near to a saturated one are left out: blooming, resampling and JPEG blocks bring light
from it (on downsampled raw mosaics their 95 % error is ten times that of the rest)."""
DETECTION = 10.0
"""Signals below so many standard deviations are left out of the linearity: noise alone makes them
deviate by more than a tenth."""
_SAMPLES = 500_000


@dataclass(frozen=True)
class Noise:
    """variance = read² + gain · signal + rounding², in units of the white level.

    The photon-transfer model (EMVA 1288): `gain` is 1 / full well in electrons.
    """

    read: float
    gain: float

    def variance(self, signal: Floats32, rounding: Floats32) -> Floats32:
        found = self.read**2 + self.gain * np.maximum(signal, 0) + rounding**2
        return np.asarray(found, np.float32)


@dataclass(frozen=True)
class Linearity:
    """How far the signal is from proportional to the exposure time, as relative deviations.

    Attributes:
        median: of |signal / (merged radiance · time) − 1|.
        weighted_95: the 95 % quantile, each value weighted by 1 / its relative noise variance.
        median_left_out, weighted_95_left_out: the same against radiance merged from the *other*
            exposures only, which is stricter.
        samples: values compared, all unsaturated and above the noise.
    """

    median: float
    weighted_95: float
    median_left_out: float
    weighted_95_left_out: float
    samples: int

    def __str__(self) -> str:
        return (
            f"signal against exposure time: median deviation {100 * self.median:.2f} %, "
            f"noise-weighted 95 % quantile {100 * self.weighted_95:.2f} % "
            f"({self.samples} values; against the other exposures alone "
            f"{100 * self.median_left_out:.2f} % and {100 * self.weighted_95_left_out:.2f} %)"
        )


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
        InputError: a photograph without exposure time, different sizes, ISO or apertures, or
            saturated nearly everywhere in every exposure.
    """
    times = _checked(photos)
    usable = [unsaturated(photo, ceiling) for photo in photos]
    found = noise or Noise(read=0.002, gain=0.0005)
    total, weight = _sums(photos, times, usable, found, None)
    for _ in range(2):
        expected = _mean(total, weight)
        if noise is None:
            found = _noise(photos, times, usable, found, expected, weight) or found
        total, weight = _sums(photos, times, usable, found, expected)
    radiance, covered = _mean(total, weight), weight > 0
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
    line = _linearity(photos, times, usable, found, total, weight)
    return Radiance(radiance.astype(np.float32), sigma, valid, found, line)


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


def recover_response(
    paths: Sequence[str | os.PathLike[str]],
    exposures_s: Sequence[float],
    *,
    samples: int = 300,
) -> Floats32:
    """The unknown response of 8-bit photographs: stored value → linear, `[256, 3]`, 1 at 255.

    Debevec and Malik, Recovering High Dynamic Range Radiance Maps from Photographs (1997), through
    OpenCV. Give the result to `read_linear(coded=…)`.

    Raises:
        InputError: fewer than three exposures, not 8-bit, different sizes, or a response that does
            not rise (the scene moved, or the times are wrong).
    """
    import cv2

    if len(paths) < 3 or len(paths) != len(exposures_s) or len(set(exposures_s)) < 3:
        raise InputError(
            f"response: expected three or more different exposures, got {len(paths)} photographs "
            f"and {len(exposures_s)} exposure times"
        )
    stored = []
    for path in paths:
        if read_pixels(path, colour=False).dtype != np.uint8:
            raise InputError(
                f"{path}: expected 8 bits, got 16; 16-bit files are read as linear or sRGB"
            )
        stored.append(read_stored(path))
        if stored[-1].shape != stored[0].shape:
            raise InputError(f"{path}: expected the size of {paths[0]}, got another")
    solver = cv2.createCalibrateDebevec(samples, 20.0, False)
    curve = solver.process(stored, np.asarray(exposures_s, np.float32)).reshape(256, 3)
    middle = curve[16:240]
    if not np.isfinite(curve).all() or (np.diff(middle[::16], axis=0) <= 0).any():
        raise InputError(
            f"{paths[0]} and the others: no rising response fits them; did the camera or the scene "
            "move, or are the exposure times wrong?"
        )
    # its ends hang on few pixels: they may not fall
    curve = np.maximum.accumulate(curve, axis=0)
    return np.asarray(curve / curve[-1], np.float32)


def _checked(photos: Sequence[Photograph]) -> list[float]:
    if not photos:
        raise InputError("photographs to merge: expected at least one, got none")
    check_same_size(photos)
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
        for name, have, wanted in (
            ("ISO", photo.iso, first.iso),
            ("aperture f/", photo.f_number, first.f_number),
        ):
            if have and wanted and abs(have / wanted - 1) > 0.01:
                raise InputError(
                    f"{photo.path}: expected {name} {wanted:g} as in {first.path}, got {have:g}; "
                    "only the exposure time may change"
                )
    return [photo.exposure_s for photo in photos if photo.exposure_s is not None]


def _same_time(a: float | None, b: float | None) -> bool:
    return a is None or (b is not None and abs(a / b - 1) < 0.02)


def unsaturated(photo: Photograph, ceiling: float) -> NDArray[np.bool_]:
    """`[H, W]`: below the ceiling, and not beside a saturated pixel."""
    import cv2

    size = 2 * MARGIN_PX + 1
    near = cv2.dilate(photo.saturated.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    bright = np.zeros_like(near) if photo.bits is None else (photo.linear > ceiling).any(axis=2)
    return np.asarray(~(near | bright) & np.isfinite(photo.linear).all(axis=2))


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
        w = _weight(photo, t, use, noise, expected)
        total += w * photo.linear / t
        weight += w
    return total, weight


def _weight(
    photo: Photograph, t: float, use: NDArray[np.bool_], noise: Noise, expected: Floats32 | None
) -> Floats32:
    signal = photo.linear if expected is None else expected * t
    variance = np.maximum(noise.variance(signal, photo.rounding), 1e-12)
    return np.where(use[..., None], t * t / variance, 0).astype(np.float32)


def _mean(total: Floats32, weight: Floats32) -> Floats32:
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)


def _picked(*arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """At most `_SAMPLES` of each, the same ones, evenly spread."""
    step = max(1, len(arrays[0]) // _SAMPLES)
    return [array[::step] for array in arrays]


def _noise(
    photos: Sequence[Photograph],
    times: Sequence[float],
    usable: Sequence[NDArray[np.bool_]],
    before: Noise,
    expected: Floats32,
    weight: Floats32,
) -> Noise | None:
    """Read noise and gain from the scatter around the merged radiance; None without scatter."""
    from scipy.optimize import nnls

    signals, residuals, roundings = [], [], []
    for photo, t, use in zip(photos, times, usable, strict=True):
        own = _weight(photo, t, use, before, expected)
        # a value pulls the mean towards itself: the others must have a say
        seen = (own > 0) & (own < 0.7 * weight)
        if not seen.any():
            continue
        signal, x, own_w, all_w, rounding = _picked(
            expected[seen] * t, photo.linear[seen], own[seen], weight[seen], photo.rounding[seen]
        )
        signals.append(signal)
        residuals.append((x - signal) / np.sqrt(1 - own_w / all_w))
        roundings.append(rounding)
    if not signals:
        return None
    signal, residual, rounded = (np.concatenate(p) for p in (signals, residuals, roundings))
    edges = np.geomspace(1e-3, 1, 25)
    bins = np.digitize(signal, edges)
    rows, wanted = [], []
    for level in range(1, len(edges)):
        inside = bins == level
        if inside.sum() < 200:
            continue
        spread = 1.4826 * float(np.median(np.abs(residual[inside])))
        grain = float(np.mean(rounded[inside] ** 2))
        excess = max(spread**2 - grain, 0.0)
        # a rounding in the denominator: relative errors, so that each level counts alike
        scale = 1 / max(excess, grain, 1e-10)
        rows.append([scale, scale * float(np.median(signal[inside]))])
        wanted.append(scale * excess)
    if len(rows) < 3:
        return None
    (read, gain), _ = nnls(np.array(rows), np.array(wanted))
    return Noise(float(np.sqrt(read)), float(gain))


def _linearity(
    photos: Sequence[Photograph],
    times: Sequence[float],
    usable: Sequence[NDArray[np.bool_]],
    noise: Noise,
    total: Floats32,
    weight: Floats32,
) -> Linearity | None:
    merged = _mean(total, weight)
    inside, left_out, weights = [], [], []
    for photo, t, use in zip(photos, times, usable, strict=True):
        own = _weight(photo, t, use, noise, merged)
        others = weight - own
        signal = merged * t
        deviation = np.sqrt(np.maximum(noise.variance(signal, photo.rounding), 1e-12))
        seen = (own > 0) & (others > 1e-3 * weight) & (signal > DETECTION * deviation)
        if not seen.any():
            continue
        x, m, rest, w_rest, own_w, s = _picked(
            photo.linear[seen],
            signal[seen],
            total[seen],
            others[seen],
            own[seen],
            deviation[seen],
        )
        without = (rest - own_w * x / t) / w_rest * t
        inside.append(np.abs(x / m - 1))
        left_out.append(np.abs(x / np.where(without > 0, without, np.nan) - 1))
        weights.append((m / s) ** 2)
    if not inside or len(set(times)) < 2:
        return None
    a, b, w = (np.concatenate(part) for part in (inside, left_out, weights))
    b = np.nan_to_num(b, nan=1.0)
    return Linearity(
        float(np.median(a)),
        _weighted_quantile(a, w, 0.95),
        float(np.median(b)),
        _weighted_quantile(b, w, 0.95),
        len(a),
    )


def _weighted_quantile(values: NDArray[Any], weights: NDArray[Any], share: float) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order], dtype=np.float64)
    return float(values[order][np.searchsorted(reached, share * reached[-1])])
