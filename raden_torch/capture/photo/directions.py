"""Directions: what lies across one, and the angle between two."""

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
