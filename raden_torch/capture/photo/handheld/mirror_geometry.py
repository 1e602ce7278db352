"""Where a ball mirrors a lamp, and where rays meet."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.directions import nearest_points


def mirror_points(centre: Floats, radius: float, eye: Floats, lamp: Floats) -> Floats:
    """`[K, 3]` where a mirror ball shows the lamp to the eye: there the normal halves the angle
    between the ways to both. `eye` and `lamp` `[K, 3]` lie outside of the ball.

    Newton would need derivatives; this fixed point gains a digit or more a round, since the ball is
    small beside the distances.
    """
    normal = unit(unit(eye - centre) + unit(lamp - centre))
    for _ in range(30):
        point = centre + radius * normal
        new = unit(unit(eye - point) + unit(lamp - point))
        if float(np.abs(new - normal).max()) < 1e-12:
            break
        normal = new
    return np.asarray(centre + radius * normal)


def meeting_point(point: Floats, way: Floats) -> Floats:
    """The point `[3]` nearest to rays `[R, 3]`, by the sum of distances: Weiszfeld's weights."""
    weight = np.ones((1, len(point)))
    nearest = np.zeros((1, 3))
    for _ in range(20):
        nearest, miss = nearest_points(point[None], way[None], weight)
        weight = 1 / np.maximum(miss, 1e-3)
    return nearest[0]


def unit(v: Floats) -> Floats:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
