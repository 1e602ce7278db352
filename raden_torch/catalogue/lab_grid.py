"""A shell's colours over the angles, small enough to search: CIELAB at the nodes of a grid.

The second axis is receiving − incidence, so that every mirror direction lies on a node of it: there
the colours change fastest. Receiving is held within ±80°.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.catalogue.colour_query import Geometry
from raden_torch.colorimetry import SRGB, lab_of, primary_matrix, xyz_of

INCIDENCE = np.arange(0.0, 81.0, 5.0)
FROM_MIRROR = np.array([-160.0, -120, -80, -40, -20, -10, -5, 0, 5, 10, 20, 40, 80])
TILT = np.array([-60.0, -30, -15, -5, 0, 5, 15, 30, 60])
SHAPE = (len(INCIDENCE), len(FROM_MIRROR), len(TILT), 3)
_MOST_RECEIVING = 80.0
_TO_XYZ = primary_matrix(SRGB)


def nodes_deg() -> Floats:
    """`[M, 3]`: incidence, receiving and tilt of the nodes, the last axis fastest."""
    a, d, t = np.meshgrid(INCIDENCE, FROM_MIRROR, TILT, indexing="ij")
    r = np.clip(a + d, -_MOST_RECEIVING, _MOST_RECEIVING)
    return np.stack([a, r, t], axis=-1).reshape(-1, 3)


def lab_of_f_r(f_r: Floats) -> Floats:
    """f_r `[..., 3]` in 1/sr, linear sRGB → L*, a*, b*."""
    return lab_of(np.pi * np.asarray(f_r, np.float64) @ _TO_XYZ.T, _TO_XYZ.sum(axis=1))


def rgb_of_lab(lab: Floats) -> Floats:
    """L*, a*, b* `[..., 3]` → linear sRGB, where a perfect diffuser is 1."""
    return np.asarray(xyz_of(lab, _TO_XYZ.sum(axis=1)) @ np.linalg.inv(_TO_XYZ).T)


def column(incidence: int) -> str:
    """The name of the index's column with the colours at one node of the incidence."""
    return f"lab_{INCIDENCE[incidence]:02.0f}"


def columns_at(where: Geometry) -> dict[str, float]:
    """The columns that a geometry needs, with their weights."""
    return {column(k): weight for k, weight in _around(INCIDENCE, where.incidence_deg)}


def within(tables: Floats, where: Geometry) -> Floats:
    """`[N, D, T, 3]` colours at one incidence → `[N, 3]`, linear between the nodes."""
    from_mirror = where.receiving - where.incidence_deg
    pairs = product(_around(FROM_MIRROR, from_mirror), _around(TILT, where.tilt_deg))
    return np.asarray(sum(u * v * tables[:, j, k].astype(float) for (j, u), (k, v) in pairs))


def _around(axis: Floats, at: float) -> list[tuple[int, float]]:
    """The nodes beside a place on an axis, and their weights; those that count."""
    k = int(np.clip(np.searchsorted(axis, at, side="right") - 1, 0, len(axis) - 2))
    share = float((at - axis[k]) / (axis[k + 1] - axis[k]))
    return [(i, w) for i, w in ((k, 1 - share), (k + 1, share)) if w > 0]
