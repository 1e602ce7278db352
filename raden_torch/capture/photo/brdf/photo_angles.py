"""Normals, lights and views of pixels → degrees, through `raden_torch.geometry`."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from raden_torch.geometry import angles_from_unit_vectors


def angles_deg(
    normal: NDArray[Any], light: NDArray[Any], view: NDArray[Any]
) -> NDArray[np.float32]:
    """`[P, 3]` incidence, receiving, tilt of unit vectors `[P, 3]`, to about 1e-4 degrees."""
    maps = [
        torch.from_numpy(np.ascontiguousarray(v.T, np.float32))[:, None]
        for v in (normal, light, view)
    ]
    with torch.no_grad():
        found = torch.cat(angles_from_unit_vectors(*maps), 0)[:, 0]
    return np.ascontiguousarray(np.rad2deg(found.numpy().T))
