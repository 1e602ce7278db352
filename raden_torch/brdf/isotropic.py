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

from raden_torch.brdf.fill import Bools, Floats
from raden_torch.brdf.interpolation.lobes import Axes
from raden_torch.brdf.scattered import nodes_read, with_noise
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.distinct import FLOOR, DistinctReadings, distinct_readings

STEP_DEG = 5.0
AXES_DEG: Axes = (
    np.arange(0.0, 71.0, STEP_DEG),
    np.arange(-70.0, 71.0, STEP_DEG),
    np.arange(-70.0, 71.0, STEP_DEG),
)
"""Incidence, receiving and tilt of a derived table: the paper's."""

_SAME_DEG = 6  # decimals


@dataclass(frozen=True)
class Derived:
    """A table at the nodes of `AXES_DEG`.

    Attributes:
        values: `[A, R, T, 3]` XYZ reflectance factors.
        measured: `[A, R, T]`, a reading lies within half a step of the node.
        why: what was assumed, how far the readings bear it out, what it reaches; one sentence.
    """

    values: Floats
    measured: Bools
    why: str


def with_opposite_tilts(measurement: BrdfMeasurement) -> tuple[BrdfMeasurement, str]:
    """Every reading at both its tilt and the opposite one; where both were read, their mean.

    Returns:
        The valid readings, without azimuths, and what was assumed, in one sentence.
    """
    known = measurement.select(measurement.valid)
    geometry = np.stack([known.incidence_deg, known.receiving_deg, abs(known.tilt_deg)], axis=1)
    distinct, index = np.unique(np.round(geometry, _SAME_DEG), axis=0, return_inverse=True)
    index = index.ravel()
    weight = np.ones(len(known)) if known.count is None else np.maximum(known.count, 1.0)
    total = np.bincount(index, weight)

    def mean(columns: Floats, power: int = 1) -> Floats:
        sums = [np.bincount(index, weight**power * column) for column in columns.T]
        return np.asarray(np.stack(sums, axis=1) / total[:, None] ** power)

    values = mean(known.values)
    both = np.flatnonzero(distinct[:, 2] > 0)
    rows = np.concatenate([np.arange(len(distinct)), both])
    sign = np.where(np.arange(len(rows)) < len(distinct), 1.0, -1.0)
    std = None if known.std is None else np.sqrt(mean(known.std**2, 2))
    count = None if known.count is None else np.bincount(index, known.count).astype(np.int64)
    whole = replace(
        known,
        incidence_deg=distinct[rows, 0],
        receiving_deg=distinct[rows, 1],
        tilt_deg=sign * distinct[rows, 2],
        values=values[rows],
        azimuth_deg=None,
        std=None if std is None else std[rows],
        count=None if count is None else count[rows],
        valid=np.ones(len(rows), bool),
    )
    apart = _percent(abs(known.values - values[index]), values[index])
    return whole, f"tilts t and -t are one geometry (readings lie {apart} off their mean)"


def derive(xyz: BrdfMeasurement) -> Derived:
    """The paper's grid from readings of XYZ, by half and difference angle alone.

    Raises:
        InputError: the half angles that were read span less than a step, as in a measurement of
            the mirror direction alone.
    """
    known = xyz.select(xyz.valid)
    angles = np.stack([known.incidence_deg, known.receiving_deg, known.tilt_deg], axis=1)
    half, difference = half_and_difference_deg(angles)
    reach = Reach(half, difference)
    low, high = reach.half_limits_deg
    if high - low < STEP_DEG:
        raise InputError(
            "measurement: its half angles, between the normal and the bisector of light and view, "
            f"span {low:.3g}…{high:.3g} deg; even of an isotropic sample a model needs "
            f"{STEP_DEG:g} deg of them; measure beside the mirror direction, too"
        )
    readings = with_noise(distinct_readings(known, _in_plane(half, difference)))
    kriging = _on_both_sides(readings).kriged()
    missed = abs(np.exp(kriging(_in_plane(half, difference))) - FLOOR - known.values)
    nodes = np.stack(np.meshgrid(*AXES_DEG, indexing="ij"), axis=-1)
    wanted = half_and_difference_deg(nodes.reshape(-1, 3))
    held = reach.nearest(*wanted)
    inside = np.hypot(held[0] - wanted[0], held[1] - wanted[1]) < STEP_DEG / 2
    values = np.maximum(np.exp(kriging(_in_plane(*held))) - FLOOR, 0)
    why = (
        "reflectance depends on the half and the difference angle alone (half angle "
        f"{low:.3g}…{high:.3g} deg and difference angle {difference.min():.3g}…"
        f"{difference.max():.3g} deg were measured; readings lie "
        f"{_percent(missed, known.values)} off on average); {100 * inside.mean():.0f} % of the "
        "nodes lie among these, the others hold the nearest value"
    )
    inner = (abs(angles) <= [axis[-1] + STEP_DEG / 2 for axis in AXES_DEG]).all(axis=1)
    measured = nodes_read(AXES_DEG, angles[inner])
    return Derived(values.reshape(*nodes.shape[:3], 3), measured, why)


def _on_both_sides(readings: DistinctReadings) -> DistinctReadings:
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


def _percent(apart: Floats, values: Floats) -> str:
    size = float(abs(values).sum())
    return f"{100 * float(apart.sum()) / size:.2g} %" if size > 0 else "0 %"
