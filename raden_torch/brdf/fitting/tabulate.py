"""Readings → a table of f_r on a uniform grid, with a note of where every node comes from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.fitting.channels import IN_RGB, Channels
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, ReadingGrid
from raden_torch.measurement.opposite_tilts import with_opposite_tilts
from raden_torch.measurement.readings import FACTOR_PER_SR, LEAST_COVERAGE
from raden_torch.reflectance.few_readings import GRID as HEMISPHERE
from raden_torch.reflectance.few_readings import all_around, from_few
from raden_torch.reflectance.gap_filling import fill
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.isotropic import GRID, Derived, derive
from raden_torch.reflectance.log_readings import LogReadings
from raden_torch.reflectance.scattered import nodes_read, on_grid, with_noise
from raden_torch.reflectance.symmetric_kriging import ASSUMPTIONS

MAX_CELLS = 4_000_000
"""In a table."""
SCATTERED_STEP_DEG = 5.0
"""The table's step where the readings have no grid of their own: the paper's."""

_MOSTLY = 0.5
"""A grid of which less than this was measured is taken for scattered readings."""
_ROUNDED_TO = (2, 1)
"""Decimals of a degree that angles beside a grid's nodes are rounded to, in this order."""
_MAX_NODES = 361  # on one axis


@dataclass(frozen=True)
class Tabulated:
    """A table and its history; all `[A, R, T]` unless stated.

    Attributes:
        grid: evenly spaced.
        values: `[A, R, T, C]` f_r in 1/sr; NaN in the nodes of `without_neighbour`.
        before_averaging: the same before equivalents at incidence 0 were averaged; NaN where no
            node has a reading of its own.
        measured: the node was measured; scattered readings: one lies within half a step.
        assumed: the node was not measured, but follows from measured ones by `assumption`.
        from_equivalent, from_neighbours, without_neighbour, averaged: see `gap_filling.Filled`.
        asymmetry: see `gap_filling.Filled`.
        reading_angles: incidence, receiving, tilt of the valid readings, `[M]` each, in radians.
        readings: `[M, C]` their f_r in 1/sr.
        scattered: the readings, where they do not lie on nodes or fill less than half of them.
        assumption: one sentence; empty where nothing was assumed.
        warnings: one sentence each.
        channels: what C stands for.
        std: expected standard deviation of Y over Y, where the table comes from few readings.
    """

    grid: AngleGrid
    values: Floats
    before_averaging: Floats
    measured: Bools
    assumed: Bools
    from_equivalent: Bools
    from_neighbours: Bools
    without_neighbour: Bools
    averaged: Bools
    asymmetry: float
    reading_angles: tuple[Floats, Floats, Floats]
    readings: Floats
    scattered: LogReadings | None
    assumption: str
    warnings: tuple[str, ...]
    channels: Channels = IN_RGB
    std: Floats | None = None


def tabulate(
    measurement: BrdfMeasurement, assume: str | None = None, channels: Channels = IN_RGB
) -> Tabulated:
    """Put readings on a table.

    Readings on a grid keep their nodes. Scattered ones, ones at several sample azimuths, and ones
    that fill less than half of their grid are kriged onto nodes 5 degrees apart.

    Args:
        assume: "isotropic": readings stand for the opposite tilt, too. Few of them, in all
            directions, become a table of the hemisphere (`reflectance.few_readings`), for which
            "isotropic+reciprocal" lets them stand for light and view exchanged, too. Where those of
            one plane or one view tell of less than half of the table, it follows from them by
            `reflectance.isotropic.derive`.
        channels: what the table holds.

    Raises:
        InputError: no valid reading, one value only on an axis, readings in fewer than 5 % of the
            cells, a table too large; an assumption that is not known or does not suffice.
    """
    if assume is None:
        return _tabulated(measurement, channels)
    if assume not in ASSUMPTIONS:
        raise InputError(f"assume: expected {' or '.join(map(repr, ASSUMPTIONS))}, got {assume!r}")
    _check_values(measurement)
    known, angles = _readings(measurement, channels)
    both, assumption = with_opposite_tilts(measurement)
    if all_around(known.angles_deg) and _evenly(both)[0] is None:
        factors, std = channels.factors_of(measurement)
        few = from_few(known.angles_deg, factors, std, known.count, assume=assume)
        return _of_derived(measurement, known, angles, channels, HEMISPHERE, few)
    _check_coverage(measurement)
    table = None if _single_valued(both) else _tabulated(both, channels)
    if table is None or table.without_neighbour.mean() > _MOSTLY:
        factors, std = channels.factors_of(measurement)
        derived = derive(known.angles_deg, factors, std, known.count)
        return _of_derived(measurement, known, angles, channels, GRID, derived)
    on_table = np.clip(known.angles_deg, table.grid.low, table.grid.high)  # encoders read past it
    read = nodes_read(table.grid, on_table)
    return replace(
        table,
        measured=table.measured & read,
        assumed=table.measured & ~read,
        reading_angles=angles,
        readings=known.values / FACTOR_PER_SR,
        assumption=assumption,
    )


