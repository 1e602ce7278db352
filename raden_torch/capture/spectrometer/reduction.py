"""Readings → reflectance factors with their standard deviation.

A lamp that lights the sample with E gives the radiance L = f_r E cos θi, where the lit spot is
larger than what the detector sees. With the dark reading D and the white reference's W, both
interpolated linearly in time between the series before and after the reading S,

    R(g) = R_w(g_w) · (S − D) / (W − D) · cos θi(g_w) / cos θi(g),      cos θi = cos a cos t,

for a white that is read at one geometry g_w. Where the white is read in every cell, g_w = g, the
cosines cancel, and so does whatever the rig does to the irradiance there.

With spectra, the ratio is taken at each wavelength and weighed to X, Y, Z for D65: the lamp's own
spectrum cancels. Without, it is taken of X, Y and Z: exact for a lamp with D65's spectrum, and
otherwise as good as a von Kries adaptation.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats, group_sums
from raden_torch.capture.spectrometer import contradictions
from raden_torch.capture.spectrometer.journal import Header, JournalContents, Reference
from raden_torch.capture.spectrometer.ports import ColorReading, Position, Range, Target
from raden_torch.capture.spectrometer.scan_budget import (
    Budget,
    geometry_terms,
    repeatability,
    systematic_errors,
    white_move_std,
)
from raden_torch.capture.spectrometer.scan_plan import Plan, TakenReading
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import bands_to_xyz_matrix

_WEAK_BAND = 1e-3  # of the lamp's strongest band; below, a ratio is more noise than signal
_UNIFORM_WIDTH = np.sqrt(12.0)  # of an even distribution, over its standard deviation


@dataclass(frozen=True)
class ReducedScan:
    """What became of a journal.

    Attributes:
        measurement: a row a cell of the plan and of what it excluded, sorted by the angles; cells
            without a reading in range, or with one over it, are NaN and not valid.
        budget: the terms of its standard deviation; NaN in rows that are not valid.
        over, under: `[M]` how many readings of each cell were over or under the range.
        excluded: `[M]` True in the cells that the rig could not reach.
        spectral: True where the ratios were taken wavelength by wavelength.
        white_level: `[K, 3]` the K white series over the first of them, darkness subtracted.
        white_time_s: `[K]` when they were read, in seconds since 1970.
        white_single_std: `[3]` relative standard deviation of single white readings.
        repeat_std: `[3]` median over the cells of the relative standard deviation of single
            readings of a cell; NaN without repeats.
        warnings: readings that contradict each other; see `contradictions`.
    """

    measurement: BrdfMeasurement
    budget: Budget
    over: NDArray[np.int64]
    under: NDArray[np.int64]
    excluded: Bools
    spectral: bool
    white_level: Floats
    white_time_s: Floats
    white_single_std: Floats
    repeat_std: Floats
    warnings: tuple[str, ...] = ()


def reduce_readings(contents: JournalContents) -> ReducedScan:
    """The measurement that a journal holds; see the module's text for the formula.

    Raises:
        InputError: no dark or white series, a white that gives no light, no reading in range, or
            readings that contradict each other (`contradictions`).
    """
    header, plan = contents.header, contents.plan
    lamp = _Lamp(contents)
    taken = [t for t in contents.taken if t.step.target is Target.SAMPLE]
    cells = plan.cells
    in_range = [t for t in taken if t.reading.range is Range.OK]
    if not in_range:
        raise InputError("journal: none of its readings is in range; nothing can be reduced")
    index = np.array([t.step.cell for t in in_range])
    signal, times = lamp.signals([t.reading for t in in_range]), _times(in_range)
    if plan.white_at_each:
        own = _whites_by_cell(contents.taken, header.white.at_cells, lamp, len(cells))
        by = own.divisor(index, lamp)
    else:
        by = _divisor(header, lamp, times, cells[index])
    signal = signal - lamp.dark(times)
    ratio, factor = lamp.ratio(signal, by.white), by.factor

    count = np.bincount(index, minlength=len(cells))
    mean = lambda rows: _mean(index, rows, len(cells))  # noqa: E731
    values = mean(factor * ratio)
    spread = np.sqrt(_mean(index, (factor * ratio - values[index]) ** 2, len(cells)))
    n = np.maximum(count, 1)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        own_std = spread * np.sqrt(n / (n - 1.0))
    single = factor * np.hypot(ratio * lamp.white_single_std, lamp.dark_single_std)
    warnings = (
        *contradictions.of_repeats(factor * ratio, index, values, single, cells),
        *contradictions.of_white(lamp.white_level, lamp.white_time_s),
    )
    # dark is in the white, too: d ratio / d D = (ratio − 1) / W
    dark_noise = factor * abs(1 - ratio) * np.hypot(*lamp.dark_share(times)) * lamp.dark_single_std
    budget = _ReadingTerms(
        repeatability=repeatability(own_std, mean(single), n),
        white=abs(mean(factor * ratio * by.white_std)),
        dark=mean(dark_noise),
        drift=abs(mean(factor * ratio * by.drift_std)),
        colour=abs(mean(factor * lamp.colour_error(signal, by.white, header.stated))),
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        repeats = (own_std / abs(values))[count > 1]
    return _sorted(
        contents,
        plan,
        lamp,
        values,
        budget,
        count,
        np.median(repeats, axis=0) if len(repeats) else np.full(3, np.nan),
        warnings,
    )


class _Lamp:
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


@dataclass(frozen=True)
class _ReadingTerms:
    """The terms of `Budget` that follow from the readings, `[cells, 3]` each."""

    repeatability: Floats
    white: Floats
    dark: Floats
    drift: Floats
    colour: Floats


@dataclass(frozen=True)
class _Divisor:
    """What N readings are divided by: reflectance factor = factor · ratio to `white`.

    Attributes:
        white: `[N, C]` signal of the white, darkness subtracted.
        factor: `[N, 3]` R_w, times the cosines where the white was read in another geometry.
        white_std, drift_std: `[N, 3]` relative, of the white's noise and of the lamp's drift.
    """

    white: Floats
    factor: Floats
    white_std: Floats
    drift_std: Floats


def _divisor(header: Header, lamp: _Lamp, times: Floats, cells: Floats) -> _Divisor:
    """The white's series around the readings; `cells` `[N, 3]` are the readings' own."""
    lit = _cos_incidence(header.white.position) / _cosines(cells)
    noise = np.hypot(*lamp.white_share(times)) * lamp.white_single_std
    moves = np.hypot(*lamp.white_weight(times)) * white_move_std(header)
    factor = np.array(header.white.xyz) * lit[:, None]
    return _Divisor(lamp.white(times), factor, np.hypot(noise, moves), lamp.drift(times))


@dataclass(frozen=True)
class _OwnWhites:
    white: Floats  # [cells, C] darkness subtracted; NaN where not in range
    xyz: Floats  # [cells, 3]

    def divisor(self, index: NDArray[np.int64], lamp: _Lamp) -> _Divisor:
        """The white beside each reading: one reading of it, without drift."""
        xyz = self.xyz[index]
        noise = np.broadcast_to(lamp.white_single_std, xyz.shape)
        return _Divisor(self.white[index], xyz, noise, np.zeros(xyz.shape))


def _whites_by_cell(
    taken: list[TakenReading],
    at_cells: tuple[tuple[float, float, float], ...],
    lamp: _Lamp,
    cells: int,
) -> _OwnWhites:
    whites = [t for t in taken if t.step.target is Target.WHITE and t.reading.range is Range.OK]
    signal = lamp.signals([t.reading for t in whites]) - lamp.dark(_times(whites))
    white = np.full((cells, signal.shape[1]), np.nan)
    white[[t.step.cell for t in whites]] = signal
    return _OwnWhites(white, np.array(at_cells))


def _sorted(
    contents: JournalContents,
    plan: Plan,
    lamp: _Lamp,
    values: Floats,
    terms: _ReadingTerms,
    count: NDArray[np.int64],
    repeat_std: Floats,
    warnings: tuple[str, ...],
) -> ReducedScan:
    """The cells of the plan and those it excluded, in the order of their angles."""
    over, under = (_out_of_range(contents, which) for which in (Range.OVER, Range.UNDER))
    # the mean of what is left of a cell that was over range once would be too low
    missing = (count == 0) | (over > 0) | ~np.isfinite(values).all(axis=1)
    away = np.array([_angles(position) for position, _ in plan.excluded]).reshape(-1, 3)
    angles = np.concatenate([plan.cells, away])
    order = np.lexsort(angles.T[::-1])

    def rows(column: NDArray[Any], fill: float) -> NDArray[Any]:
        unreached = np.full((len(away), *column.shape[1:]), fill, column.dtype)
        return np.asarray(np.concatenate([column, unreached])[order])

    def valued(column: Floats) -> Floats:
        return rows(np.where(missing[:, None], np.nan, column), np.nan)

    header = contents.header
    incidence, receiving, tilt = angles[order].T
    measurement = BrdfMeasurement(
        incidence,
        receiving,
        tilt,
        values=valued(values),
        count=rows(count, 0),
        valid=~rows(missing, True),
        metadata=Metadata(
            sample=header.sample,
            instrument=f"{header.goniometer}; {header.colorimeter}",
            simulated=header.simulated,
            systematic=systematic_errors(header, lamp.white_mean_std(white_move_std(header))),
        ),
    )
    geometry = geometry_terms(measurement, header)
    budget = Budget(
        **{field.name: valued(getattr(terms, field.name)) for field in fields(terms)},
        **vars(geometry),
        scale=abs(measurement.values) * header.white.relative_std,
    )
    return ReducedScan(
        measurement=replace(measurement, std=budget.total),
        budget=budget,
        over=rows(over, 0),
        under=rows(under, 0),
        excluded=rows(np.zeros(len(plan.cells), bool), True),
        spectral=lamp.wavelengths_nm is not None,
        white_level=lamp.white_level,
        white_time_s=lamp.white_time_s,
        white_single_std=lamp.white_single_std,
        repeat_std=repeat_std,
        warnings=warnings,
    )


def _out_of_range(contents: JournalContents, which: Range) -> NDArray[np.int64]:
    """`[cells]`: how many readings of the sample were so."""
    found = [
        t.step.cell
        for t in contents.taken
        if t.reading.range is which and t.step.target is Target.SAMPLE
    ]
    return np.bincount(np.array(found, np.int64), minlength=len(contents.plan.cells))


def _angles(position: Position) -> tuple[float, float, float]:
    return position.incidence_deg, position.receiving_deg, position.tilt_deg


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


def _mean(index: NDArray[np.intp], rows: Floats, cells: int) -> Floats:
    """`[cells, 3]` mean of the rows of each cell; NaN where it has none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return group_sums(rows, index, cells) / np.bincount(index, minlength=cells)[:, None]


def _times(taken: list[TakenReading]) -> Floats:
    return np.array([t.time_s for t in taken])


def _cosines(cells: Floats) -> Floats:
    radians = np.radians(cells)
    return np.asarray(np.cos(radians[:, 0]) * np.cos(radians[:, 2]))


def _cos_incidence(position: Position) -> float:
    return float(_cosines(np.array([[position.incidence_deg, 0.0, position.tilt_deg]]))[0])
