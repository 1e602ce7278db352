"""Cells to read: a grid, random ones, a list; and which of them a rig can reach."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import Position
from raden_torch.errors import InputError
from raden_torch.measurement.csv_table import open_table

MAX_ANGLE_DEG = 70.0
MAX_CELLS = 1_000_000
RANDOM_READINGS = 200

_ANGLES = ("incidence_deg", "receiving_deg", "tilt_deg")
_LOWEST_DEG = (0.0, -90.0, -90.0)  # and below 90
_MAX_LIST_BYTES = 100_000_000
_DIGITS = 6

Reachable = Callable[[Position], "str | None"]
"""Why a rig cannot go to a position; None where it can."""


def grid(
    *,
    step_deg: float = 5.0,
    incidence: tuple[float, float] = (0.0, MAX_ANGLE_DEG),
    receiving: tuple[float, float] = (-MAX_ANGLE_DEG, MAX_ANGLE_DEG),
    tilt: tuple[float, float] = (-MAX_ANGLE_DEG, MAX_ANGLE_DEG),
) -> Floats:
    """`[M, 3]` the cells of a grid in nested order, tilt fastest; by default the full one, 12,615.

    Args:
        step_deg: degrees from node to node, on each axis.
        incidence, receiving, tilt: first and last node in degrees.

    Raises:
        InputError: limits that are reversed, out of range or not a whole number of steps apart.
    """
    if not (math.isfinite(step_deg) and step_deg > 0):
        raise InputError(f"step: expected more than 0 deg, got {step_deg:g}")
    named = zip(_ANGLES, (incidence, receiving, tilt), strict=True)
    axes = [_axis(name, *limits, step_deg) for name, limits in named]
    count = math.prod(len(axis) for axis in axes)
    if count > MAX_CELLS:
        raise InputError(
            f"step: expected at most {MAX_CELLS} cells, got {count} by a step of {step_deg:g} deg"
        )
    return checked_cells(
        np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), "grid"
    )


def random_cells(count: int = RANDOM_READINGS, *, seed: int = 0) -> Floats:
    """`[count, 3]` cells drawn evenly from the box of the full grid, to a hundredth of a degree.

    Readings off the grid, to check what was interpolated between its nodes.
    """
    if not 1 <= count <= MAX_CELLS:
        raise InputError(f"random readings: expected 1…{MAX_CELLS}, got {count}")
    drawn = np.random.default_rng(seed).random((count, 3))
    return np.asarray(np.round(drawn * [70.0, 140.0, 140.0] - [0.0, 70.0, 70.0], 2))


def list_cells(path: str | os.PathLike[str]) -> Floats:
    """`[M, 3]` the cells of a CSV file with columns incidence_deg, receiving_deg and tilt_deg.

    Further columns, and lines that begin with #, are passed over: a measurement is a list, too.
    Separators, encodings and names are those of `measurement.csv_table`.

    Raises:
        InputError: one line that names the file, the line and the column.
    """
    path = Path(path)
    table = open_table(path, _MAX_LIST_BYTES, _ANGLES)
    if not {*_ANGLES} <= {*table.columns}:
        raise InputError(
            f"{path}: expected columns {','.join(_ANGLES)} in its first line, got "
            f"{','.join(table.columns)}"
        )
    cells = table.numbers(_ANGLES)
    if not len(cells):
        raise InputError(f"{path}: expected a list of cells, got none")
    return checked_cells(cells, str(path))


def within_reach(
    cells: Floats, name: str, reachable: Reachable
) -> tuple[Floats, tuple[tuple[Position, str], ...]]:
    """The cells that a rig can go to; and the others, with the reason.

    Raises:
        InputError: nothing is left.
    """
    positions = [Position(*cell) for cell in cells.tolist()]
    reasons = [reachable(position) for position in positions]
    excluded = tuple((p, why) for p, why in zip(positions, reasons, strict=True) if why is not None)
    if len(excluded) == len(cells):
        raise InputError(f"{name}: the rig can reach none of the cells ({excluded[0][1]})")
    return cells[[reason is None for reason in reasons]], excluded


def _axis(name: str, first: float, last: float, step: float) -> Floats:
    if not (math.isfinite(first) and math.isfinite(last) and first <= last):
        raise InputError(f"{name}: expected a range from low to high, got {first:g}…{last:g}")
    steps = round((last - first) / step)
    if not math.isclose(steps * step, last - first, abs_tol=1e-9):
        raise InputError(
            f"{name}: expected a whole number of steps of {step:g} deg, got {first:g}…{last:g}"
        )
    if steps > MAX_CELLS:
        raise InputError(f"{name}: expected at most {MAX_CELLS} steps, got {steps}")
    return np.round(np.linspace(first, last, steps + 1), _DIGITS)


def checked_cells(cells: ArrayLike, where: str) -> Floats:
    """The cells as `[M, 3]`; angles in range, none twice."""
    array = np.asarray(cells, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise InputError(f"{where}: cells: expected shape [M, 3], got {list(array.shape)}")
    if len(array) > MAX_CELLS:
        raise InputError(f"{where}: expected at most {MAX_CELLS} cells, got {len(array)}")
    wrong = ~((array >= _LOWEST_DEG) & (array < 90) & (array > -90)).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{where}: cell {row + 1}: expected incidence from 0 and receiving and tilt from -90 "
            f"to below 90 degrees, got {array[row].tolist()}"
        )
    _, first, count = np.unique(
        np.round(array, _DIGITS), axis=0, return_index=True, return_counts=True
    )
    if (count > 1).any():
        row = int(first[np.argmax(count > 1)])
        raise InputError(
            f"{where}: cell {row + 1}: expected each cell once, got {array[row].tolist()} twice; "
            "for several readings of a cell ask for repeats"
        )
    return array
