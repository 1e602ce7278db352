"""`fit`: a measurement becomes a model, and says how well."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from raden_torch.brdf.diffuse_fit import EXPONENT_BOUNDS, DiffuseParameters, fit_diffuse
from raden_torch.brdf.fill import Filled, fill
from raden_torch.brdf.model import CosineDiffuse, Provenance, RadenBrdf
from raden_torch.brdf.table import ReflectanceTable
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, ReadingGrid
from raden_torch.measurement.readings import WHITE_LEVEL

Floats = NDArray[np.float64]

_MAX_NODES = 361  # on one axis, and
_MAX_CELLS = 4_000_000  # in the table
_FACTOR_TO_F_R = 1 / (WHITE_LEVEL * np.pi)


@dataclass(frozen=True)
class FitReport:
    """What a fit did, in numbers; `str` says it in words.

    Attributes:
        cells: nodes of the table; the next four say where they come from.
        measured, from_equivalent, from_neighbours, from_diffuse: how many of the nodes.
        averaged: measured nodes at incidence 0 that were replaced by the mean over equivalents.
        asymmetry: mean |difference| between equivalent geometries at incidence 0 over their mean.
        reciprocity_mean, reciprocity_worst: |f(a,r,t) − f(reciprocal)| over the pair's mean, where
            both were measured: averaged over the cells, weighted by f, and at its worst.
        node_rms: RMS of model − measurement over the measured nodes, over the 99.9 % quantile of
            the measurement, all in the channel mean; it is not 0 only where `fit` averaged.
        diffuse_scale, diffuse_exponent: S (1/sr) and n per channel.
        diffuse_share: the diffuse part's share of the sum of all measured nodes.
        warnings: one sentence each.
    """

    cells: int
    measured: int
    from_equivalent: int
    from_neighbours: int
    from_diffuse: int
    averaged: int
    asymmetry: float
    reciprocity_mean: float
    reciprocity_worst: float
    node_rms: float
    diffuse_scale: tuple[float, float, float]
    diffuse_exponent: tuple[float, float, float]
    diffuse_share: float
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        triple = lambda values: ", ".join(f"{v:.4g}" for v in values)  # noqa: E731
        lines = [
            f"table: {self.cells} nodes, {self.measured} measured, {self.from_equivalent} from an "
            f"equivalent geometry, {self.from_neighbours} from measured neighbours, "
            f"{self.from_diffuse} from the diffuse part",
            f"incidence 0: {self.averaged} nodes averaged over their equivalents "
            f"(asymmetry {_percent(self.asymmetry)})",
            f"reciprocity: broken by {_percent(self.reciprocity_mean)} on average, "
            f"{_percent(self.reciprocity_worst)} at worst",
            f"diffuse: S = {triple(self.diffuse_scale)} 1/sr, n = {triple(self.diffuse_exponent)} "
            f"(R, G, B); {_percent(self.diffuse_share)} of all that was measured",
            f"residual at the measured nodes: {self.node_rms:.2e} of the 99.9 % quantile (RMS)",
        ]
        return "\n".join([*lines, *(f"warning: {text}" for text in self.warnings)])


@dataclass(frozen=True)
class FitResult:
    """A fitted model and how it came about."""

    model: RadenBrdf
    report: FitReport


def fit(measurement: BrdfMeasurement, *, diffuse: DiffuseParameters | None = None) -> FitResult:
    """Fit the model of Take (2012) to a measurement on a grid.

    Args:
        measurement: readings on a grid of incidence × receiving × tilt; gaps are filled.
        diffuse: the diffuse parameters, set by hand as in the paper; fitted where None.

    Returns:
        The model (float32, on the CPU) and a report.

    Raises:
        InputError: the readings do not span a grid: fewer than two values on an axis, steps without
            a common measure, or a table too large.
    """
    rgb = measurement.as_rgb()
    grid = _uniform(rgb.grid())
    f_r = grid.values * _FACTOR_TO_F_R
    measured = grid.measured
    angles = np.stack(np.meshgrid(*map(np.deg2rad, grid.axes_deg), indexing="ij"))
    parameters = diffuse or fit_diffuse(tuple(angles[:, measured]), f_r[measured])
    filled = fill(grid.axes_deg, f_r)
    model = _assemble(grid, filled, angles, parameters)
    report = _report(measurement, grid, f_r, filled, model, parameters, fitted=diffuse is None)
    meta = measurement.metadata
    model.provenance = Provenance(
        meta.sample, meta.instrument, meta.simulated, measurement.sha256, _plain(asdict(report))
    )
    return FitResult(model, report)


def _uniform(grid: ReadingGrid) -> ReadingGrid:
    """The same grid with evenly spaced axes; nodes that were not there are NaN."""
    axes, places = [], []
    for name, axis in zip(("incidence", "receiving", "tilt"), grid.axes_deg, strict=True):
        if len(axis) < 2:
            raise InputError(
                f"measurement: {name} has one value only ({axis[0]:g} deg); a model needs at least "
                "two on each of incidence, receiving and tilt"
            )
        step = _common_step(axis)
        nodes = round((axis[-1] - axis[0]) / step) + 1
        if nodes > _MAX_NODES:
            raise InputError(
                f"measurement: the {len(axis)} {name} angles have no common step of at least "
                f"{(axis[-1] - axis[0]) / (_MAX_NODES - 1):.2g} deg; measure on a regular grid"
            )
        axes.append(axis[0] + step * np.arange(nodes))
        places.append(np.rint((axis - axis[0]) / step).astype(int))
    shape = tuple(len(axis) for axis in axes)
    if np.prod(shape, dtype=np.float64) > _MAX_CELLS:
        raise InputError(
            f"measurement: a table of {' x '.join(map(str, shape))} nodes was asked for; at most "
            f"{_MAX_CELLS} are made"
        )
    values = np.full((*shape, grid.values.shape[-1]), np.nan)
    values[np.ix_(*places)] = grid.values
    return ReadingGrid(axes[0], axes[1], axes[2], values, grid.channels)


def _common_step(axis: Floats) -> float:
    """The greatest step, in whole 1e-4 degrees, that reaches every node."""
    return float(np.gcd.reduce(np.rint(np.diff(axis) * 1e4).astype(np.int64))) / 1e4


def _assemble(
    grid: ReadingGrid, filled: Filled, angles: Floats, parameters: DiffuseParameters
) -> RadenBrdf:
    diffuse = CosineDiffuse(
        *(torch.tensor(v, dtype=torch.float32) for v in (parameters.scale, parameters.exponent))
    )
    with torch.no_grad():
        part = diffuse(*(torch.from_numpy(angle)[:, None] for angle in angles))  # [A, 3, R, T]
    part_at_nodes = part.movedim(1, -1).numpy()
    total = np.where(np.isnan(filled.values), part_at_nodes, filled.values)
    a, r, t = grid.axes_deg
    table = ReflectanceTable(
        torch.from_numpy(total).float(),
        first_deg=(float(a[0]), float(r[0]), float(t[0])),
        step_deg=(float(a[1] - a[0]), float(r[1] - r[0]), float(t[1] - t[0])),
    )
    return RadenBrdf(diffuse, table)


def _report(
    measurement: BrdfMeasurement,
    grid: ReadingGrid,
    f_r: Floats,
    filled: Filled,
    model: RadenBrdf,
    parameters: DiffuseParameters,
    *,
    fitted: bool,
) -> FitReport:
    measured = grid.measured
    with torch.no_grad():
        angles = np.stack(np.meshgrid(*map(np.deg2rad, grid.axes_deg), indexing="ij"))[:, measured]
        at = [torch.from_numpy(angle)[None, :, None] for angle in angles]
        whole = model.at_angles(*at)[:, :, 0].numpy().T
        diffuse_only = model.diffuse(*at)[:, :, 0].numpy().T if model.diffuse else 0 * whole
    truth = f_r[measured]
    error = (whole - truth).mean(axis=1)
    reciprocity = reciprocity_error(grid)
    return FitReport(
        cells=int(measured.size),
        measured=int(measured.sum()),
        from_equivalent=int(filled.from_equivalent.sum()),
        from_neighbours=int(filled.from_neighbours.sum()),
        from_diffuse=int(filled.without_neighbour.sum()),
        averaged=int(filled.averaged.sum()),
        asymmetry=filled.asymmetry,
        reciprocity_mean=reciprocity[0],
        reciprocity_worst=reciprocity[1],
        node_rms=float(np.sqrt(np.mean(error**2)) / np.quantile(truth.mean(axis=1), 0.999)),
        diffuse_scale=parameters.scale,
        diffuse_exponent=parameters.exponent,
        diffuse_share=float(diffuse_only.sum() / truth.sum()),
        warnings=_warnings(measurement, filled, parameters, fitted),
    )


def _warnings(
    measurement: BrdfMeasurement, filled: Filled, parameters: DiffuseParameters, fitted: bool
) -> tuple[str, ...]:
    found = []
    at_bound = [
        f"{channel}: n = {n:g}"
        for channel, n in zip("RGB", parameters.exponent, strict=True)
        if n <= EXPONENT_BOUNDS[0] * 1.001 or n >= EXPONENT_BOUNDS[1] * 0.999
    ]
    if fitted and at_bound:
        found.append(
            f"the diffuse exponent stopped at a bound of {list(EXPONENT_BOUNDS)} "
            f"({', '.join(at_bound)}): the formula does not describe this sample's diffuse part"
        )
    invalid = int((~measurement.valid).sum())
    if invalid:
        found.append(f"{invalid} of {len(measurement)} readings are not valid and were left out")
    negative = int((measurement.values[measurement.valid] < 0).any(axis=1).sum())
    if negative:
        found.append(f"{negative} readings have a negative value (noise); they were kept")
    if filled.without_neighbour.any():
        found.append(
            f"{int(filled.without_neighbour.sum())} nodes have no measured neighbour within three "
            "steps; the diffuse part alone stands there"
        )
    return tuple(found)


def reciprocity_error(grid: ReadingGrid) -> tuple[float, float]:
    """|f − f of the reciprocal geometry|, on average and at worst; NaN where no pair was measured.

    Light and viewer change places: (a, r, t) ↔ (r, a, −t) for r ≥ 0 and (−r, −a, t) for r < 0.
    """
    a, r, t = np.meshgrid(*grid.axes_deg, indexing="ij")
    swapped = (
        np.where(r >= 0, r, -r),
        np.where(r >= 0, a, -a),
        np.where(r >= 0, -t, t),
    )
    index = []
    there = np.ones(a.shape, bool)
    for axis, angle in zip(grid.axes_deg, swapped, strict=True):
        place = np.clip(np.searchsorted(axis, angle - 1e-6), 0, len(axis) - 1)
        there &= abs(axis[place] - angle) < 1e-6
        index.append(place)
    value, other = grid.values.mean(axis=-1), grid.values[tuple(index)].mean(axis=-1)
    pair = there & ~np.isnan(value) & ~np.isnan(other)
    size = (abs(value) + abs(other))[pair] / 2
    if not pair.any() or size.sum() == 0:
        return float("nan"), float("nan")
    difference = abs(value - other)[pair]
    worst = np.max(difference / np.maximum(size, 1e-6 * size.max()))
    return float(difference.sum() / size.sum()), float(worst)


def _percent(share: float) -> str:
    return "not known" if np.isnan(share) else f"{100 * share:.3g} %"


def _plain(value: Any) -> Any:
    """JSON has no NaN: it becomes None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and np.isnan(value) else value
