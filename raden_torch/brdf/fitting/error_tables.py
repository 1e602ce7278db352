"""From the stated errors of a measurement to those of a runtime table: the fit of changed readings.

Errors that all readings share move the readings by one standard deviation, and are fitted again: so
everything between a reading and a node is in the difference, lobes and logarithms too.

Readings' own errors are independent, and there are as many as readings. Their variance at a node is
Σᵢ (∂node/∂readingᵢ · stdᵢ)², of which few terms count: a node depends on the readings beside it. So
many readings are changed at once, with signs from the rows of a Hadamard matrix that differ for the
eight readings around a cell (probing: Bekas, Kokiopoulou and Saad 2007); signs of the cells further
away are random. X, Y and Z err independently, as their standard deviations are stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from scipy.linalg import hadamard
from torch import Tensor

from raden_torch.arrays import Floats, Ints
from raden_torch.brdf.fitting.bake import at_nodes, in_parts
from raden_torch.brdf.fitting.tabulate import Tabulated, tabulate
from raden_torch.brdf.model.balance import balanced
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.reflectance_table import Pieces, corners
from raden_torch.brdf.model.runtime_table import node_angles
from raden_torch.brdf.model.table_errors import TableErrors
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.error_parts import ErrorParts, error_parts, stated_variance
from raden_torch.measurement.readings import XYZ
from raden_torch.reflectance.continuation import Continued, continued
from raden_torch.reflectance.interpolation import Interpolant, interpolate

_ROUNDS = 2
"""Of eight patterns: random signs of further cells, drawn so many times."""
_AT_ONCE = 20_000_000
"""Values of all patterns that are interpolated together."""
_LEAST_OWN = 1.0 / 3.0
"""Of a stated std, as in `error_parts`: what the white's noise may leave of it."""
_GAUSS = (0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12))
"""Two points whose mean is that over a cell."""


def check_errors(measurement: BrdfMeasurement, table: Tabulated) -> ErrorParts:
    """The errors of the valid readings, in X, Y and Z.

    Raises:
        InputError: readings without a standard deviation; readings that are kriged, or completed by
            an assumption.
    """
    stated_variance(measurement.select(measurement.valid))
    parts = error_parts(measurement, XYZ)
    if table.scattered is not None or table.assumption:
        got = "scattered ones" if table.scattered is not None else "some of an isotropic sample"
        raise InputError(
            f"std: expected readings that fill a grid by themselves, got {got}, of which the "
            "errors between the readings are not known; fit without `std`"
        )
    return parts


def error_tables(
    measurement: BrdfMeasurement,
    parts: ErrorParts,
    model: RadenBrdf,
    total: Floats,
    scheme: str,
    outside: str,
) -> TableErrors:
    """The errors of the nodes of a fitted model's runtime table.

    The diffuse part's own error is not in them: nodes that it stands in for have none.

    Args:
        measurement: what the model was fitted to.
        parts: of `check_errors`.
        total: `[A, R, T, 3]` f_r of the fit's nodes without gaps.
        scheme, outside: the fit's interpolation, and what it put beyond the measured angles.
    """
    steps = _Steps.of(measurement, model, total, scheme, outside)
    common = measurement.metadata.systematic
    shape = model.layout.shape
    zeros = [k for k in range(3) if common.zero_std_deg[k] > 0]
    shared = torch.zeros(len(zeros), *shape, 3, device="cpu")
    if zeros:
        base = steps.at_nodes(parts.values)
        for place, k in enumerate(zeros):
            change = steps.at_nodes(parts.values + parts.zeros[:, :, k]) - base
            shared[place] = torch.from_numpy(change @ steps.xyz_to_rgb.T).float().view(*shape, 3)
    std = np.sqrt(_own_variance(parts, common.white_mean_std))
    patterns = np.concatenate(list(steps.own_patterns(parts.values, std)), axis=1)
    tables = torch.from_numpy(patterns).float().reshape(*shape, -1, 3)
    own = _read_on_average(tables, torch.from_numpy(steps.xyz_to_rgb).float())
    return TableErrors(own, shared, math.hypot(common.scale_std, common.white_mean_std))


def _own_variance(parts: ErrorParts, white_mean_std: float) -> Floats:
    """`[N, 3]` without the noise of the mean white, which all readings share."""
    left = parts.variance - (white_mean_std * parts.values) ** 2
    return np.maximum(left, _LEAST_OWN**2 * parts.variance)


