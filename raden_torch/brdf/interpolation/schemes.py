"""The interpolators: each turns a filled grid into a function of the angles.

All are one tensor product of a kernel per axis (`kernels.py`); they differ in what is interpolated:

| scheme | what is interpolated | kernel | along |
|---|---|---|---|
| trilinear | the values (the paper) | linear | incidence, receiving, tilt |
| log | log(ε + value) | linear | the same |
| ridge | log(ε + value) | linear | the ridge r − a, receiving, tilt |
| cubic | log(ε + value) | Akima | incidence, receiving, tilt |
| lobes | log(ε + value) less the fitted lobes | Akima | the same |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from raden_torch.brdf.interpolation.continuation import PAD, continued
from raden_torch.brdf.interpolation.kernels import Floats, Kernel, akima, linear
from raden_torch.brdf.interpolation.lobes import Axes, Lobes, fit_lobes
from raden_torch.measurement.distinct import FLOOR  # ε

Ints = NDArray[np.int64]

CAP = 1.5  # no value above this times the largest of the 27 nodes around it
_LUMINANCE = 1  # the channel that the lobes are fitted to: Y
_LEAST_NODES = 5


@dataclass(frozen=True)
class Scheme:
    """An interpolator.

    Attributes:
        log: interpolate the logarithm.
        kernel: `linear` or `akima`, the same along all axes.
        ridge: neighbouring incidences are read at the same r − a, instead of the same r.
        lobes: subtract fitted lobes first.
    """

    log: bool = False
    kernel: Kernel = linear
    ridge: bool = False
    lobes: bool = False


SCHEMES: dict[str, Scheme] = {
    "trilinear": Scheme(),
    "log": Scheme(log=True),
    "ridge": Scheme(log=True, ridge=True),
    "cubic": Scheme(log=True, kernel=akima),
    "lobes": Scheme(log=True, kernel=akima, lobes=True),
}


@dataclass(frozen=True)
class Reconstruction:
    """A grid as a function of the angles.

    Attributes:
        axes_deg: the grid's axes.
        between: what is interpolated, at positions `[M, 3]` in nodes, in some of the channels.
        log: it is the logarithm that is interpolated.
        cap: `[A, R, T, C]`, the largest value believed near each node.
        lobes: the fitted lobes, which were subtracted, or None.
    """

    axes_deg: Axes
    between: Callable[[Floats, slice], Floats]
    log: bool
    cap: Floats
    lobes: Lobes | None

    def __call__(self, angles_deg: Floats, channels: slice = slice(None)) -> Floats:
        """`[M, 3]` incidence, receiving, tilt in degrees → `[M, C]` reflectance factors ≥ 0.

        Receiving may lie two steps outside the box: the grid is followed along the ridge.
        """
        step = np.array([axis[1] - axis[0] for axis in self.axes_deg])
        low = np.array([axis[0] for axis in self.axes_deg])
        high = np.array([axis[-1] for axis in self.axes_deg])
        margin = np.array([0.0, 2.0, 0.0]) * step
        inside = np.clip(angles_deg, low - margin, high + margin)
        node = (inside - low) / step
        over = node[:, 1] - np.clip(node[:, 1], 0, len(self.axes_deg[1]) - 1)
        on_ridge = node - over[:, None] * [1.0, 1.0, 0.0]
        on_ridge[:, 0] = np.clip(on_ridge[:, 0], -1, len(self.axes_deg[0]) - 1)
        value = self.between(on_ridge, channels)
        if self.lobes is not None:
            value = value + self.lobes(*inside.T)[:, None]
        if self.log:
            value = np.exp(np.clip(value, -40, 40)) - FLOOR
        nearest = np.clip(np.rint(node).astype(int), 0, np.array(self.cap.shape[:3]) - 1)
        return np.clip(value, 0, self.cap[tuple(nearest.T)][:, channels])


@dataclass(frozen=True)
class _OnGrid:
    """Interpolation in a continued grid `[A + 2·PAD, R + 2·PAD, T + 2·PAD, C]`."""

    scheme: Scheme
    grid: Floats

    def __call__(self, node: Floats, channels: slice) -> Floats:
        grid = self.grid[..., channels]
        size = np.array(grid.shape[:3]) - 2 * PAD
        low = np.clip(np.floor(node).astype(int), 0, size - 2)
        x, y, z = (node - low).T[..., None]
        i, j, k = low.T
        kernel, near = self.scheme.kernel, range(PAD - 2, PAD + 4)
        if self.scheme.ridge:
            return _along_ridge(grid, i, j, k, x, y, z)
        if kernel is linear:
            near = range(PAD, PAD + 2)

        def line(read: Callable[[int], Floats], f: Floats) -> Floats:
            values = [read(p) for p in near]
            return kernel(values if len(values) == 6 else [values[0]] * 2 + values, f)

        return line(lambda p: line(lambda q: line(lambda o: grid[i + p, j + q, k + o], z), y), x)


def _along_ridge(
    grid: Floats, i: Ints, j: Ints, k: Ints, x: Floats, y: Floats, z: Floats
) -> Floats:
    """Linear, the two incidence planes read at the same r − a."""
    planes = []
    for p in (0, 1):
        across = y[:, 0] + p - x[:, 0]  # receiving, in nodes from j, of plane i + p
        q = np.floor(across).astype(int)
        g = (across - q)[:, None]
        rows = [
            grid[i + PAD + p, j + PAD + q + d, k + PAD] * (1 - z)
            + grid[i + PAD + p, j + PAD + q + d, k + PAD + 1] * z
            for d in (0, 1)
        ]
        planes.append(rows[0] * (1 - g) + rows[1] * g)
    return planes[0] * (1 - x) + planes[1] * x


def reconstruct(axes_deg: Axes, values: Floats, scheme: Scheme) -> Reconstruction:
    """Prepare an interpolator.

    Args:
        axes_deg: incidence, receiving, tilt; `why_not` must have nothing against them.
        values: `[A, R, T, C]` reflectance factors without gaps; the second channel is Y.

    Returns:
        A function of the angles. A scheme with lobes does without where none fits the grid.
    """
    what = np.log(FLOOR + np.maximum(values, 0)) if scheme.log else values
    lobes = fit_lobes(axes_deg, what[..., _LUMINANCE]) if scheme.lobes else None
    if lobes is not None:
        grid_angles = np.meshgrid(*axes_deg, indexing="ij")
        what = what - lobes(*grid_angles)[..., None]
    cap = CAP * maximum_filter(np.maximum(values, 0), (3, 3, 3, 1))
    grid = continued(what, mirrored=is_mirrored(axes_deg))
    return Reconstruction(axes_deg, _OnGrid(scheme, grid), scheme.log, cap, lobes)


def is_mirrored(axes_deg: Axes) -> bool:
    """True where the grid holds the equivalents (0, −r, −t) of its plane at incidence 0."""
    incidence, receiving, tilt = axes_deg
    symmetric = all(np.allclose(axis, -axis[::-1], atol=1e-6) for axis in (receiving, tilt))
    return bool(abs(incidence[0]) < 1e-6 and symmetric)


def why_not(axes_deg: Axes) -> str | None:
    """What keeps a grid from any scheme but trilinear; None where nothing does."""
    names = ("incidence", "receiving", "tilt")
    for name, axis in zip(names, axes_deg, strict=True):
        if len(axis) < _LEAST_NODES:
            return f"{name} has {len(axis)} nodes; at least {_LEAST_NODES} are needed"
    steps = [axis[1] - axis[0] for axis in axes_deg]
    if abs(steps[0] - steps[1]) > 1e-6:
        return f"incidence and receiving have different steps ({steps[0]:g} and {steps[1]:g} deg)"
    offset = (axes_deg[1][0] - axes_deg[0][0]) / steps[0]
    if abs(offset - round(offset)) > 1e-6:
        return "the mirror direction r = a does not run through nodes"
    return None
