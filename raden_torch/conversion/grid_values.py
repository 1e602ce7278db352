"""What stands in each place of another format's grid of directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.capture.exchange.colours import of_model
from raden_torch.capture.exchange.merl import Cells
from raden_torch.capture.exchange.polar import percent_apart
from raden_torch.capture.exchange.scatter_grid import Nodes
from raden_torch.conversion.evaluation import f_r_at, in_box
from raden_torch.conversion.options import Conversion, Options
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_of_f_r
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB, XYZ
from raden_torch.reflectance.symmetry import reciprocal

BY_CELLS = "what lies between these directions (MERL's cells are read linearly)"
_DIGITS = 6


@dataclass
class GridValues:
    """Values at nodes, and where they come from.

    Attributes:
        nodes: of the grid.
        values: `[M, C]` reflectance factors; NaN where there is none.
        read, inside: `[M]`: a reading; within the measured angles.
        lost: what was lost, a phrase each.
    """

    nodes: Nodes
    values: Floats
    read: Bools
    inside: Bools
    lost: list[str]

    @classmethod
    def empty(cls, nodes: Nodes, channels: int) -> GridValues:
        nothing = np.zeros(len(nodes.above), bool)
        values = np.full((len(nodes.above), channels), np.nan)
        return cls(nodes, values, nothing, nothing.copy(), [])

    def conversion(self, name: str, lost: list[str]) -> Conversion:
        known = ~np.isnan(self.values).any(axis=1) & self.nodes.above
        other = known & ~self.read
        return Conversion(
            name,
            int(self.nodes.above.sum()),
            int((self.read & known).sum()),
            int((other & self.inside).sum()),
            int((other & ~self.inside).sum()),
            int((self.nodes.above & ~known).sum()),
            tuple(lost),
        )


def of_readings(nodes: Nodes, readings: BrdfMeasurement) -> GridValues:
    """Readings that lie on the nodes; the other nodes stay empty."""
    found = GridValues.empty(nodes, len(readings.channels))
    row = nodes.readings(readings)
    found.read = row >= 0
    found.values[found.read] = readings.values[row[found.read]]
    return found


def of_cells(nodes: Nodes, cells: Cells) -> GridValues:
    """MERL's cells as they were read."""
    found = GridValues.empty(nodes, cells.table.shape[-1])
    found.values[nodes.above] = cells.table.reshape(-1, cells.table.shape[-1])[nodes.above]
    found.read = nodes.above & ~np.isnan(found.values).any(axis=1)
    return found


def of_fitted_model(
    nodes: Nodes, model: RadenBrdf, channels: tuple[str, ...], options: Options, *,
    is_reciprocal: bool,
) -> GridValues:  # fmt: skip
    """A model at all nodes.

    Args:
        is_reciprocal: the file takes a geometry and its reciprocal for one: both have the mean.
    """
    found = GridValues.empty(nodes, len(channels))
    _fill(found, nodes.above, model, lambda f: of_model(f, channels, options.channel), options)
    if is_reciprocal:
        swapped = np.full_like(found.values, np.nan)
        angles = reciprocal(nodes.angles_deg[nodes.above])
        swapped[nodes.above] = of_model(f_r_at(model, angles), channels, options.channel)
        _average(found, np.where(np.isnan(found.values), np.nan, swapped))
    return found


def of_fit(
    nodes: Nodes, basis: BrdfMeasurement, readings: BrdfMeasurement, options: Options, *,
    is_reciprocal: bool,
) -> GridValues:  # fmt: skip
    """Readings where they lie on nodes, and what `fit` makes of them elsewhere, an azimuth of the
    sample at a time.

    Args:
        basis: the readings as they are fitted.
        readings: by their directions.
        is_reciprocal: as in `of_fitted_model`.

    Raises:
        InputError: readings of an azimuth that cannot be fitted.
    """
    found = GridValues.empty(nodes, len(readings.channels))
    cells = Cells.of(basis)
    if cells is not None:
        found.values[nodes.above] = cells(nodes.angles_deg[nodes.above])
        found.inside = np.asarray(~np.isnan(found.values).any(axis=1))
        found.lost.append(BY_CELLS)
        return found
    swapped = np.full_like(found.values, np.nan)
    schemes = set()
    rotation = np.round(nodes.rotation_deg % 360, _DIGITS)
    for turned in np.unique(rotation):
        part = basis
        if basis.azimuths > 1 and basis.azimuth_deg is not None:
            part = basis.select(np.round(basis.azimuth_deg % 360, _DIGITS) % 360 == turned)
        try:
            result = fit(part, assume=options.assume)
        except InputError as error:
            where = f"sample azimuth {turned:g} degrees: " if basis.azimuths > 1 else ""
            raise InputError(f"{where}{error}") from None
        here = nodes.above & (rotation == turned)
        _fill(found, here, result.model, lambda f: in_channels(f, readings.channels), options)
        schemes.add(result.report.interpolation)
        if is_reciprocal:
            angles = reciprocal(nodes.angles_deg[here])
            swapped[here] = in_channels(f_r_at(result.model, angles), readings.channels)
    row = np.full(len(nodes.above), -1)
    if is_reciprocal:
        _average(found, np.where(np.isnan(found.values), np.nan, swapped))
    else:
        row = nodes.readings(readings)
        found.read = row >= 0
        found.values[found.read] = readings.values[row[found.read]]
    off = len(readings) - len(np.unique(row[row >= 0]))
    how = f"a fit stands in the places: {', '.join(sorted(schemes))}"
    found.lost.append(f"{off} of {len(readings)} readings that lie on none of its places ({how})")
    return found


def _fill(
    found: GridValues,
    here: Bools,
    model: RadenBrdf,
    of: Callable[[Floats], Floats],
    options: Options,
) -> None:
    """The model's values at the nodes `here` `[M]`, in the channels that `of` makes of f_r."""
    angles = found.nodes.angles_deg[here]
    found.inside[here] = in_box(model, angles)
    found.values[here] = of(f_r_at(model, angles))
    if options.holes:
        found.values[here & ~found.inside] = np.nan


def in_channels(f_r: Floats, channels: tuple[str, ...]) -> Floats:
    """Linear RGB in 1/sr of a model of readings in `channels` → reflectance factors in these."""
    if channels == XYZ:
        return xyz_of_f_r(f_r)
    return FACTOR_PER_SR * (f_r if channels == RGB else f_r[:, 1:2])


def _average(found: GridValues, swapped: Floats) -> None:
    """Values become the mean of theirs and those of light and viewer changed, where both are
    known; how far these lie apart is said."""
    own, other = found.values, swapped
    both = ~np.isnan(own).any(axis=1) & ~np.isnan(other).any(axis=1)
    found.values = np.where(np.isnan(own).any(axis=1, keepdims=True), other, own)
    if not both.any():
        return
    mean = (own[both] + other[both]) / 2
    found.values[both] = mean
    apart = percent_apart(own[both], mean)
    if apart:
        found.lost.append(f"what is not reciprocal (values lay {apart} off the mean of both ways)")
