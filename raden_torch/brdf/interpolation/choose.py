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
from numpy.typing import NDArray

from raden_torch.brdf.interpolation.kernels import Floats
from raden_torch.brdf.interpolation.lobes import Axes
from raden_torch.brdf.interpolation.schemes import SCHEMES, reconstruct, why_not

LEAST_READINGS = 200
"""Fewer readings off the grid than this decide nothing."""

_LUMINANCE = 1
_TRILINEAR, _PREFERRED = "trilinear", "lobes"
_CLEARLY = 0.95


def hold_out_losses(axes_deg: Axes, values: Floats, known: NDArray[np.bool_]) -> dict[str, float]:
    """Loss by scheme, from the measurement's own nodes.

    Args:
        axes_deg, values: the filled grid, `[A, R, T, C]`.
        known: `[A, R, T]`, which nodes are measured and may be scored on.

    Returns:
        Empty where every second node is too coarse a grid for any scheme but trilinear.
    """
    coarse: Axes = (axes_deg[0][::2], axes_deg[1][::2], axes_deg[2][::2])
    if why_not(coarse):
        return {}
    index: NDArray[np.intp] = np.indices(values.shape[:3])
    inside = np.ones(values.shape[:3], bool)
    for k, (angles, kept) in enumerate(zip(axes_deg, coarse, strict=True)):
        inside &= angles[index[k]] <= kept[-1] + 1e-9
    left_out = (index % 2 == 1).any(axis=0) & (index.sum(axis=0) % 2 == 1) & inside & known
    points = np.stack([angles[i[left_out]] for i, angles in zip(index, axes_deg, strict=True)], 1)
    truth = values[left_out][:, _LUMINANCE]
    coarse_values = values[::2, ::2, ::2]
    return losses(
        ((name, reconstruct(coarse, coarse_values, scheme)) for name, scheme in SCHEMES.items()),
        points,
        truth,
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
        found = np.maximum(function(points)[:, _LUMINANCE], 0)
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
