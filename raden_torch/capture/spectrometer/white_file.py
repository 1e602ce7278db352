"""What the white reference's own measurement says at a position."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.csv_file import load_csv
from raden_torch.capture.spectrometer.ports import Position
from raden_torch.errors import InputError

NEAR_DEG = 5.0
"""How far the nearest reading may lie where there is none to interpolate between."""


def xyz_at(file: Path, position: Position) -> Floats:
    """XYZ reflectance factor `(3,)`: linear between the cells of a grid, else the nearest reading.

    Raises:
        InputError: the file cannot be read, or has no valid reading within `NEAR_DEG`.
    """
    angles = np.array(position.angles_deg)
    modified = file.stat().st_mtime_ns if file.exists() else 0
    return _table(file, modified)(angles)


@lru_cache(maxsize=2)
def _table(file: Path, modified: int) -> Callable[[Floats], Floats]:
    """The measurement as a function of the three angles; read once for each version of the file."""
    from scipy.interpolate import RegularGridInterpolator
    from scipy.spatial import KDTree

    measurement = load_csv(file).as_xyz()
    m, valid = measurement, measurement.valid
    readings = np.stack([m.incidence_deg, m.receiving_deg, m.tilt_deg], axis=1)[valid]
    values = m.values[valid]
    tree = KDTree(readings) if len(readings) else None
    between: Callable[[Floats], Floats] | None = None
    if m.is_grid and all(len(axis) > 1 for axis in m.grid().axes_deg):
        grid = m.grid()
        between = RegularGridInterpolator(grid.axes_deg, grid.values, bounds_error=False)

    def at(angles: Floats) -> Floats:
        found = between(angles)[0] if between is not None else np.array([np.nan])
        if np.isfinite(found).all():
            return found
        away, row = tree.query(angles) if tree is not None else (np.inf, 0)
        if away > NEAR_DEG:
            raise InputError(
                f"{file}: no reading of the white reference within {NEAR_DEG:g} degrees of "
                f"incidence {angles[0]:g}, receiving {angles[1]:g}, tilt {angles[2]:g}; measure it "
                "there"
            )
        return values[row].copy()

    return at
