"""Errors by where the readings lie: inside the measured box, outside it, over the hemisphere."""

from __future__ import annotations

import numpy as np
import torch

from raden_torch import geometry
from raden_torch.bench.forms import Shader
from raden_torch.brdf.fitting.score import Score, angle_maps, score_of
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR

REGIONS = ("inside", "outside", "hemisphere")

_ON_THE_EDGE_DEG = 1e-6


def by_region(readings: BrdfMeasurement, model: RadenBrdf) -> dict[str, BrdfMeasurement]:
    """The valid readings by `REGIONS`, of which the last is all of them; no empty region."""
    low, high = np.array(model.measured_box_deg).T
    angles = readings.angles_deg
    inside = ((angles >= low - _ON_THE_EDGE_DEG) & (angles <= high + _ON_THE_EDGE_DEG)).all(axis=1)
    rows = (inside, ~inside, np.ones_like(inside))
    return {
        region: readings.select(which & readings.valid)
        for region, which in zip(REGIONS, rows, strict=True)
        if (which & readings.valid).any()
    }


def shader_score(shader: Shader, readings: BrdfMeasurement, dtype: torch.dtype) -> Score:
    """The error through vectors of a precision, rather than by exact angles."""
    vectors = (v[None].to(dtype) for v in geometry.vectors_from_angles(*angle_maps(readings)))
    f = shader(*vectors)[0, :, :, 0].double().numpy().T
    return score_of(f * FACTOR_PER_SR, readings)
