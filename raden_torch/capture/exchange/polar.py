"""A measurement's readings as pairs of directions, as most formats hold them.

θ_i and θ_s are polar angles of the light and of the viewer; φ is the viewer's azimuth against the
mirror's side of the plane of incidence, counter-clockwise seen from above: 0 at the mirror. Some of
our geometries are one pair of directions: at incidence 0 (0, r, t) and (0, −r, −t), and all that
look straight back at the lamp with one polar angle. Their mean stands for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Floats, group_sums
from raden_torch.capture.exchange.directions import raden_degrees
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.grid import distinct
from raden_torch.reflectance.isotropic import mean_percent

_UPRIGHT = 1e-9  # a sine up to this has no azimuth
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Polar:
    """Geometries, `[M]` each, in degrees.

    Attributes:
        incidence: θ_i, polar angle of the light.
        scatter: θ_s, polar angle of the viewer.
        azimuth: φ, 0…360, 0 where either has none.
    """

    incidence: Floats
    scatter: Floats
    azimuth: Floats


def directions(angles_deg: Floats) -> tuple[Floats, Floats]:
    """Light and view `[3, M]` of incidence, receiving and tilt `[M, 3]`; N = +z."""
    import torch

    from raden_torch.geometry import vectors_from_angles

    columns = (torch.from_numpy(np.deg2rad(x))[None, :, None] for x in angles_deg.T)
    _, light, view = vectors_from_angles(*columns)
    return light[:, :, 0].numpy(), view[:, :, 0].numpy()


def polar_of(angles_deg: Floats) -> Polar:
    """`[M, 3]` incidence, receiving and tilt → polar angles."""
    light, view = directions(angles_deg)
    across = [np.hypot(v[0], v[1]) for v in (light, view)]
    incidence, scatter = (
        np.rad2deg(np.arctan2(s, v[2])) for s, v in zip(across, (light, view), strict=True)
    )
    turn = np.arctan2(view[1], view[0]) - np.arctan2(-light[1], -light[0])
    azimuth = np.rad2deg(turn) % 360
    azimuth[(across[0] < _UPRIGHT) | (across[1] < _UPRIGHT)] = 0.0
    return Polar(incidence, scatter, azimuth)


def percent_apart(values: Floats, mean: Floats) -> str:
    """How far values lie off a mean, on average over it, as text; empty where that is rounding."""
    apart = abs(values - mean)
    return mean_percent(apart, mean) if apart.sum() > _ROUNDING * abs(mean).sum() else ""


def by_directions(
    measurement: BrdfMeasurement, *, over_azimuths: bool = False
) -> tuple[BrdfMeasurement, str]:
    """The valid readings, each pair of directions once and by the angles that it reads back to.

    Args:
        over_azimuths: one at several azimuths of the sample is one, too.

    Returns:
        The readings without standard deviations and counts, and what became one, in one sentence;
        empty where nothing did.

    Raises:
        InputError: no valid reading, or one from at or below the horizon.
    """
    known = measurement.select(measurement.valid)
    if not len(known):
        raise InputError("measurement: expected valid readings, got none")
    light, view = directions(known.angles_deg)
    below = (light[2] < _UPRIGHT) | (view[2] < _UPRIGHT)
    if below.all():
        raise InputError("measurement: expected readings from above the horizon, got none")
    known, light, view = known.select(~below), light[:, ~below], view[:, ~below]
    angles = np.stack(raden_degrees(light, view), axis=1)
    if over_azimuths or known.azimuth_deg is None:
        turned, key = None, angles
    else:
        turned, key = known.azimuth_deg, np.column_stack([angles, known.azimuth_deg % 360])
    cells, cell = distinct(key)
    number = np.bincount(cell)
    first = np.full(len(cells), len(known))
    np.minimum.at(first, cell, np.arange(len(known)))
    order = np.argsort(first)  # as they were read
    mean = group_sums(known.values, cell, len(cells)) / number[:, None]
    alone = number == 1
    mean[alone] = known.values[first[alone]]
    rows = first[order]
    kept = replace(
        known.select(rows),
        **dict(zip(("incidence_deg", "receiving_deg", "tilt_deg"), angles[rows].T, strict=True)),
        azimuth_deg=None if turned is None else turned[rows],
        values=mean[order],
        std=None,
        count=None,
    )
    parts = []
    if below.any():
        parts.append(f"{int(below.sum())} readings from the horizon")
    if not alone.all():
        row = ~alone[cell]
        apart = percent_apart(known.values[row], mean[cell][row])
        parts.append(
            f"{int(row.sum())} readings of {int((~alone).sum())} pairs of directions became their "
            f"means ({f'they lay {apart} off' if apart else 'which they equal'})"
        )
    return kept, "; ".join(parts)