@dataclass(frozen=True)
class _Steps:
    """The steps of a fit, from changed readings to the nodes of the runtime table.

    Attributes:
        readings: the valid ones, in X, Y and Z.
        table: of them.
        total: `[A, R, T, 3]` factors without gaps.
        outside: as of `fit`.
        pieces: of the fit form's table, or None.
        read_from: the eight nodes of it around each of the runtime table's K, and their weights.
        shape: of the runtime table, K nodes.
        weight: `[K, 1]`, how much of a node is the fit form's table.
        xyz_to_rgb: `[3, 3]` of f_r.
    """

    readings: BrdfMeasurement
    table: Tabulated
    total: Floats
    scheme: str
    outside: str
    pieces: Pieces | None
    read_from: Sequence[tuple[Ints, Floats]]
    shape: tuple[int, int, int]
    weight: Floats
    xyz_to_rgb: Floats

    @classmethod
    def of(
        cls,
        measurement: BrdfMeasurement,
        model: RadenBrdf,
        total: Floats,
        scheme: str,
        outside: str,
    ) -> _Steps:
        readings = replace(measurement.select(measurement.valid).as_xyz(), std=None)
        table = tabulate(readings)
        angles = [angle.flatten() for angle in node_angles(model.layout)]
        assert model.table is not None
        with torch.no_grad():
            positions, weight = model.table.positions(*angles)
        a, r, t, _ = model.table.values.shape
        return cls(
            readings,
            table,
            table.channels.factors(total),
            scheme,
            outside,
            model.table.pieces,
            [(i.numpy(), w.double().numpy()) for i, w in corners((a, r, t), *positions)],
            model.layout.shape,
            weight[:, None].numpy(),
            table.channels.f_r(np.eye(3)).T,
        )

    def at_nodes(self, xyz: Floats) -> Floats:
        """`[K, 3]` factors of the table of changed readings `[N, 3]`."""
        return self._read(self._filled(xyz))

    def own_patterns(self, xyz: Floats, std: Floats) -> Iterator[Floats]:
        """`[K, 3 P]`, some patterns at a time: the change of the factors by each; their mean square
        is the variance."""
        cells = self.total.size
        count = max(1, _AT_ONCE // max(cells, 3 * len(self.weight)) - 1)
        signs = _signs(*self._places())
        for first in range(0, len(signs), count):
            changed = [self._filled(xyz + s[:, None] * std) for s in signs[first : first + count]]
            read = self._read(np.concatenate([self._filled(xyz), *changed], axis=-1))
            scale = 1 / math.sqrt(len(signs))
            yield scale * (read[:, 3:] - np.tile(read[:, :3], len(changed)))

    def _places(self) -> tuple[np.ndarray, tuple[int, ...]]:
        grid = self.table.grid
        places = np.rint(grid.positions(self.readings.angles_deg)).astype(int)
        return places, grid.shape

    def _filled(self, xyz: Floats) -> Floats:
        """`[A, R, T, 3]` factors of the nodes."""
        changed = tabulate(replace(self.readings, values=xyz))
        values = changed.channels.factors(changed.values)
        return np.where(np.isnan(values), self.total, values)

    def _read(self, factors: Floats) -> Floats:
        """`[K, C]` at the runtime table's nodes, of `[A, R, T, C]`; the fourth channel and those
        after it have the lobes of the first three."""
        inner = interpolate(self.table.grid, factors, self.scheme)
        function: Interpolant | Continued = inner
        if self.outside == "continued":
            function = continued(inner, factors)
        if self.pieces is None:
            table = in_parts(function, function.grid.nodes_deg().reshape(-1, 3))
        else:
            table = at_nodes(function, self.pieces).reshape(-1, factors.shape[-1])
        nodes = sum(weight[:, None] * table[place] for place, weight in self.read_from)
        read = torch.from_numpy(nodes * self.weight).view(*self.shape, -1)
        return balanced(read).flatten(0, 2).numpy()


def _signs(places: np.ndarray, shape: tuple[int, ...]) -> Floats:
    """`[patterns, N]` of ±1 for readings at nodes `[N, 3]`."""
    random = np.random.default_rng(0)
    row = (places % 2) @ [4, 2, 1]
    cells = tuple(n // 2 + 1 for n in shape)
    rounds = [
        hadamard(8)[:, row] * random.choice([-1.0, 1.0], cells)[tuple((places // 2).T)]
        for _ in range(_ROUNDS)
    ]
    return np.concatenate(rounds)


def _read_on_average(patterns: Tensor, xyz_to_rgb: Tensor) -> Tensor:
    """Standard deviations at nodes that make the mean between them right.

    Between two nodes whose errors are independent the table errs less than at either, so nodes that
    are read linearly hold less than their own standard deviation.

    Args:
        patterns: `[U, V, W, P, 3]` changes in X, Y and Z, whose squares add up to variances.

    Returns:
        `[U, V, W, 3]` in RGB.
    """
    mix = (xyz_to_rgb**2).T
    own = (patterns.square().sum(-2) @ mix).sqrt()
    above, below = torch.zeros_like(own), torch.zeros_like(own)
    for place in product(_GAUSS, repeat=3):
        read = torch.zeros((), device="cpu")
        straight = torch.zeros((), device="cpu")
        for w, corner in _corners(place):
            read = read + w * patterns[corner]
            straight = straight + w * own[corner]
        truth = (read.square().sum(-2) @ mix).sqrt()
        for w, corner in _corners(place):
            above[corner] += w * truth
            below[corner] += w * straight
    return torch.where(below > 0, own * above / below.clamp(min=1e-30), own)


def _corners(place: tuple[float, ...]) -> Iterator[tuple[float, tuple[slice, ...]]]:
    """The eight nodes of every cell, with their weights at a place in it."""
    for ends in product((False, True), repeat=3):
        weight = math.prod(x if end else 1 - x for x, end in zip(place, ends, strict=True))
        yield weight, tuple(slice(1, None) if end else slice(None, -1) for end in ends)
