"""Directions to the light and to the viewer, and reflectance factors, become a measurement.

The instruments' files give polar angles; `raden_torch.geometry` alone knows how two directions
become incidence, receiving and tilt.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raden_torch.arrays import Floats
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata

NOMINAL_NM = 550.0
"""The band of a file that holds one wavelength and does not say which (a note says so)."""
ONE_BAND = (f"{NOMINAL_NM:g}nm",)
"""The channels of such a file."""

_ANGLES = ("incidence_deg", "receiving_deg", "tilt_deg")
_HORIZON = 1e-9  # cosines up to this are at or below the horizon
_ANGLE_DIGITS = 8  # rounding of angles in degrees: 10 instead of 9.999999999999998


def unit_vectors(polar_deg: ArrayLike, azimuth_deg: ArrayLike) -> Floats:
    """`[3, M]` directions in the frame with N = +z; a negative polar angle is the other side."""
    polar, azimuth = np.broadcast_arrays(np.deg2rad(polar_deg), np.deg2rad(azimuth_deg))
    return np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )


def raden_degrees(light: Floats, view: Floats) -> tuple[Floats, Floats, Floats]:
    """Incidence, receiving and tilt in degrees, `[M]` each, of `[3, M]` directions; N = +z."""
    import torch

    from raden_torch.geometry import raden_angles

    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64, device="cpu")[:, None, None]
    angles = raden_angles(normal, *(torch.from_numpy(v.copy())[:, None, :] for v in (light, view)))
    incidence, receiving, tilt = (
        np.round(np.rad2deg(angle.reshape(-1).numpy()), _ANGLE_DIGITS) + 0.0 for angle in angles
    )
    return incidence, receiving, tilt


def measurement_of(
    path: Path,
    light: Floats,
    view: Floats,
    values: Floats,
    channels: tuple[str, ...],
    *,
    metadata: Metadata,
    azimuth_deg: Floats | None = None,
    valid: NDArray[np.bool_] | None = None,
    average_repeats: bool = False,
) -> BrdfMeasurement:
    """A measurement of directions `[3, M]` and reflectance factors `[M, C]`.

    What lies at or below the horizon is left out, negative values stay; the notes count both.

    Args:
        azimuth_deg: `[M]` the sample's rotation against the plane of incidence; all 0 means that
            the file knows none.
        average_repeats: average readings of one geometry, and keep their count: polar grids repeat
            a direction at their pole, and any azimuth is the same geometry at normal incidence.

    Raises:
        InputError: no reading is above the horizon, or what `BrdfMeasurement` refuses.
    """
    notes = list(metadata.notes)
    seen = _above_horizon(path, light, view, notes)
    if azimuth_deg is not None and not azimuth_deg.any():
        azimuth_deg = None
    angles = raden_degrees(light[:, seen], view[:, seen])
    columns: dict[str, Any] = {
        **dict(zip(_ANGLES, angles, strict=True)),
        "values": values[seen],
        "azimuth_deg": None if azimuth_deg is None else azimuth_deg[seen],
        "valid": None if valid is None else valid[seen],
    }
    try:
        made = BrdfMeasurement(
            **(_averaged(columns, notes) if average_repeats else columns), channels=channels
        )
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix('measurement: ')}") from None
    negative = int((made.values < 0).sum())
    if negative:
        notes.append(f"{negative} of {made.values.size} values are negative (noise) and kept")
    return replace(made, metadata=replace(metadata, notes=tuple(notes)))


def _above_horizon(path: Path, light: Floats, view: Floats, notes: list[str]) -> NDArray[np.bool_]:
    seen: NDArray[np.bool_] = (light[2] > _HORIZON) & (view[2] > _HORIZON)
    if not seen.any():
        raise InputError(
            f"{path}: expected a reflection measurement, got {len(seen)} readings, in none of "
            "which both the light and the viewer are above the horizon"
        )
    if not seen.all():
        notes.append(f"{int((~seen).sum())} readings from at or below the horizon left out")
    return seen


def _averaged(columns: dict[str, Any], notes: list[str]) -> dict[str, Any]:
    """The columns with readings of one geometry averaged, in the order of first appearance."""
    angles = [columns[name] for name in (*_ANGLES, "azimuth_deg")]
    key = np.round(np.stack([angle for angle in angles if angle is not None], axis=1), 6)
    _, first, group, count = np.unique(
        key, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    if len(first) == len(key):
        return columns
    values = columns["values"]
    total = np.zeros((len(first), values.shape[1]))
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused later
        np.add.at(total, group.reshape(-1), values)
        mean = np.where((count == 1)[:, None], values[first], total / count[:, None])
    order = np.argsort(first)
    rows = first[order]
    notes.append(
        f"{int(count[count > 1].sum())} readings averaged in {int((count > 1).sum())} geometries "
        "that occur more than once"
    )
    kept = {k: None if v is None else v[rows] for k, v in columns.items() if k != "values"}
    return {**kept, "values": mean[order], "count": count[order]}
