"""Which interpolator describes a measurement best?

The loss of a candidate is the mean of two ratios to trilinear on the same readings: of the RMS
error of Y, and of the mean |Δ log(1+Y)|. Readings off the grid decide where there are enough of
them. Otherwise every second node of each axis is taken as a coarser measurement, and it is scored
on the nodes between them whose indices have an odd sum (the others lie on the mirror ridge too
often). The lobes are preferred unless another scheme is clearly better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.interpolation import SCHEMES, interpolate, why_not
from raden_torch.reflectance.log_readings import LUMINANCE

LEAST_READINGS = 200
"""Fewer readings off the grid than this decide nothing."""

_TRILINEAR, _PREFERRED = "trilinear", "lobes"
_CLEARLY = 0.95


def hold_out_losses(grid: AngleGrid, values: Floats, known: Bools) -> dict[str, float]:
    """Loss by scheme, from the measurement's own nodes.

    Args:
        values: the filled grid's, `[A, R, T, 3]` XYZ.
        known: `[A, R, T]`, which nodes are measured and may be scored on.

    Returns:
        Empty where every second node is too coarse a grid for any scheme but trilinear.
    """
    coarse = grid.every_second()
    if why_not(coarse):
        return {}
    index = np.indices(values.shape[:3])
    left_out = (index % 2 == 1).any(axis=0) & (index.sum(axis=0) % 2 == 1) & known
    left_out &= coarse.contains(grid.nodes_deg())
    every_second = values[::2, ::2, ::2]
    return losses(
        ((name, interpolate(coarse, every_second, name)) for name in SCHEMES),
        grid.nodes_deg()[left_out],
        values[left_out][:, LUMINANCE],
    )


def losses(
    candidates: Iterable[tuple[str, Callable[[Floats], Floats]]], points: Floats, truth: Floats
) -> dict[str, float]:
    """Loss by name; trilinear has to be among the candidates, and gets 1.

    Args:
        candidates: names and functions from `[M, 3]` degrees to `[M, C]` reflectance factors.
        points: `[M, 3]` in degrees.
        truth: `[M]`, Y.
    """
    errors = {}
    for name, function in candidates:
        found = np.maximum(function(points)[:, LUMINANCE], 0)
        rms = float(np.sqrt(np.mean((found - truth) ** 2)))
        log = float(np.mean(abs(np.log1p(found) - np.log1p(np.maximum(truth, 0)))))
        errors[name] = (max(rms, 1e-12), max(log, 1e-12))
    rms0, log0 = errors[_TRILINEAR]
    return {name: (rms / rms0 + log / log0) / 2 for name, (rms, log) in errors.items()}


def best(found: dict[str, float]) -> str:
    """The scheme to take: the lobes, or one whose loss is clearly less; trilinear if none is."""
    if not found:
        return _TRILINEAR
    least = min(found, key=lambda name: found[name])
    return _PREFERRED if found[least] > _CLEARLY * found[_PREFERRED] else least
