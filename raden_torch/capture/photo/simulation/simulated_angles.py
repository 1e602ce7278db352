"""Directions ↔ (incidence, receiving, tilt), written for the simulation alone.

The drawing in docs/conventions.md, in frames and `atan2`: no line of `raden_torch.geometry`, whose
results are compared with this.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raden_torch.arrays import Floats

_PARALLEL = 1e-9


def directions(incidence: Any, receiving: Any, tilt: Any) -> tuple[Floats, Floats]:
    """Unit directions `[..., 3]` to the light and to the viewer, the normal being +z.

    The plane of light and view is laid out first, N′ along its z axis, light and view on either
    side; the normal leans out of it by the tilt; then everything is seen from the normal.

    Args:
        incidence, receiving, tilt: in radians, broadcastable.
    """
    a, r, t = np.broadcast_arrays(*(np.asarray(x, float) for x in (incidence, receiving, tilt)))
    nil, one = np.zeros_like(a), np.ones_like(a)
    light = np.stack([-np.sin(a), nil, np.cos(a)], -1)
    view = np.stack([np.sin(r), nil, np.cos(r)], -1)
    along = np.stack([one, nil, nil], -1)
    normal = np.stack([nil, np.sin(t), np.cos(t)], -1)
    across = np.cross(normal, along)
    frame = np.stack([along, across, normal], -2)
    return (frame @ light[..., None])[..., 0], (frame @ view[..., None])[..., 0]


def angles(light: Floats, view: Floats) -> tuple[Floats, Floats, Floats]:
    """Incidence, receiving and tilt in radians of unit directions `[..., 3]`, the normal being +z.

    Light and view that are one direction: the plane of it and the normal, as the convention says.
    """
    axis = np.cross(light, view)
    length = np.linalg.norm(axis, axis=-1)
    one = length < _PARALLEL
    p = axis / np.where(one, 1.0, length)[..., None]
    normal = np.array([0.0, 0.0, 1.0])
    in_plane = normal - p[..., 2:] * p
    a = np.arctan2(_dot(p, np.cross(light, in_plane)), _dot(light, in_plane))
    r = np.arctan2(_dot(p, np.cross(in_plane, view)), _dot(view, in_plane))
    t = np.arctan2(p[..., 2], np.linalg.norm(in_plane, axis=-1))
    side = np.where(a < 0, -1.0, 1.0)
    from_normal = np.arctan2(np.hypot(light[..., 0], light[..., 1]), light[..., 2])
    return (
        np.where(one, from_normal, side * a),
        np.where(one, -from_normal, side * r),
        np.where(one, 0.0, side * t),
    )


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).sum(-1))
