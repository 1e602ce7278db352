"""What was learnt from photographs as a model that a file holds.

How bright it is beside a white surface cannot be told from photographs alone: unless a white says
it, an albedo that is typical of shell is assumed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from raden_torch.arrays import Floats
from raden_torch.brdf.fitting.hemisphere import directional_albedo
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.reflectance.few_readings import GRID
from raden_torch.reflectance.scattered import nodes_read_beside

INSTRUMENT = "learnt from photographs, not measured by an instrument"
MEAN = 0.12
"""f_r of the readings on average: what a table is learnt in, its albedo then below 1."""
TYPICAL_ALBEDO = 0.4
_UP_TO_DEG = 45.0
"""The albedo is that of light up to so far from the normal."""
_GRID_DEG = 2.5

Box = tuple[tuple[float, float], ...]
Values = Callable[[Tensor], Floats]
"""`[M, 3]` f_r in 1/sr at incidence, receiving and tilt `[3, M]` in radians."""


def learnt_model(
    values: Values, scale: float, name: str, said: dict[str, object], box_deg: Box
) -> RadenBrdf:
    """`scale` times a reflection, on a grid of 2.5 degrees, as a model that says what it is.

    Args:
        name: of the sample.
        said: how it was learnt, plain JSON values.
        box_deg: as of `box_of`.
    """
    fit = {"learnt": said, "box_deg": [list(ends) for ends in box_deg]}
    return _on_grid(values, scale, Provenance(name, INSTRUMENT, fit=fit))


def _on_grid(values: Values, scale: float, provenance: Provenance) -> RadenBrdf:
    a = np.arange(0, 90.1, _GRID_DEG)
    both = np.arange(-90, 90.1, _GRID_DEG)
    angles = torch.from_numpy(np.stack(np.meshgrid(a, both, both, indexing="ij"))).deg2rad()
    f = scale * values(angles.flatten(1)).reshape(*angles.shape[1:], 3)
    table = ReflectanceTable(torch.from_numpy(f).float(), (0.0, -90.0, -90.0), (_GRID_DEG,) * 3)
    return RadenBrdf(None, table, provenance=provenance)


def albedo_of(values: Values) -> float:
    """The largest directional albedo of light up to 45 degrees from the normal."""
    each = directional_albedo(_on_grid(values, 1.0, Provenance()))
    return max(value for angle, value in each.items() if angle <= _UP_TO_DEG)


def seen_share(angles_deg: Floats) -> float:
    """The share of the nodes of a 5 degree grid of incidence, receiving and tilt within 80 degrees
    that one of `[M, 3]` readings lies at."""
    return float(nodes_read_beside(GRID, angles_deg).mean())


def box_of(angles_deg: Floats) -> Box:
    """The least and greatest incidence, receiving and tilt of `[M, 3]` readings, rounded."""
    ends = np.stack([angles_deg.min(0), angles_deg.max(0)], 1)
    return tuple((round(float(low), 1), round(float(high), 1)) for low, high in ends)
