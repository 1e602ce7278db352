"""Densities on the unit square, one for each of some parameters, and the maps that they make of it.

A density is bilinear between its nodes, and linear in the parameter. Its map takes even points to
points of that density: first along y by the marginal's distribution, then along x by the
conditional one. Both are quadratic in a patch. Source: Dupuy and Jakob, An Adaptive
Parameterization for Efficient Material Acquisition and Rendering (ACM TOG 37(6), 2018); the readers
of such files do the same in single precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints


@dataclass(frozen=True, eq=False)
class Warp:
    """A density for each parameter.

    Attributes:
        parameters: rising, `[T]`.
        density: `[T, Y, X]`, of integral 1 each.
        along: the integral along x up to each node, `[T, Y, X]`.
        marginal: the integral up to each row, `[T, Y]`.
    """

    parameters: Floats
    density: Floats
    along: Floats
    marginal: Floats

    @classmethod
    def of(cls, parameters: Floats, values: Floats) -> Warp:
        """Of values ≥ 0 at the nodes, `[T, Y, X]`, of any scale; each of the T has some above 0."""
        along, whole = _integrals(values)
        values = values / whole[:, -1, None, None]
        along, whole = _integrals(values)
        return cls(parameters, values, along, whole)

    def forward(self, t: int, points: Floats) -> Floats:
        """Where the map of parameter number `t` takes points `[N, 2]` (x, y)."""
        rows, columns = self.density.shape[1:]
        s, density, along = points.clip(0, 1), self.density[t], self.along[t]
        row = np.searchsorted(self.marginal[t], s[:, 1]).clip(1, rows - 1) - 1
        below, above = along[row, -1], along[row + 1, -1]
        y = _segment((s[:, 1] - self.marginal[t][row]) * (rows - 1), below, above)
        reached = _mix(along[row], along[row + 1], y[:, None])
        x = s[:, 0] * reached[:, -1]
        column = (reached < x[:, None]).sum(1).clip(1, columns - 1) - 1
        left, right = (
            _mix(density[row, at], density[row + 1, at], y) for at in (column, column + 1)
        )
        x = x - np.take_along_axis(reached, column[:, None], 1)[:, 0]
        x = _segment(x * (columns - 1), left, right)
        return np.stack([(column + x) / (columns - 1), (row + y) / (rows - 1)], 1)

    def inverse(self, parameter: Floats, places: Floats) -> Floats:
        """The points that are taken to `places` `[N, 2]`, by the map of each one's parameter."""
        rows, columns = self.density.shape[1:]
        t, share = between(self.parameters, parameter)

        def at(table: Floats, *index: Ints | int) -> Floats:
            return _mix(table[(t, *index)], table[(t + 1, *index)], share)

        column, x = _patch(places[:, 0], columns)
        row, y = _patch(places[:, 1], rows)
        left, right = (
            _mix(at(self.density, row, c), at(self.density, row + 1, c), y)
            for c in (column, column + 1)
        )
        below, above = at(self.along, row, -1), at(self.along, row + 1, -1)
        reached = _mix(at(self.along, row, column), at(self.along, row + 1, column), y)
        reached = reached + x * (left + x * (right - left) / 2) / (columns - 1)
        up = y * (below + y * (above - below) / 2) / (rows - 1) + at(self.marginal, row)
        return np.stack([reached / _mix(below, above, y), up], 1)


def bilinear(table: Floats, places: Floats) -> Floats:
    """A table `[..., Y, X]` at places `[N, 2]` (x, y) of the unit square → `[..., N]`."""
    column, x = _patch(places[:, 0], table.shape[-1])
    row, y = _patch(places[:, 1], table.shape[-2])
    low = _mix(table[..., row, column], table[..., row, column + 1], x)
    return _mix(low, _mix(table[..., row + 1, column], table[..., row + 1, column + 1], x), y)


def between(nodes: Floats, at: Floats) -> tuple[Ints, Floats]:
    """The node before each place, and how far it is to the next, 0…1; beyond the ends, the ends."""
    low = np.searchsorted(nodes, at).clip(1, len(nodes) - 1) - 1
    return low, ((at - nodes[low]) / (nodes[low + 1] - nodes[low])).clip(0, 1)


def _integrals(values: Floats) -> tuple[Floats, Floats]:
    along = _cumulative(values)
    return along, _cumulative(along[..., -1])


def _cumulative(values: Floats) -> Floats:
    steps = (values[..., 1:] + values[..., :-1]) / (2 * (values.shape[-1] - 1))
    return np.concatenate([np.zeros_like(values[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)


def _patch(at: Floats, nodes: int) -> tuple[Ints, Floats]:
    place = at.clip(0, 1) * (nodes - 1)
    low = place.astype(np.intp).clip(0, nodes - 2)
    return low, place - low


def _segment(area: Floats, v0: Floats, v1: Floats) -> Floats:
    """How far a linear density from v0 to v1 over 0…1 has to be integrated for an area."""
    area = area.clip(0)
    root = np.sqrt((v0 * v0 + 2 * area * (v1 - v0)).clip(0))
    return (2 * area / np.maximum(v0 + root, 1e-300)).clip(0, 1)


def _mix(a: Floats, b: Floats, share: Floats) -> Floats:
    return a + share * (b - a)
