"""A measurement at several sample azimuths → one model an azimuth (`AnisotropicBrdf`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.fit import FitResult, fit
from raden_torch.brdf.fitting.fit_report import FitReport
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement

_SAME_DEG = 0.25
"""Azimuths that are nearer to each other are one, as an encoder reads it."""


@dataclass(frozen=True)
class AzimuthReports:
    """How each azimuth was fitted.

    Attributes:
        each: by azimuth in degrees, in the model's order.
        period_deg: after which turn the sample is taken to look the same.
    """

    each: dict[float, FitReport]
    period_deg: float

    def __str__(self) -> str:
        parts = [f"azimuth {at:g} deg\n{report}" for at, report in self.each.items()]
        found = ", ".join(f"{at:g}" for at in self.each)
        return "\n\n".join(
            [*parts, f"azimuths {found} deg, linear between them, period {self.period_deg:g} deg"]
        )


@dataclass(frozen=True)
class AzimuthFit:
    """A fitted model that takes a tangent, and how it came about."""

    model: AnisotropicBrdf
    report: AzimuthReports


def fit_by_azimuth(measurement: BrdfMeasurement, **options: Any) -> AzimuthFit:
    """A model that takes a tangent, of readings at several sample azimuths.

    Each azimuth is fitted by itself, so each needs readings that `fit` can fit: a scan of the three
    angles, or what `assume` completes; their grids may differ. Where all azimuths lie within half a
    turn, the sample is taken to look the same after half a turn. All tables have the nodes of the
    model that has most of them.

    Args:
        options: as of `fit`.

    Raises:
        InputError: one azimuth, or readings of one that cannot be fitted.
    """
    given = measurement.azimuth_deg
    found, which = _azimuths(np.zeros(1) if given is None else given)
    if len(found) < 2:
        raise InputError(
            "measurement: expected readings at several sample azimuths, got 1; fit(m) makes a "
            "model of them"
        )
    results: list[FitResult] = []
    for place, one in enumerate(found):
        try:
            results.append(fit(measurement.select(which == place), **options))
        except InputError as error:
            raise InputError(f"sample azimuth {one:g} degrees: {error}") from None
    period = 180.0 if _within_half_a_turn(found) else 360.0
    model = AnisotropicBrdf([r.model for r in results], found.tolist(), period_deg=period)
    layout = model.layout
    for part in model:
        part.layout = layout
    at = dict(zip((float(x) % period for x in found), (r.report for r in results), strict=True))
    each = {azimuth: at[azimuth] for azimuth in model.azimuth_deg}
    return AzimuthFit(model, AzimuthReports(each, period))


def _azimuths(azimuth_deg: Floats) -> tuple[Floats, Floats]:
    """The azimuths that differ, 0…360, and which of them each reading has."""
    at = azimuth_deg % 360
    order = np.argsort(at, kind="stable")
    starts = np.diff(at[order], prepend=-np.inf) > _SAME_DEG
    number = np.empty(len(at), int)
    number[order] = np.cumsum(starts) - 1
    found = np.array([at[number == k].mean() for k in range(number.max() + 1)])
    if len(found) > 1 and found[0] + 360 - found[-1] <= _SAME_DEG:  # around 0
        number[number == len(found) - 1] = 0
        found = found[:-1]
        found[0] = 0.0
    return np.round(found, 3), number


def _within_half_a_turn(azimuth_deg: Floats) -> bool:
    """Whether a gap of more than half a turn was left."""
    gaps = np.diff(azimuth_deg, append=azimuth_deg[0] + 360)
    return bool(gaps.max() > 180)
