"""Which part of the geometries does a reading belong to? The same parts wherever errors are told.

| region | geometries, each reading in the first that fits |
|---|---|
| grazing | light or viewer 60° or more from the normal |
| ridge | receiving within 10° of incidence: around the mirror direction, at any tilt |
| retro | receiving within 10° of −incidence: the viewer around the lamp |
| body | all others |
"""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Bools, Floats

REGIONS = ("ridge", "body", "grazing", "retro")

_GRAZING_COSINE = 0.5  # of 60 degrees
_NEAR_DEG = 10.0


def regions(angles_deg: Floats) -> dict[str, Bools]:
    """`[M, 3]` angles → `[M]` masks by name, in the order of `REGIONS`; each is in exactly one."""
    a, r, t = angles_deg.T
    highest = np.maximum(abs(a), abs(r))
    cosine = np.cos(np.radians(highest)) * np.cos(np.radians(t))
    grazing = cosine <= _GRAZING_COSINE + 1e-12
    ridge = ~grazing & (abs(r - a) < _NEAR_DEG)
    retro = ~grazing & ~ridge & (abs(r + a) < _NEAR_DEG)
    return {
        "ridge": ridge,
        "body": ~(grazing | ridge | retro),
        "grazing": grazing,
        "retro": retro,
    }
