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

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.spectrometer.journal import Contents, Reference
from raden_torch.capture.spectrometer.plan import Plan, Taken
from raden_torch.capture.spectrometer.ports import ColorReading, Floats, Position, Range, Target
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import bands_to_xyz_matrix

Bools = NDArray[np.bool_]

_WEAK_BAND = 1e-3  # of the lamp's strongest band; below, a ratio is more noise than signal
_UNIFORM_WIDTH = np.sqrt(12.0)  # of an even distribution, over its standard deviation


@dataclass(frozen=True)
class Budget:
    """Standard deviations (k = 1) of the reflectance factors, term by term, `[M, 3]` each.

    `repeatability` is a cell's own; the others are shared by cells read near each other in time
    (`white`, `dark`, `drift`), or by all (`scale`), and do not average out over neighbours.

    Attributes:
        repeatability: of the mean of a cell's readings: their own spread over √n where there are
            two or more, else the spread of single white and dark readings, scaled to the value.
        white: noise of the white readings that the cell was divided by.
        dark: noise of the dark readings that were subtracted.
        drift: what linear interpolation may leave: an even distribution as wide as the change
            between the two white series around the reading.
        scale: the white reference's certificate; in `total` only where it is asked for.
    """

    repeatability: Floats
    white: Floats
    dark: Floats
    drift: Floats
    scale: Floats

    @property
    def total(self) -> Floats:
        """All terms but `scale`, in quadrature: what a measurement carries as its `std`.

        The scale is common to all cells, so it would only hide how well they compare.
        """
        terms = (self.repeatability, self.white, self.dark, self.drift)
        return np.sqrt(sum((term**2 for term in terms), np.zeros_like(self.white)))


@dataclass(frozen=True)
class Reduced:
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


def reduce_readings(contents: Contents) -> Reduced:
    """The measurement that a journal holds; see the module's text for the formula.

    Raises:
        InputError: no dark or white series, a white that gives no light, or no reading in range.
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
    white_noise = np.hypot(*lamp.white_share(times)) * lamp.white_single_std
    if plan.white_at_each:
        own = _whites_by_cell(contents.taken, header.white.at_cells, lamp, len(cells))
        white, xyz = own.white[index], own.xyz[index]
        drift = np.zeros((len(index), 3))
        white_noise = np.broadcast_to(lamp.white_single_std, drift.shape)
        lit = np.ones(len(index))
    else:
        white, xyz = lamp.white(times), np.array(header.white.xyz)
        lit = _cos_incidence(header.white.position) / _cosines(cells)[index]
        drift = lamp.drift(times)
    ratio = lamp.ratio(signal - lamp.dark(times), white)
    factor = xyz * lit[:, None]

    count = np.bincount(index, minlength=len(cells))
    mean = lambda rows: _mean(index, rows, len(cells))  # noqa: E731
    values = mean(factor * ratio)
    spread = np.sqrt(_mean(index, (factor * ratio - values[index]) ** 2, len(cells)))
    n = np.maximum(count, 1)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        own_std = spread * np.sqrt(n / (n - 1.0))
    single = factor * np.hypot(ratio * lamp.white_single_std, lamp.dark_single_std)
    # dark is in the white, too: d ratio / d D = (ratio − 1) / W
    dark_noise = factor * abs(1 - ratio) * np.hypot(*lamp.dark_share(times)) * lamp.dark_single_std
    budget = Budget(
        repeatability=np.where(n > 1, own_std, mean(single)) / np.sqrt(n),
        white=abs(mean(factor * ratio * white_noise)),
        dark=mean(dark_noise),
        drift=abs(mean(factor * ratio * drift)),
        scale=abs(values) * header.white.relative_std,
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
    )


class _Lamp:
    """The dark and white series of a journal, at any time; signals are `[N, C]`, C = 3 or bands."""

    def __init__(self, contents: Contents) -> None:
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
        strong = white > _WEAK_BAND * white.max(axis=-1, keepdims=True)
        ratio = np.where(strong, signal / np.where(strong, white, 1.0), 0.0)
        return (ratio @ self._weights.T) / (strong @ self._weights.T)

    def white_share(self, time_s: Floats) -> Floats:
        """`[2, N, 1]`: what the series before and after weigh, over √ of their readings."""
        return _share(time_s, self.white_time_s, self._white_count)

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
class _OwnWhites:
    white: Floats  # [cells, C] darkness subtracted; NaN where not in range
    xyz: Floats  # [cells, 3]


def _whites_by_cell(
    taken: list[Taken], at_cells: tuple[tuple[float, float, float], ...], lamp: _Lamp, cells: int
) -> _OwnWhites:
    whites = [t for t in taken if t.step.target is Target.WHITE and t.reading.range is Range.OK]
    signal = lamp.signals([t.reading for t in whites]) - lamp.dark(_times(whites))
    white = np.full((cells, signal.shape[1]), np.nan)
    white[[t.step.cell for t in whites]] = signal
    return _OwnWhites(white, np.array(at_cells))


def _sorted(
    contents: Contents,
    plan: Plan,
    lamp: _Lamp,
    values: Floats,
    budget: Budget,
    count: NDArray[np.int64],
    repeat_std: Floats,
) -> Reduced:
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

    terms = Budget(
        repeatability=valued(budget.repeatability),
        white=valued(budget.white),
        dark=valued(budget.dark),
        drift=valued(budget.drift),
        scale=valued(budget.scale),
    )
    header = contents.header
    incidence, receiving, tilt = angles[order].T
    return Reduced(
        measurement=BrdfMeasurement(
            incidence,
            receiving,
            tilt,
            values=valued(values),
            std=terms.total,
            count=rows(count, 0),
            valid=~rows(missing, True),
            metadata=Metadata(
                sample=header.sample,
                instrument=f"{header.goniometer}; {header.colorimeter}",
                simulated=header.simulated,
            ),
        ),
        budget=terms,
        over=rows(over, 0),
        under=rows(under, 0),
        excluded=rows(np.zeros(len(plan.cells), bool), True),
        spectral=lamp.wavelengths_nm is not None,
        white_level=lamp.white_level,
        white_time_s=lamp.white_time_s,
        white_single_std=lamp.white_single_std,
        repeat_std=repeat_std,
    )


def _out_of_range(contents: Contents, which: Range) -> NDArray[np.int64]:
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


def _share(time_s: Floats, at_s: Floats, counts: NDArray[np.int64]) -> Floats:
    before, after, x = _around(time_s, at_s)
    return np.stack([(1 - x) / np.sqrt(counts[before]), x / np.sqrt(counts[after])])[..., None]


def _mean(index: NDArray[np.intp], rows: Floats, cells: int) -> Floats:
    """`[cells, 3]` mean of the rows of each cell; NaN where it has none."""
    total = np.stack([np.bincount(index, column, cells) for column in rows.T], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / np.bincount(index, minlength=cells)[:, None])


def _times(taken: list[Taken]) -> Floats:
    return np.array([t.time_s for t in taken])


def _cosines(cells: Floats) -> Floats:
    radians = np.radians(cells)
    return np.asarray(np.cos(radians[:, 0]) * np.cos(radians[:, 2]))


def _cos_incidence(position: Position) -> float:
    return float(_cosines(np.array([[position.incidence_deg, 0.0, position.tilt_deg]]))[0])
