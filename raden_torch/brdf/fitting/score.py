"""How far a model is from readings that it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.readings import FACTOR_PER_SR


@dataclass(frozen=True)
class Score:
    """Errors of luminance Y (a reflectance factor, perfect diffuser = 100) over readings.

    Attributes:
        readings: how many were compared.
        rms: RMS error over the 99.9 % quantile of the measured Y.
        log_error: mean |Δ log(1 + Y)|; a model's negative Y counts as 0.
    """

    readings: int
    rms: float
    log_error: float

    def __str__(self) -> str:
        return (
            f"{self.readings} readings: RMS {self.rms:.5f} of the 99.9 % quantile of Y, "
            f"mean |Δ log(1+Y)| {self.log_error:.5f}"
        )


def score(model: RadenBrdf, readings: BrdfMeasurement) -> Score:
    """Compare a model with readings, by angles, in float64.

    Raises:
        InputError: no valid reading.
    """
    return score_of(reflectance_factors(model, readings), readings)


def score_of(factors: NDArray[np.float64], readings: BrdfMeasurement) -> Score:
    """Compare predicted reflectance factors `[M, 3]` in linear RGB with readings.

    Raises:
        InputError: no valid reading.
    """
    if not readings.valid.any():
        raise InputError("score: expected a valid reading to compare with, got none")
    valid = readings.select(readings.valid)
    measured = valid.as_xyz().values[:, 1]
    to_y = np.linalg.inv(xyz_to_rgb_matrix())[1]
    predicted = factors[readings.valid] @ to_y
    error = predicted - measured
    logs = np.log1p(np.maximum(predicted, 0)) - np.log1p(np.maximum(measured, 0))
    level = float(np.quantile(measured, 0.999))
    return Score(len(valid), float(np.sqrt(np.mean(error**2)) / level), float(np.mean(abs(logs))))


def reflectance_factors(model: RadenBrdf, readings: BrdfMeasurement) -> NDArray[np.float64]:
    """The model at the geometries of readings: `[M, 3]` linear RGB, perfect diffuser = 100."""
    with torch.no_grad():
        f = model.at_angles(*angle_maps(readings))[:, :, 0]
    return f.numpy().T * FACTOR_PER_SR


def fit_form_factors(model: RadenBrdf, readings: BrdfMeasurement) -> NDArray[np.float64]:
    """`reflectance_factors` of the model's fit form: exact at the measured nodes."""
    with torch.no_grad():
        f = model.fit_form(*angle_maps(readings))[:, :, 0]
    return f.numpy().T * FACTOR_PER_SR


def angle_maps(readings: BrdfMeasurement) -> tuple[Tensor, Tensor, Tensor]:
    """Incidence, receiving and tilt of readings as maps `[1, M, 1]`, in radians and float64."""
    columns = (readings.incidence_deg, readings.receiving_deg, readings.tilt_deg)
    a, r, t = (torch.from_numpy(np.deg2rad(column))[None, :, None] for column in columns)
    return a, r, t