def _tabulated(measurement: BrdfMeasurement, channels: Channels) -> Tabulated:
    _check_readings(measurement)
    flat = _single_valued(measurement)
    if flat:
        raise InputError(
            "measurement: expected at least two values on each of incidence, receiving and tilt, "
            f'got {flat}; if the sample is isotropic, `assume="isotropic"` derives the rest'
        )
    every, warnings = channels.of(measurement)
    known, angles = _readings(measurement, channels)
    nodes, off_deg = _evenly(every)
    if off_deg > 0:
        warnings.append(f"angles up to {off_deg:.2g} deg off a grid were taken as on it")
    scattered = None
    if nodes is None:
        grid = AngleGrid.around(known.angles_deg, SCATTERED_STEP_DEG)
        factors, std = channels.factors_of(measurement)
        scattered = with_noise(LogReadings.of(known.angles_deg, factors, std, known.count))
        kriged, measured, filled = on_grid(grid, scattered)
        start = channels.f_r(kriged)
        filled = replace(filled, values=start)
        warnings.append(_scattered_warning(known))
    else:
        grid, start, measured = nodes.axes_deg, nodes.values / FACTOR_PER_SR, nodes.measured
        filled = fill(grid, start)
    return Tabulated(
        grid=grid,
        values=filled.values,
        before_averaging=start,
        measured=measured,
        assumed=np.zeros_like(measured),
        from_equivalent=filled.from_equivalent,
        from_neighbours=filled.from_neighbours,
        without_neighbour=filled.without_neighbour,
        averaged=filled.averaged,
        asymmetry=filled.asymmetry,
        reading_angles=angles,
        readings=known.values / FACTOR_PER_SR,
        scattered=scattered,
        assumption="",
        warnings=tuple(warnings),
        channels=channels,
    )


def _nodes(every: BrdfMeasurement) -> ReadingGrid | None:
    """The evenly spaced grid that the readings fill half of; None where they lie scattered."""
    nodes = _uniform(every.grid()) if every.is_grid else None
    return nodes if nodes is not None and nodes.measured.mean() >= _MOSTLY else None


def _evenly(every: BrdfMeasurement) -> tuple[ReadingGrid | None, float]:
    """The same, also of angles as encoders read them, beside the nodes; how far at most."""
    nodes = _nodes(every)
    if nodes is not None:
        return nodes, 0.0
    for decimals in _ROUNDED_TO:
        rounded = np.round(every.angles_deg, decimals).T
        try:
            nodes = _nodes(
                replace(
                    every,
                    incidence_deg=rounded[0],
                    receiving_deg=rounded[1],
                    tilt_deg=rounded[2],
                )
            )
        except InputError:  # readings of one node contradict
            continue
        if nodes is not None:
            return nodes, float(abs(rounded.T - every.angles_deg).max())
    return None, 0.0


