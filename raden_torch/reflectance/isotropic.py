"""What follows from readings of one plane, or of one view, if the sample is isotropic.

A turn of an isotropic sample in its own plane changes nothing, so the tilts t and −t are one
geometry. That leaves three angles to measure. One plane or one view tells of two of them, or one:
then reflectance is taken for a function of the half angle ∠(N, H) and the difference angle ∠(L, H)
alone, H = (L + V)/|L + V|, as Romeiro et al. (2008, "Passive Reflectometry") do. It is kriged from
the readings, and holds its nearest value where they do not reach.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Bools, Floats, Ints
from raden_torch.errors import InputError
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.log_readings import FLOOR, LogReadings
from raden_torch.reflectance.scattered import nodes_read_beside, with_noise

STEP_DEG = 5.0
GRID = AngleGrid(
    np.arange(0.0, 71.0, STEP_DEG),
    np.arange(-70.0, 71.0, STEP_DEG),
    np.arange(-70.0, 71.0, STEP_DEG),
)
"""Incidence, receiving and tilt of a derived table: the paper's."""


@dataclass(frozen=True)
class Derived:
    """A table at the nodes of a grid, of readings that tell of them by an assumption.

    Attributes:
        values: `[A, R, T, C]` reflectance factors.
        measured: `[A, R, T]`, a reading lies within half a step of the node.
        why: what was assumed, how far the readings bear it out, what it reaches; one sentence.
        std: `[A, R, T]` expected standard deviation of Y over Y; None where it is not known.
    """

    values: Floats
    measured: Bools
    why: str
    std: Floats | None = None


def derive(
    angles_deg: Floats, xyz: Floats, std: Floats | None = None, count: Ints | None = None
) -> Derived:
    """The paper's grid from readings, by half and difference angle alone.

    Args:
        angles_deg, xyz, std, count: as for `LogReadings.of`.

    Raises:
        InputError: the half angles that were read span less than a step, as in a measurement of
            the mirror direction alone.
    """
    half, difference = half_and_difference_deg(angles_deg)
    reach = Reach(half, difference)
    low, high = reach.half_limits_deg
    if high - low < STEP_DEG:
        raise InputError(
            "measurement: expected half angles (between the normal and the bisector of light and "
            f"view) over at least {STEP_DEG:g} deg, even of an isotropic sample, got "
            f"{low:.3g}…{high:.3g} deg; measure beside the mirror direction, too"
        )
    in_plane = _in_plane(half, difference)
    kriging = _on_both_sides(with_noise(LogReadings.of(in_plane, xyz, std, count))).kriged()
    missed = abs(np.exp(kriging(in_plane)) - FLOOR - xyz)
    wanted = half_and_difference_deg(GRID.nodes_deg().reshape(-1, 3))
    held = reach.nearest(*wanted)
    inside = np.hypot(held[0] - wanted[0], held[1] - wanted[1]) < STEP_DEG / 2
    values = np.maximum(np.exp(kriging(_in_plane(*held))) - FLOOR, 0)
    why = (
        "reflectance depends on the half and the difference angle alone (half angle "
        f"{low:.3g}…{high:.3g} deg and difference angle {difference.min():.3g}…"
        f"{difference.max():.3g} deg were measured; readings lie "
        f"{mean_percent(missed, xyz)} off on average); {100 * inside.mean():.0f} % of the "
        "nodes lie among these, the others hold the nearest value"
    )
    return Derived(values.reshape(*GRID.shape, -1), nodes_read_beside(GRID, angles_deg), why)


def _on_both_sides(readings: LogReadings) -> LogReadings:
    """Readings of `_in_plane` angles, and again on the other side of the mirror direction."""
    incidence, receiving, _ = readings.angles_deg.T
    other = readings.angles_deg[receiving > incidence][:, [1, 0, 2]]
    again = np.concatenate([np.arange(len(incidence)), np.flatnonzero(receiving > incidence)])
    return replace(
        readings,
        angles_deg=np.concatenate([readings.angles_deg, other]),
        logs=readings.logs[again],
        noise=readings.noise[again],
    )


def half_and_difference_deg(angles_deg: Floats) -> tuple[Floats, Floats]:
    """`[M, 3]` incidence, receiving, tilt → `[M]` ∠(N, H) and `[M]` ∠(L, H), in degrees.

    In the frame of H, of V − L and of L × V the normal is (cos u cos t, sin u cos t, sin t),
    u = (a − r)/2, and ∠(L, V) = |a + r|.
    """
    a, r, t = np.deg2rad(angles_deg).T
    across = np.hypot(np.sin((a - r) / 2) * np.cos(t), np.sin(t))
    half = np.arctan2(across, np.cos((a - r) / 2) * np.cos(t))
    return np.rad2deg(half), np.rad2deg(abs(a + r) / 2)


@dataclass(frozen=True)
class Reach:
    """The convex hull of half and difference angles that were read, `[M]` each, in degrees."""

    half_deg: Floats
    difference_deg: Floats

    @property
    def half_limits_deg(self) -> tuple[float, float]:
        return float(self.half_deg.min()), float(self.half_deg.max())

    def nearest(self, half_deg: Floats, difference_deg: Floats) -> tuple[Floats, Floats]:
        """The pair within the hull that keeps the half angle, as far as it can, and then the
        difference angle."""
        half = np.clip(half_deg, *self.half_limits_deg)
        low = np.interp(half, *_lower_hull(self.half_deg, self.difference_deg))
        high = -np.interp(half, *_lower_hull(self.half_deg, -self.difference_deg))
        return half, np.clip(difference_deg, low, high)


def _lower_hull(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The lower convex hull of points, by ascending x (Andrew's monotone chain, 1979)."""
    hull: list[tuple[float, float]] = []
    for point in sorted(zip(x.tolist(), y.tolist(), strict=True)):
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], point):
            hull.pop()
        if not hull or point[0] > hull[-1][0]:
            hull.append(point)
    xs, ys = zip(*hull, strict=True)
    return np.array(xs), np.array(ys)


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])


def _in_plane(half_deg: Floats, difference_deg: Floats) -> Floats:
    """`[M, 3]`: the geometry of tilt 0 that has these; its incidence may be negative."""
    a, r = difference_deg - half_deg, difference_deg + half_deg
    return np.stack([a, r, np.zeros_like(a)], axis=1)


def mean_percent(apart: Floats, values: Floats) -> str:
    """The mean of differences over that of values, as text."""
    size = float(abs(values).sum())
    return f"{100 * float(apart.sum()) / size:.2g} %" if size > 0 else "0 %"
