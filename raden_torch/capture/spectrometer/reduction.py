"""Readings → reflectance factors with their standard deviation.

A lamp that lights the sample with E gives the radiance L = f_r E cos θi, where the lit spot is
larger than what the detector sees. With the dark reading D and the white reference's W, both
interpolated linearly in time between the series before and after the reading S,

    R(g) = R_w(g_w) · (S − D) / (W − D) · cos θi(g_w) / cos θi(g),      cos θi = cos a cos t,

for a white that is read at one geometry g_w. Where the white is read in every cell, g_w = g, the
cosines cancel, and so does whatever the rig does to the irradiance there.

`reference_series` says how a ratio is taken of spectra, and how of X, Y and Z.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats, group_sums
from raden_torch.capture.spectrometer import contradictions
from raden_torch.capture.spectrometer.journal import Header, JournalContents
from raden_torch.capture.spectrometer.ports import Position, Range, Target
from raden_torch.capture.spectrometer.reference_series import ReferenceSeries
from raden_torch.capture.spectrometer.scan_budget import (
    Budget,
    geometry_terms,
    repeatability,
    systematic_errors,
    white_move_std,
)
from raden_torch.capture.spectrometer.scan_plan import Plan, TakenReading
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata


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
    lamp = ReferenceSeries(contents)
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


def _divisor(header: Header, lamp: ReferenceSeries, times: Floats, cells: Floats) -> _Divisor:
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

    def divisor(self, index: NDArray[np.int64], lamp: ReferenceSeries) -> _Divisor:
        """The white beside each reading: one reading of it, without drift."""
        xyz = self.xyz[index]
        noise = np.broadcast_to(lamp.white_single_std, xyz.shape)
        return _Divisor(self.white[index], xyz, noise, np.zeros(xyz.shape))


def _whites_by_cell(
    taken: list[TakenReading],
    at_cells: tuple[tuple[float, float, float], ...],
    lamp: ReferenceSeries,
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
    lamp: ReferenceSeries,
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
    away = np.array([position.angles_deg for position, _ in plan.excluded]).reshape(-1, 3)
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