def _of_derived(
    measurement: BrdfMeasurement,
    known: BrdfMeasurement,
    angles: tuple[Floats, Floats, Floats],
    channels: Channels,
    grid: AngleGrid,
    derived: Derived,
) -> Tabulated:
    values = channels.f_r(derived.values)
    none = np.zeros_like(derived.measured)
    return Tabulated(
        grid=grid,
        values=values,
        before_averaging=np.full_like(values, np.nan),
        measured=derived.measured,
        assumed=~derived.measured,
        from_equivalent=none,
        from_neighbours=none,
        without_neighbour=none,
        averaged=none,
        asymmetry=float("nan"),
        reading_angles=angles,
        readings=known.values / FACTOR_PER_SR,
        scattered=None,
        assumption=derived.why,
        warnings=tuple(channels.of(measurement)[1]),
        channels=channels,
        std=derived.std,
    )


def _check_readings(measurement: BrdfMeasurement) -> None:
    _check_coverage(measurement)
    _check_values(measurement)


def _check_values(measurement: BrdfMeasurement) -> None:
    if not measurement.valid.any():
        raise InputError("measurement: expected valid readings, got none; nothing can be fitted")
    if not (measurement.values[measurement.valid] > 0).any():
        raise InputError("measurement: expected a sample that reflects, got no value above 0")


def _readings(
    measurement: BrdfMeasurement, channels: Channels
) -> tuple[BrdfMeasurement, tuple[Floats, Floats, Floats]]:
    """The valid readings; incidence, receiving and tilt of them in radians."""
    known = channels.of(measurement.select(measurement.valid))[0]
    return known, (
        np.deg2rad(known.incidence_deg),
        np.deg2rad(known.receiving_deg),
        np.deg2rad(known.tilt_deg),
    )


def _single_valued(measurement: BrdfMeasurement) -> str:
    """Which angle all valid readings share, in words; empty where there is none."""
    known = measurement.select(measurement.valid)
    for name in ("incidence", "receiving", "tilt"):
        angle = getattr(known, f"{name}_deg")
        if np.ptp(angle) < 1e-6:
            return f"one {name} only ({angle[0]:g} deg)"
    return ""


def _check_coverage(measurement: BrdfMeasurement) -> None:
    """Raise InputError for cells that are nearly all empty, with the advice that their file has."""
    share = float(measurement.valid.mean())
    if not 0 < share < LEAST_COVERAGE:
        return
    advice = dict(measurement.metadata.other).get("next", "")
    raise InputError(
        f"measurement: expected readings in at least {100 * LEAST_COVERAGE:g} % of its "
        f"{len(measurement)} cells, since the other cells are estimated from them, got "
        f"{100 * share:.1f} %; measure more" + (f", with {advice}" if advice else "")
    )


def _uniform(grid: ReadingGrid) -> ReadingGrid | None:
    """The same grid with evenly spaced axes; nodes that were not there are NaN.

    None where the angles have no common step: then they are as good as scattered.
    """
    axes, places = [], []
    for axis in grid.axes_deg:
        step = _common_step(axis)
        nodes = round((axis[-1] - axis[0]) / step) + 1
        if nodes > _MAX_NODES:
            return None
        axes.append(axis[0] + step * np.arange(nodes))
        places.append(np.rint((axis - axis[0]) / step).astype(int))
    shape = tuple(len(axis) for axis in axes)
    if np.prod(shape, dtype=np.float64) > MAX_CELLS:
        raise InputError(
            f"measurement: expected a table of at most {MAX_CELLS} nodes, got "
            f"{' x '.join(map(str, shape))}"
        )
    values = np.full((*shape, grid.values.shape[-1]), np.nan)
    values[np.ix_(*places)] = grid.values
    return ReadingGrid(axes[0], axes[1], axes[2], values, grid.channels)


def _common_step(axis: Floats) -> float:
    """The greatest step, in whole 1e-4 degrees, that reaches every node."""
    return float(np.gcd.reduce(np.rint(np.diff(axis) * 1e4).astype(np.int64))) / 1e4


def _scattered_warning(known: BrdfMeasurement) -> str:
    text = f"{len(known)} scattered readings were kriged onto a {SCATTERED_STEP_DEG:g} deg table"
    if known.azimuths > 1:
        text += (
            f"; the model knows no sample azimuth and takes all {known.azimuths} of them as one "
            "(`raden fit --by-azimuth` fits each)"
        )
    return text
