"""What the angles and values of a J&C RT-300S mean; its workbook and its exports share it.

**Geometry.** The sample lies on a stage. The detector moves in one fixed vertical plane
(Receive, −80…80, and beyond the horizon for transmission); the lamp's arm turns about the
vertical by Azimuth, −90…90, and leans by Incidence. With x in the detector's plane and N = z, V
= (sin R, 0, cos R) and L = (sin I sin A, sin I cos A, cos I): the detector's plane is the plane
of incidence at azimuth ∓90, not at 0. At −90 the mirror is at R = I, at +90 at R = −I; at 0 the
lamp stands across.

**The sample's azimuth.** The lamp turns and the sample stays, so Azimuth is also the rotation of
the sample against the plane of incidence: `azimuth_deg` holds it, with the instrument's own
zero. Where the detector stands out of the plane of incidence is geometry, and is in the tilt.
How far the stage was turned by hand before is in no file (at most in its name).

**Quantity.** RT is relative to a calibrated diffuser seen along its normal (lamp at 8 degrees):
1 for the perfect reflecting diffuser there. The detector gathers flux, which falls with cos R
for a diffuser, so the instrument's users take f_r = RT/(π cos R); the reflectance factor then is
100 RT/cos R. No blank (stray light) is taken off, and the dark level drifts: values may be
negative.

**Hidden lamp.** Within 4 degrees of the lamp the detector hides it and RT falls to nothing.
These readings are kept but not valid.

Source: M. Duque, "BRDF Data Collection and Post-Processing for Various Black Paints" (2025),
§2.1 to §3.2 and eq. (6); the frame is that of ua-loft/bsdf-tools.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import measurement_of
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata

INSTRUMENT = "J&C RT-300S"
LASER_NM = 650.0
"""The lamp's wavelength in the files seen so far; no file names it."""
HIDDEN_WITHIN_DEG = 4.0
"""Light and viewer closer than this: the detector hides the lamp (at 3.5 degrees, not at 5)."""

_TRACE_RAD = 1e-11  # rounds to 0 degrees in the measurement
_SMALLEST_COSINE = 0.01  # beyond 89.4 degrees RT/cos R says nothing


@dataclass(frozen=True)
class RtTable:
    """One incidence of an export: `percent[r, a]` is 100 RT at receive `r` and azimuth `a`."""

    incidence_deg: float
    receive_deg: list[float]
    azimuth_deg: list[float]
    percent: list[list[float]]


def rt300s_measurement(
    path: Path,
    azimuth_deg: Floats,
    incidence_deg: Floats,
    receive_deg: Floats,
    percent: Floats,
    channels: tuple[str, ...],
    *,
    metadata: Metadata,
    measured: NDArray[np.bool_] | None = None,
) -> BrdfMeasurement:
    """A measurement of the instrument's angles `[M]` and of 100 RT `[M, C]`.

    Args:
        measured: `[M]`, False where a value is only a placeholder; such readings are not valid.
    """
    azimuth, incidence, receive = map(np.deg2rad, (azimuth_deg, incidence_deg, receive_deg))
    light = _to_lamp(azimuth, incidence)
    view = np.stack([np.sin(receive), np.zeros_like(receive), np.cos(receive)])
    hidden = np.linalg.norm(light - view, axis=0) < 2 * np.sin(np.deg2rad(HIDDEN_WITHIN_DEG) / 2)
    grazing = view[2] < _SMALLEST_COSINE
    view[2, grazing] = -1.0  # left out, with what is below the horizon
    notes = [*metadata.notes, "no blank (stray light) was subtracted"]
    if hidden.any():
        notes.append(f"{int(hidden.sum())} readings where the detector hides the lamp, not valid")
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        values = percent / np.where(grazing, 1.0, view[2])[:, None]
    return measurement_of(
        path,
        light,
        view,
        values,
        channels,
        metadata=replace(metadata, instrument=INSTRUMENT, notes=tuple(notes)),
        azimuth_deg=azimuth_deg,
        valid=~hidden if measured is None else ~hidden & measured,
    )


def _to_lamp(azimuth: Floats, incidence: Floats) -> Floats:
    """`[3, M]` directions of angles `[M]` in radians.

    At incidence 0 the lamp is put a trace off the normal, on its arm's side: receive ±R of one
    azimuth stay two geometries, as they are at every other incidence. (Where the arm stands across
    the detector's plane it has no such side; there that of azimuth −90 is taken.)
    """
    upright = incidence < _TRACE_RAD
    sideless = upright & (abs(np.sin(azimuth)) < 1e-6)
    azimuth = np.where(sideless, -np.pi / 2, azimuth)
    across = np.where(upright, _TRACE_RAD, np.sin(incidence))
    return np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.cos(incidence)])


def measurement_of_tables(path: Path, tables: list[RtTable], metadata: Metadata) -> BrdfMeasurement:
    """A measurement of an export's tables; a table of zeros only is a placeholder.

    Raises:
        InputError: every table is a placeholder, or two that are not hold the same geometry.
    """
    measured = [any(any(row) for row in table.percent) for table in tables]
    if not any(measured):
        raise InputError(f"{path}: expected a measurement, got values that are all 0")
    notes = list(metadata.notes)
    notes.append(f"the lamp's wavelength is not in the file, taken as {LASER_NM:g} nm")
    if not all(measured):
        empty = len(tables) - sum(measured)
        notes.append(f"{empty} of {len(tables)} tables hold only zeros, not valid")
    rows = np.array(
        [
            (azimuth, table.incidence_deg, receive, value, has_values)
            for table, has_values in zip(tables, measured, strict=True)
            for receive, row in zip(table.receive_deg, table.percent, strict=True)
            for azimuth, value in zip(table.azimuth_deg, row, strict=True)
        ]
    )
    azimuth, incidence, receive, percent, has_values = rows.T
    return rt300s_measurement(
        path,
        azimuth,
        incidence,
        receive,
        percent[:, None],
        (f"{LASER_NM:g}nm",),
        metadata=replace(metadata, notes=tuple(notes)),
        measured=has_values.astype(bool),
    )
