"""A grid of directions: sample rotation × incidence × azimuth × radial angle of the viewer.

Azimuth and radial angle are polar angles about an axis: the *normal* (azimuth 0 is the mirror's
side of the plane of incidence, counter-clockwise seen from above), or the *specular* direction S,
as Zemax has it (azimuth 0 points from S towards the normal, counter-clockwise looking at the
sample).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from raden_torch.arrays import Bools, Floats, Ints
from raden_torch.capture.exchange.directions import raden_degrees
from raden_torch.capture.exchange.polar import directions, polar_of
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.symmetry import canonical

About = Literal["normal", "specular"]

_SAME_DEG = 5e-4  # a reading so near a node is of it
_DIGITS = 4  # of angles that axes are found by
_MEAN_DIGITS = 8
_MOSTLY = 0.5  # of a grid's nodes above the horizon: then the readings lie on it
_HORIZON = 1e-9
_POLE_DEG = 1e-3  # nearer the axis no azimuth is known


@dataclass(frozen=True)
class Nodes:
    """Geometries that a file has a place for, `[M]`, in the order of the file.

    Attributes:
        angles_deg: `[M, 3]` incidence, receiving, tilt; meaningless where not `above`.
        rotation_deg: the sample's azimuth.
        above: light and viewer are above the horizon.
    """

    angles_deg: Floats
    rotation_deg: Floats
    above: Bools

    @classmethod
    def of(cls, light: Floats, view: Floats, rotation_deg: Floats) -> Nodes:
        """Of directions `[3, M]`."""
        above = (light[2] > _HORIZON) & (view[2] > _HORIZON)
        angles = np.zeros((len(above), 3))
        angles[above] = np.stack(raden_degrees(light[:, above], view[:, above]), axis=1)
        return cls(angles, rotation_deg, above)

    def readings(self, measurement: BrdfMeasurement) -> Ints:
        """`[M]` which reading is of each node; −1 where none is."""
        from scipy.spatial import cKDTree

        found = np.full(len(self.above), -1, np.intp)
        own = np.zeros(len(measurement))
        if measurement.azimuth_deg is not None:
            own = np.round(measurement.azimuth_deg % 360, _DIGITS) % 360
        wanted = np.round(self.rotation_deg % 360, _DIGITS) % 360
        readings, nodes = canonical(measurement.angles_deg), canonical(self.angles_deg)
        for rotation in np.unique(wanted):
            here = np.flatnonzero(self.above & (wanted == rotation))
            rows = np.flatnonzero(own == rotation)
            if len(here) and len(rows):
                far, near = cKDTree(readings[rows]).query(
                    nodes[here], distance_upper_bound=_SAME_DEG
                )
                there = np.isfinite(far)
                found[here[there]] = rows[near[there]]
        return found


@dataclass(frozen=True)
class ScatterGrid:
    """Four ascending axes in degrees; the last varies fastest in files."""

    rotation_deg: Floats
    incidence_deg: Floats
    azimuth_deg: Floats
    radial_deg: Floats
    about: About

    @property
    def shape(self) -> tuple[int, int, int, int]:
        axes = (self.rotation_deg, self.incidence_deg, self.azimuth_deg, self.radial_deg)
        a, b, c, d = map(len, axes)
        return a, b, c, d

    def nodes(self) -> Nodes:
        axes = (self.rotation_deg, self.incidence_deg, self.azimuth_deg, self.radial_deg)
        rotation, *angles = (x.ravel() for x in np.meshgrid(*axes, indexing="ij"))
        light, view = light_and_view(*map(np.deg2rad, angles), about=self.about)
        return Nodes.of(light, view, rotation)

    def totals(self, f_r: Floats) -> Floats:
        """∫ f cos θ dω of values `[M, C]` in 1/sr, `[rotation, incidence, C]`: the total
        integrated scatter, by the trapezoidal rule; what is not known counts as 0."""
        table = np.nan_to_num(f_r).reshape(*self.shape, -1)
        incidence, azimuth, radial = np.meshgrid(
            np.deg2rad(self.incidence_deg),
            np.deg2rad(self.azimuth_deg),
            np.deg2rad(self.radial_deg),
            indexing="ij",
        )
        angles = (incidence.ravel(), azimuth.ravel(), radial.ravel())
        _, view = light_and_view(*angles, about=self.about)
        weight = np.maximum(view[2], 0) * np.sin(angles[2])
        weight = weight.reshape(incidence.shape) * _trapezoid(np.deg2rad(self.radial_deg))
        around = _trapezoid(np.deg2rad(self.azimuth_deg), 2 * np.pi)
        if len(around) > 1 and self.azimuth_deg[-1] <= 180:
            around = 2 * _trapezoid(np.deg2rad(self.azimuth_deg))
        return np.asarray(np.einsum("riapc,iap,a->ric", table, weight, around))

    def half(self, f_r: Floats) -> tuple[ScatterGrid, Floats] | None:
        """One side of the plane of incidence, azimuths 0…180, where the other is its mirror image
        in values `[M, C]`; None where it is not."""
        azimuth = self.azimuth_deg
        gap = abs((azimuth[:, None] + azimuth + 180) % 360 - 180)
        twin = gap.argmin(axis=1)
        if (gap.min(axis=1) > _SAME_DEG).any():
            return None
        table = f_r.reshape(*self.shape, -1)
        if not np.allclose(table, table[:, :, twin], rtol=1e-9, atol=0, equal_nan=True):
            return None
        side = azimuth <= 180 + _SAME_DEG
        grid = replace(self, azimuth_deg=azimuth[side])
        return grid, table[:, :, side].reshape(-1, f_r.shape[1])

    @classmethod
    def regular(cls, step_deg: float, about: About, rotation_deg: Floats) -> ScatterGrid:
        """Every `step_deg` in incidence and azimuth; half of it, and a tenth near the axis of
        specular angles, in the radial angle. All directions up to 85 degrees of incidence.

        Raises:
            InputError: no such step.
        """
        if not 0 < step_deg <= 45:
            raise InputError(f"step_deg: expected above 0 and up to 45 degrees, got {step_deg:g}")
        incidence = np.arange(0.0, 85 + 1e-9, step_deg)
        azimuth = np.arange(0.0, 360 - 1e-9, step_deg)
        if about == "normal":
            radial = np.arange(0.0, 90 - 1e-9, step_deg / 2)
            return cls(rotation_deg, incidence, azimuth, radial, about)
        fine = step_deg / 10 * np.arange(20)
        radial = np.arange(2 * step_deg, 90 + incidence[-1] + 1e-9, step_deg / 2)
        return cls(rotation_deg, incidence, azimuth, np.concatenate([fine, radial]), about)

    @classmethod
    def through(cls, measurement: BrdfMeasurement, about: About) -> ScatterGrid | None:
        """The grid that readings of `by_directions` lie on; None where they fill none by half."""
        polar = polar_of(measurement.angles_deg)
        azimuth, radial = polar.azimuth, polar.scatter
        if about == "specular":
            azimuth, radial = _about_specular(measurement.angles_deg)
        rotation = np.zeros(len(measurement))
        if measurement.azimuth_deg is not None:
            rotation = measurement.azimuth_deg % 360
        turned = (radial > _POLE_DEG) & (polar.incidence > _POLE_DEG)
        columns = (rotation, polar.incidence, (azimuth % 360)[turned], radial)
        axes = [_distinct(column, 360 if i in (0, 2) else 0) for i, column in enumerate(columns)]
        if not len(axes[2]):
            axes[2] = np.zeros(1)
        if np.prod([len(a) for a in axes], dtype=np.float64) > 10 * len(measurement) + 1000:
            return None
        grid = cls(axes[0], axes[1], axes[2], axes[3], about)
        nodes = grid.nodes()
        read = nodes.readings(measurement) >= 0
        used = np.unique(nodes.readings(measurement)[read])
        filled = read.sum() >= _MOSTLY * nodes.above.sum()
        return grid if filled and len(used) == len(measurement) else None


def light_and_view(
    incidence: Floats, azimuth: Floats, radial: Floats, *, about: About
) -> tuple[Floats, Floats]:
    """Light and view `[3, M]` of angles `[M]` in radians; the plane of incidence is xz, the light
    on the side of −x."""
    zero = np.zeros_like(incidence)
    light = np.stack([-np.sin(incidence), zero, np.cos(incidence)])
    if about == "normal":
        sine = np.sin(radial)
        return light, np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(radial)])
    specular, to_normal, across = _specular_frame(incidence)
    view = np.cos(radial) * specular + np.sin(radial) * (
        np.cos(azimuth) * to_normal + np.sin(azimuth) * across
    )
    return light, view


def _specular_frame(incidence: Floats) -> tuple[Floats, Floats, Floats]:
    zero = np.zeros_like(incidence)
    specular = np.stack([np.sin(incidence), zero, np.cos(incidence)])
    to_normal = np.stack([-np.cos(incidence), zero, np.sin(incidence)])
    return specular, to_normal, np.stack([zero, zero - 1, zero])  # specular × to_normal


def _about_specular(angles_deg: Floats) -> tuple[Floats, Floats]:
    """`[M]` azimuth and radial angle about the specular direction, in degrees."""
    light, view = directions(angles_deg)
    turn = np.arctan2(-light[1], -light[0])
    x, y = np.cos(turn), np.sin(turn)
    view = np.stack([x * view[0] + y * view[1], x * view[1] - y * view[0], view[2]])
    frame = _specular_frame(np.arctan2(np.hypot(light[0], light[1]), light[2]))
    along, up, across = ((view * axis).sum(axis=0) for axis in frame)
    return np.rad2deg(np.arctan2(across, up)), np.rad2deg(np.arctan2(np.hypot(up, across), along))


def _trapezoid(axis: Floats, period: float = 0.0) -> Floats:
    """The weight of each node of an ascending axis, which goes round where it has a period."""
    if len(axis) == 1:
        return np.array([period or 1.0])
    steps = np.diff(axis)
    if period:
        steps = np.append(steps, period - (axis[-1] - axis[0]))
        return np.asarray((steps + np.roll(steps, 1)) / 2)
    return np.asarray((np.append(steps, 0) + np.insert(steps, 0, 0)) / 2)


def _distinct(angles: Floats, period: float) -> Floats:
    """The angles that occur, ascending; those a rounding apart are their mean."""
    rounded = np.round(angles, _DIGITS) + 0.0
    place = rounded % period if period else rounded
    found, index = np.unique(place, return_inverse=True)
    if not len(found):
        return found
    group = np.concatenate([[0], np.cumsum(np.diff(found) > 2 * _SAME_DEG)])[index]
    exact = angles - rounded + place
    mean = np.bincount(group, exact) / np.bincount(group)
    return np.asarray(np.round(np.maximum(mean, 0.0), _MEAN_DIGITS) + 0.0, np.float64)
