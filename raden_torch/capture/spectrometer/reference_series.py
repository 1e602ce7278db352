"""The dark and the white series of a scan: what the detector reads of either, at any time.

Between the series before and after a time both are interpolated linearly. With spectra, a ratio to
the white is taken at each wavelength and weighed to X, Y, Z for D65: the lamp's own spectrum
cancels. Without, it is taken of X, Y and Z: exact for a lamp with D65's spectrum, and otherwise as
good as a von Kries adaptation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.spectrometer.journal import JournalContents, Reference
from raden_torch.capture.spectrometer.ports import ColorReading, Range, Target
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import bands_to_xyz_matrix

_WEAK_BAND = 1e-3  # of the lamp's strongest band; below, a ratio is more noise than signal
_UNIFORM_WIDTH = np.sqrt(12.0)  # of an even distribution, over its standard deviation


class ReferenceSeries:
    """The dark and white series of a journal, at any time; signals are `[N, C]`, C = 3 or bands."""

    def __init__(self, contents: JournalContents) -> None:
        readings = [t.reading for t in contents.taken] + [r.reading for r in contents.references]
        self.wavelengths_nm = _common_wavelengths(readings)
        self._weights = (
            np.eye(3) if self.wavelengths_nm is None else _xyz_weights(self.wavelengths_nm)
        )
        darks = _series(contents.references, Target.DARK)
        whites = _series(contents.references, Target.WHITE)
        if not darks or not whites:
            raise InputError("journal: it has no dark or no white reading; resume the scan")
        self._dark_time, self._dark = self._series_means(darks)
        self.white_time_s, self._white = self._series_means(whites)
        self._white = self._white - self.dark(self.white_time_s)
        if not (self._white @ self._weights.T > 0).all():
            raise InputError(
                "journal: a white series gives no more light than the dark one; nothing can be "
                "divided by it"
            )
        self._dark_count = np.array([len(series) for series in darks])
        self._white_count = np.array([len(series) for series in whites])
        self.white_level = self.ratio(self._white, self._white[:1])
        self.white_single_std = self._single_std(whites)
        self.dark_single_std = self._single_std(darks)

    def signals(self, readings: list[ColorReading]) -> Floats:
        """`[N, C]`; what is under the range is 0."""
        if self.wavelengths_nm is None:
            return np.nan_to_num(np.array([r.xyz for r in readings]).reshape(-1, 3))
        none = np.zeros(len(self.wavelengths_nm))
        return np.array([none if r.radiance is None else r.radiance for r in readings])

    def dark(self, time_s: Floats) -> Floats:
        return _interpolated(time_s, self._dark_time, self._dark)

    def white(self, time_s: Floats) -> Floats:
        return _interpolated(time_s, self.white_time_s, self._white)

    def ratio(self, signal: Floats, white: Floats) -> Floats:
        """`[N, 3]`: signal over white, wavelength by wavelength, weighed to X, Y, Z; white is 1."""
        if self.wavelengths_nm is None:
            return signal / white
        ratio, strong = _by_band(signal, white)
        return (ratio @ self._weights.T) / (strong @ self._weights.T)

    def colour_error(self, signal: Floats, white: Floats, stated: StatedUncertainty) -> Floats:
        """`[N, 3]`: of the ratio, by the wavelengths' or the tristimulus values' own error.

        An instrument whose wavelengths are off by δ reads ρ(λ + δ) for ρ(λ): dX/dδ = Σ w ρ′.
        """
        if self.wavelengths_nm is None:
            return stated.xyz_std * signal / white
        if not stated.wavelength_std_nm or len(self.wavelengths_nm) < 2:
            return np.zeros((len(signal), 3))
        ratio, strong = _by_band(signal, white)
        change = np.where(strong, np.gradient(ratio, self.wavelengths_nm, axis=1), 0.0)
        per_nm = (change @ self._weights.T) / (strong @ self._weights.T)
        return np.asarray(stated.wavelength_std_nm * per_nm)

    def white_weight(self, time_s: Floats) -> Floats:
        """`[2, N, 1]`: what the series before and after weigh."""
        return _share(time_s, self.white_time_s, np.ones(len(self.white_time_s), np.int64))

    def white_share(self, time_s: Floats) -> Floats:
        """`[2, N, 1]`: what the series before and after weigh, over √ of their readings."""
        return _share(time_s, self.white_time_s, self._white_count)

    def white_mean_std(self, move_std: float) -> float:
        """Relative, in Y, of the mean of all white readings; `move_std` of each series."""
        noise = self.white_single_std[1] / np.sqrt(self._white_count.sum())
        return float(np.hypot(noise, move_std / np.sqrt(len(self._white_count))))

    def dark_share(self, time_s: Floats) -> Floats:
        return _share(time_s, self._dark_time, self._dark_count)

    def drift(self, time_s: Floats) -> Floats:
        """`[N, 3]`: relative change between the series around a time, as a standard deviation."""
        before, after, _ = _around(time_s, self.white_time_s)
        change = self.white_level[after] - self.white_level[before]
        return np.asarray(abs(change) / self.white_level[before] / _UNIFORM_WIDTH)

    def _series_means(self, series: list[list[Reference]]) -> tuple[Floats, Floats]:
        times = np.array([np.mean([r.time_s for r in one]) for one in series])
        means = [self.signals([r.reading for r in one]).mean(axis=0) for one in series]
        return times, np.array(means)

    def _single_std(self, series: list[list[Reference]]) -> Floats:
        """`[3]`: spread of single readings within their series, as a share of the white."""
        squares, degrees = np.zeros(3), 0
        for one in series:
            time_s = np.array([r.time_s for r in one])
            ratio = self.ratio(self.signals([r.reading for r in one]), self.white(time_s))
            squares += ((ratio - ratio.mean(axis=0)) ** 2).sum(axis=0)
            degrees += len(one) - 1
        return np.sqrt(squares / max(degrees, 1))


def _common_wavelengths(readings: list[ColorReading]) -> Floats | None:
    """The wavelengths that all readings in range have; None where one has no spectrum."""
    first: Floats | None = None
    for reading in readings:
        if reading.range is not Range.OK:
            continue
        if reading.wavelengths_nm is None or reading.radiance is None:
            return None
        if first is None:
            first = reading.wavelengths_nm
        elif not np.array_equal(first, reading.wavelengths_nm):
            return None
    return first


def _xyz_weights(wavelengths_nm: Floats) -> Floats:
    """`[3, L]`: of each wavelength in X, Y and Z for D65, each summing to 1."""
    names = tuple(f"{nm:g}nm" for nm in wavelengths_nm)
    one = np.zeros(1)
    bands = BrdfMeasurement(one, one, one, np.zeros((1, len(names))), names)
    matrix = bands_to_xyz_matrix(bands)
    return matrix / matrix.sum(axis=1, keepdims=True)


def _series(references: list[Reference], target: Target) -> list[list[Reference]]:
    """The readings of a target, one list a series; a dark under the range counts as 0."""
    wanted = [
        r
        for r in references
        if r.target is target and (r.reading.range is Range.OK or target is Target.DARK)
    ]
    by_number: dict[int, list[Reference]] = {}
    for reference in wanted:
        by_number.setdefault(reference.series, []).append(reference)
    return sorted(by_number.values(), key=lambda one: one[0].time_s)  # a clock may be set back


def _around(time_s: Floats, at_s: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """The series before and after each time, and how far between them it lies, 0…1."""
    after = np.clip(np.searchsorted(at_s, time_s), 1, max(len(at_s) - 1, 1))
    after = np.minimum(after, len(at_s) - 1)
    before = np.maximum(after - 1, 0)
    width = np.where(at_s[after] > at_s[before], at_s[after] - at_s[before], 1.0)
    return before, after, np.clip((time_s - at_s[before]) / width, 0.0, 1.0)


def _interpolated(time_s: Floats, at_s: Floats, levels: Floats) -> Floats:
    """`[N, C]`: linear between series, constant before the first and after the last."""
    before, after, x = _around(time_s, at_s)
    return np.asarray(levels[before] + x[:, None] * (levels[after] - levels[before]))


def _by_band(signal: Floats, white: Floats) -> tuple[Floats, Bools]:
    """`[N, C]` signal over white, and where the white is strong enough; 0 where not."""
    strong = white > _WEAK_BAND * white.max(axis=-1, keepdims=True)
    return np.where(strong, signal / np.where(strong, white, 1.0), 0.0), strong


def _share(time_s: Floats, at_s: Floats, counts: NDArray[np.int64]) -> Floats:
    before, after, x = _around(time_s, at_s)
    return np.stack([(1 - x) / np.sqrt(counts[before]), x / np.sqrt(counts[after])])[..., None]
