"""A model at geometries: by its fit form, in float64."""

from __future__ import annotations

import numpy as np
import torch

from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.reflectance.grid import AngleGrid

_AT_ONCE = 100_000


def f_r_at(model: RadenBrdf, angles_deg: Floats) -> Floats:
    """`[M, 3]` incidence, receiving, tilt → f_r `[M, 3]` in 1/sr, linear RGB."""
    parts = [np.zeros((0, 3))]
    with torch.no_grad():
        for begin in range(0, len(angles_deg), _AT_ONCE):
            some = np.deg2rad(angles_deg[begin : begin + _AT_ONCE])
            maps = (torch.from_numpy(x.copy())[None, :, None] for x in some.T)
            parts.append(model.fit_form(*maps)[:, :, 0].T.numpy())
    return np.concatenate(parts)


def in_box(model: RadenBrdf, angles_deg: Floats) -> Bools:
    """`[M]`: within the angles that were measured."""
    box = model.measured_box_deg
    if not box:
        return np.zeros(len(angles_deg), bool)
    return AngleGrid(*(np.array(ends) for ends in box)).contains(angles_deg)
