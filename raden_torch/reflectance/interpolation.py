"""The interpolators: each turns a filled grid into a function of the angles.

All are one tensor product of a kernel per axis (`kernels.py`); they differ in what is interpolated:

| scheme | what is interpolated | kernel |
|---|---|---|
| trilinear | the values (the paper) | linear |
| cubic | log(`FLOOR` + value) | Akima |
| lobes | log(`FLOOR` + value) less the fitted lobes | Akima |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from raden_torch.arrays import Floats
from raden_torch.reflectance.grid import SAME_DEG, AngleGrid
from raden_torch.reflectance.kernels import Kernel, akima, linear
from raden_torch.reflectance.lobes import Lobes, fit_lobes
from raden_torch.reflectance.log_readings import FLOOR, LUMINANCE
from raden_torch.reflectance.padding import PAD, padded

CAP = 1.5  # no value above this times the largest of the 27 nodes around it
_LEAST_NODES = 5


@dataclass(frozen=True)
class Scheme:
    """An interpolator.

    Attributes:
        log: interpolate the logarithm.
        kernel: `linear` or `akima`, the same along all axes.
        lobes: subtract fitted lobes first.
    """

    log: bool
    kernel: Kernel
    lobes: bool


SCHEMES: dict[str, Scheme] = {
    "trilinear": Scheme(False, linear, False),
    "cubic": Scheme(True, akima, False),
    "lobes": Scheme(True, akima, True),
}


@dataclass(frozen=True)
class Interpolant:
    """A grid as a function of the angles.

    Attributes:
        grid: evenly spaced.
        between: what is interpolated, at positions `[M, 3]` in nodes, in some of the channels.
        log: it is the logarithm that is interpolated.
        cap: `[A, R, T, C]`, the largest value believed near each node.
        lobes: the fitted lobes, which were subtracted, or None.
    """

    grid: AngleGrid
    between: Callable[[Floats, slice], Floats]
    log: bool
    cap: Floats
    lobes: Lobes | None

    def __call__(self, angles_deg: Floats, channels: slice = slice(None)) -> Floats:
        """`[M, 3]` incidence, receiving, tilt in degrees → `[M, C]` reflectance factors ≥ 0.

        Receiving may lie two steps outside the box: the grid is followed along the ridge.
        """
        margin = np.array([0.0, 2.0, 0.0]) * self.grid.step
        inside = np.clip(angles_deg, self.grid.low - margin, self.grid.high + margin)
        node = self.grid.positions(inside)
        over = node[:, 1] - np.clip(node[:, 1], 0, self.grid.shape[1] - 1)
        on_ridge = node - over[:, None] * [1.0, 1.0, 0.0]
        on_ridge[:, 0] = np.clip(on_ridge[:, 0], -1, self.grid.shape[0] - 1)
        value = self.between(on_ridge, channels)
        if self.lobes is not None:
            value = value + self.lobes(*inside.T)[:, None]
        if self.log:
            value = np.exp(np.clip(value, -40, 40)) - FLOOR
        nearest = np.clip(np.rint(node).astype(int), 0, np.array(self.cap.shape[:3]) - 1)
        return np.clip(value, 0, self.cap[tuple(nearest.T)][:, channels])


@dataclass(frozen=True)
class _OnGrid:
    """Interpolation in a padded grid `[A + 2·PAD, R + 2·PAD, T + 2·PAD, C]`."""

    kernel: Kernel
    grid: Floats

    def __call__(self, node: Floats, channels: slice) -> Floats:
        grid = self.grid[..., channels]
        size = np.array(grid.shape[:3]) - 2 * PAD
        low = np.clip(np.floor(node).astype(int), 0, size - 2)
        x, y, z = (node - low).T[..., None]
        i, j, k = low.T
        kernel, near = self.kernel, range(PAD - 2, PAD + 4)
        if kernel is linear:
            near = range(PAD, PAD + 2)

        def line(read: Callable[[int], Floats], f: Floats) -> Floats:
            values = [read(p) for p in near]
            return kernel(values if len(values) == 6 else [values[0]] * 2 + values, f)

        return line(lambda p: line(lambda q: line(lambda o: grid[i + p, j + q, k + o], z), y), x)


def interpolate(grid: AngleGrid, values: Floats, scheme: str) -> Interpolant:
    """Prepare an interpolator.

    Args:
        grid: `why_not` must have nothing against it, but for "trilinear".
        values: `[A, R, T, C]` reflectance factors without gaps, X, Y, Z the first three.
        scheme: of `SCHEMES`.

    Returns:
        A function of the angles. A scheme with lobes does without where none fits the grid.
    """
    chosen = SCHEMES[scheme]
    what = np.log(FLOOR + np.maximum(values, 0)) if chosen.log else values
    lobes = fit_lobes(grid, what[..., LUMINANCE]) if chosen.lobes else None
    if lobes is not None:
        what = what - lobes(*np.moveaxis(grid.nodes_deg(), -1, 0))[..., None]
    cap = CAP * maximum_filter(np.maximum(values, 0), (3, 3, 3, 1))
    between = _OnGrid(chosen.kernel, padded(what, mirrored=grid.is_mirrored))
    return Interpolant(grid, between, chosen.log, cap, lobes)


def why_not(grid: AngleGrid) -> str | None:
    """What keeps a grid from any scheme but trilinear; None where nothing does."""
    names = ("incidence", "receiving", "tilt")
    for name, axis in zip(names, grid, strict=True):
        if len(axis) < _LEAST_NODES:
            return f"{name} has {len(axis)} nodes; at least {_LEAST_NODES} are needed"
    step = grid.step
    if abs(step[0] - step[1]) > SAME_DEG:
        return f"incidence and receiving have different steps ({step[0]:g} and {step[1]:g} deg)"
    offset = (grid.low[1] - grid.low[0]) / step[0]
    if abs(offset - round(offset)) > SAME_DEG:
        return "the mirror direction r = a does not run through nodes"
    return None
