"""A measurement at several sample azimuths → one model an azimuth (`AnisotropicBrdf`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement

_DIGITS = 6


def fit_by_azimuth(measurement: BrdfMeasurement, **options: Any) -> AnisotropicBrdf:
    """A model that takes a tangent, of readings at several sample azimuths.

    Each azimuth is fitted by itself, so each needs readings that `fit` can fit: a scan of the three
    angles, or what `assume` completes. Where all azimuths lie within half a turn, the sample is
    taken to look the same after half a turn.

    Args:
        options: as of `fit`.

    Raises:
        InputError: one azimuth, or readings of one that cannot be fitted.
    """
    given = measurement.azimuth_deg
    if given is None or measurement.azimuths < 2:
        raise InputError(
            "measurement: expected readings at several sample azimuths, got 1; fit(m) makes a "
            "model of them"
        )
    azimuth = np.round(given % 360, _DIGITS) % 360
    found = np.unique(azimuth)
    models = []
    for one in found:
        part = measurement.select(azimuth == one)
        try:
            models.append(fit(part, **options).model)
        except InputError as error:
            raise InputError(f"sample azimuth {one:g} degrees: {error}") from error
    period = 180.0 if found[-1] < 180 else 360.0
    return AnisotropicBrdf(models, found.tolist(), period_deg=period)
