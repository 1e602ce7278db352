"""A table of the hemisphere from few readings all around, and how well each node is known."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.isotropic import STEP_DEG, Derived, mean_percent
from raden_torch.reflectance.kriging import s_u_t
from raden_torch.reflectance.log_readings import FLOOR, LUMINANCE, LogReadings
from raden_torch.reflectance.scattered import nodes_read_beside
from raden_torch.reflectance.symmetric_kriging import RECIPROCAL, SymmetricKriging

MANY = 20_000
"""Readings: as many are told apart by their neighbours (`kriging`) instead."""
GRID = AngleGrid(
    np.arange(0.0, 81.0, STEP_DEG),
    np.arange(-80.0, 81.0, STEP_DEG),
    np.arange(-80.0, 81.0, STEP_DEG),
)
"""Incidence, receiving and tilt of such a table: further than a goniometer's, as the process goes
on beyond the readings better than `continuation` does (docs/decisions/0047-few-readings.md)."""
_APART_DEG = 3.0


def all_around(angles_deg: Floats) -> bool:
    """Whether readings `[M, 3]` differ in the angles of light and view from the normal and in the
    tilt, as those of one plane, or of one view, do not."""
    a, r, t = np.deg2rad(angles_deg).T
    light, view = (
        np.rad2deg(np.arctan2(np.hypot(np.sin(x) * np.cos(t), np.sin(t)), np.cos(x) * np.cos(t)))
        for x in (a, r)
    )
    spread = min(float(np.std(x)) for x in (light, view, np.rad2deg(t)))
    return len(angles_deg) <= MANY and spread > _APART_DEG


def from_few(
    angles_deg: Floats,
    xyz: Floats,
    std: Floats | None = None,
    count: Ints | None = None,
    *,
    assume: str,
) -> Derived:
    """The table, at the nodes of `GRID`, of readings that are `all_around`.

    Args:
        angles_deg, xyz, std, count: as for `LogReadings.of`.
        assume: one of `symmetric_kriging.ASSUMPTIONS`.

    Raises:
        InputError: too few readings.
    """
    process = SymmetricKriging.of(LogReadings.of(angles_deg, xyz, std, count), assume)
    nodes, index = _told_apart(GRID.nodes_deg().reshape(-1, 3), assume)
    logs = process(nodes)
    factors = np.maximum(np.exp(logs) - FLOOR, 0)
    # of Y, not of FLOOR + Y; where Y is dark the deviation is not blown up without bound
    size = np.maximum(factors[:, LUMINANCE], 0.1 * FLOOR)
    relative = process.std(nodes) * np.exp(logs[:, LUMINANCE]) / size
    missed = abs(np.maximum(np.exp(process(angles_deg)) - FLOOR, 0) - xyz)
    shape = GRID.shape
    symmetry = "tilts t and -t are one geometry"
    if assume == RECIPROCAL:
        symmetry += ", and so are light and view exchanged"
    return Derived(
        factors[index].reshape(*shape, -1),
        nodes_read_beside(GRID, angles_deg),
        f"{symmetry} (readings lie {mean_percent(missed, xyz)} off on average)",
        relative[index].reshape(shape),
    )


def _told_apart(nodes_deg: Floats, assume: str) -> tuple[Floats, Ints]:
    """Geometries that are not one by the symmetries, `[K, 3]`, and which of them each node is."""
    s, u, t = s_u_t(nodes_deg).T
    turned = np.where(s < 0, -1.0, 1.0)
    s, u, t = s * turned, u * turned, abs(t)
    if assume == RECIPROCAL:
        u = abs(u)
    _, first, index = np.unique(
        np.round(np.stack([s, u, t], 1), 6), axis=0, return_index=True, return_inverse=True
    )
    return nodes_deg[first], index.ravel()
