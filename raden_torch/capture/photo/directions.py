"""Directions: what lies across one, the angle between two, and where rays meet."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats


def directions_across(direction: Floats) -> Floats:
    """`[2, 3]` unit vectors across a direction `[3]` and each other."""
    first = np.cross(direction, np.eye(3)[int(np.argmin(abs(direction)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def apart_deg(a: Floats, b: Floats) -> Floats:
    """Degrees between unit vectors `[..., 3]`, by the diagonals of the rhombus that they span:
    exact also where they are nearly one or opposite."""
    across, along = (np.linalg.norm(a + sign * b, axis=-1) for sign in (-1, 1))
    return np.asarray(np.degrees(2 * np.arctan2(across, along)))


def nearest_points(
    point: Floats, direction: Floats, weight: Floats | None = None
) -> tuple[Floats, Floats]:
    """The points `[K, 3]` nearest to B rays `[K, B, 3]` each, and how far these pass, `[K, B]`.

    Args:
        direction: unit vectors.
        weight: `[K, B]` of the squared distances; alike where None.
    """
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    share = np.ones(point.shape[:-1]) if weight is None else weight
    left = (share[..., None, None] * across).sum(1)
    right = (share[..., None, None] * (across @ point[..., None])).sum(1)
    # of parallel rays, the point nearest to the origin
    nearest = (np.linalg.pinv(left, hermitian=True) @ right)[..., 0]
    off = (across @ (nearest[:, None] - point)[..., None])[..., 0]
    return nearest, np.linalg.norm(off, axis=-1)
