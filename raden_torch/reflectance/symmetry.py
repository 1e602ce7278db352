"""Which geometries are one, and which are each other's reciprocal.

Perpendicular incidence has no plane of its own: (0, r, t) ≡ (0, −r, −t). Below incidence 0 a
geometry goes on into that equivalent, (−a, r, t) ≡ (a, −r, −t). Light and viewer change places:
(a, r, t) ↔ (r, a, −t) for r ≥ 0, (−r, −a, t) for r < 0.
"""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Bools, Floats, Ints
from raden_torch.reflectance.grid import SAME_DEG, AngleGrid

TURNED = np.array([1.0, -1.0, -1.0])
"""(a, r, t) · `TURNED` is the equivalent of an angle at incidence 0."""


def at_perpendicular(angles_deg: Floats) -> Bools:
    """`[M]`: incidence is 0."""
    return np.asarray(abs(angles_deg[..., 0]) < SAME_DEG)


def canonical(angles_deg: Floats) -> Floats:
    """`[M, 3]`: of the equivalents (0, r, t) ≡ (0, −r, −t), the one that is read first: r > 0, or
    r = 0 and t ≥ 0. Other angles are unchanged."""
    _, r, t = np.asarray(angles_deg, np.float64).T
    behind = (r < -SAME_DEG) | ((abs(r) <= SAME_DEG) & (t < 0))
    turned = at_perpendicular(angles_deg) & behind
    return np.where(turned[:, None], angles_deg * TURNED + 0.0, angles_deg)  # −0 becomes 0


def reciprocal(angles_deg: Floats) -> Floats:
    """`[..., 3]`: light and viewer changed."""
    a, r, t = np.moveaxis(angles_deg, -1, 0)
    forward = r >= 0
    swapped = np.where(forward, r, -r), np.where(forward, a, -a), np.where(forward, -t, t)
    return np.stack(swapped, axis=-1)


def mirrored_nodes(axis_deg: Floats) -> tuple[Ints, Ints]:
    """Indices of the nodes whose negative is a node too, and of those negatives."""
    distance = abs(axis_deg[:, None] + axis_deg[None, :])
    partner = distance.argmin(axis=1)
    paired = np.flatnonzero(distance.min(axis=1) < SAME_DEG)
    return paired, partner[paired]


def average_perpendicular(grid: AngleGrid, values: Floats) -> tuple[Floats, Bools, float]:
    """(0, r, t) ≡ (0, −r, −t): both take the mean of what was measured of them.

    Args:
        values: `[A, R, T, C]`, NaN where not measured.

    Returns:
        The values; `[A, R, T]` the nodes that changed, though they were measured; and the mean
        |difference| of equivalents over their mean, NaN if there are none.
    """
    values = values.copy()
    averaged = np.zeros(values.shape[:3], bool)
    j, j2 = mirrored_nodes(grid.receiving_deg)
    k, k2 = mirrored_nodes(grid.tilt_deg)
    if abs(grid.incidence_deg[0]) > SAME_DEG or not len(j) or not len(k):
        return values, averaged, float("nan")
    here = values[0][np.ix_(j, k)]
    there = values[0][np.ix_(j2, k2)]
    both = ~np.isnan(here) & ~np.isnan(there)
    mean = np.where(both, (here + there) / 2, np.where(np.isnan(here), there, here))
    values[0][np.ix_(j, k)] = mean
    averaged[0][np.ix_(j, k)] = (both & (here != there)).any(axis=-1)
    size = np.mean(abs(mean[both])) if both.any() else 0.0
    asymmetry = float(np.mean(abs(here - there)[both]) / size) if size > 0 else float("nan")
    return values, averaged, asymmetry


def reciprocity_error(grid: AngleGrid, values: Floats) -> tuple[float, float]:
    """|f − f of the reciprocal geometry|, on average, weighted by f, and at worst.

    Args:
        values: `[A, R, T]`, NaN where not measured.

    Returns:
        NaN where no pair was measured.
    """
    index, there = grid.find(reciprocal(grid.nodes_deg()))
    other = values[tuple(np.moveaxis(index, -1, 0))]
    pair = there & ~np.isnan(values) & ~np.isnan(other)
    size = (abs(values) + abs(other))[pair] / 2
    if not pair.any() or size.sum() == 0:
        return float("nan"), float("nan")
    difference = abs(values - other)[pair]
    worst = np.max(difference / np.maximum(size, 1e-6 * size.max()))
    return float(difference.sum() / size.sum()), float(worst)
