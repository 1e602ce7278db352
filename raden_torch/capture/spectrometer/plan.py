"""What is read, and in which order?

A plan is asked for its next step with all readings that were taken so far. A fixed plan looks only
at how many there are; one that decides from their values asks the same question and gets the same
answer when a journal is replayed.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from raden_torch.capture.spectrometer.ports import ColorReading, Floats, Position, Target
from raden_torch.capture.spectrometer.travel import short_order, travel_deg
from raden_torch.errors import InputError

MAX_ANGLE_DEG = 70.0
MAX_CELLS = 1_000_000
MAX_REPEATS = 100
RANDOM_READINGS = 200

_ANGLES = ("incidence_deg", "receiving_deg", "tilt_deg")
_LOWEST_DEG = (0.0, -90.0, -90.0)  # and below 90
_MAX_LIST_BYTES = 100_000_000
_DIGITS = 6

Reachable = Callable[[Position], "str | None"]
"""Why a rig cannot go to a position; None where it can."""


@dataclass(frozen=True, slots=True)
class Step:
    """One reading to take: which cell of the plan, where that is, and of what."""

    cell: int
    position: Position
    target: Target


@dataclass(frozen=True, slots=True)
class Taken:
    """One reading that was taken: the step, the answer, and when, in seconds since 1970."""

    step: Step
    reading: ColorReading
    time_s: float


class Plan(ABC):
    """Decides what is read next. The same readings always lead to the same step."""

    name: str
    """What the plan is, for people."""

    @property
    @abstractmethod
    def steps(self) -> int:
        """How many readings it takes at most."""

    @abstractmethod
    def next_step(self, taken: Sequence[Taken]) -> Step | None:
        """The step after these readings; None where nothing is left to read."""

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """Everything that is needed to make an equal plan again, as plain JSON values."""

    @property
    def hash(self) -> str:
        """SHA-256 of `as_json`."""
        text = json.dumps(self.as_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class FixedPlan(Plan):
    """Cells that are known beforehand, in the order of measuring.

    Attributes:
        name: what it is, for people.
        cells: `[M, 3]` incidence, receiving and tilt in degrees.
        repeats: how many readings of each cell, one after another.
        white_at_each: also read the white reference at every cell, once; the cells take turns in
            what comes first, so that it is changed once a cell.
        excluded: cells that were wanted and cannot be reached, and why.
        as_given_deg: the degrees of travel in the order in which the cells were given.
    """

    name: str
    cells: Floats
    repeats: int = 1
    white_at_each: bool = False
    excluded: tuple[tuple[Position, str], ...] = ()
    as_given_deg: float = 0.0

    @property
    def steps(self) -> int:
        return len(self.cells) * self._per_cell

    @property
    def _per_cell(self) -> int:
        return self.repeats + self.white_at_each

    @property
    def travel_deg(self) -> float:
        """Degrees of travel in the order of measuring, summed over the axes."""
        return travel_deg(self.cells)

    def next_step(self, taken: Sequence[Taken]) -> Step | None:
        cell, turn = divmod(len(taken), self._per_cell)
        if cell >= len(self.cells):
            return None
        white_turn = -1 if not self.white_at_each else self.repeats if cell % 2 == 0 else 0
        target = Target.WHITE if turn == white_turn else Target.SAMPLE
        return Step(cell, Position(*self.cells[cell].tolist()), target)

    def why_excluded(self) -> dict[str, int]:
        """How many cells were left out, by reason."""
        return dict(Counter(reason for _, reason in self.excluded))

    def as_json(self) -> dict[str, Any]:
        return {
            "kind": "fixed",
            "name": self.name,
            "cells": self.cells.tolist(),
            "repeats": self.repeats,
            "white_at_each": self.white_at_each,
            "excluded": [[*_angles(position), reason] for position, reason in self.excluded],
            "as_given_deg": self.as_given_deg,
        }


def plan_from_json(data: Any) -> FixedPlan:
    """The plan that `as_json` describes.

    Raises:
        InputError: it is not one.
    """
    try:
        if data["kind"] != "fixed":
            raise InputError(f"plan: kind {data['kind']!r} is not known; fixed is")
        excluded = tuple((Position(a, r, t), str(why)) for a, r, t, why in data["excluded"])
        plan = FixedPlan(
            str(data["name"]),
            _checked(data["cells"], "plan"),
            int(data["repeats"]),
            bool(data["white_at_each"]),
            excluded,
            float(data["as_given_deg"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"plan: {type(error).__name__} {error}; not what a scan wrote") from None
    return plan


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
        raise InputError(f"step = {step_deg:g} deg; more than 0 was wanted")
    named = zip(_ANGLES, (incidence, receiving, tilt), strict=True)
    axes = [_axis(name, *limits, step_deg) for name, limits in named]
    count = math.prod(len(axis) for axis in axes)
    if count > MAX_CELLS:
        raise InputError(f"a step of {step_deg:g} deg makes {count} cells; at most {MAX_CELLS}")
    return _checked(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), "grid")


def random_cells(count: int = RANDOM_READINGS, *, seed: int = 0) -> Floats:
    """`[count, 3]` cells drawn evenly from the box of the full grid, to a hundredth of a degree.

    Readings off the grid, to check what was interpolated between its nodes.
    """
    if not 1 <= count <= MAX_CELLS:
        raise InputError(f"{count} random readings; 1…{MAX_CELLS} was wanted")
    drawn = np.random.default_rng(seed).random((count, 3))
    return np.asarray(np.round(drawn * [70.0, 140.0, 140.0] - [0.0, 70.0, 70.0], 2))


def list_cells(path: str | os.PathLike[str]) -> Floats:
    """`[M, 3]` the cells of a CSV file with columns incidence_deg, receiving_deg and tilt_deg.

    Further columns, and lines that begin with #, are passed over: a measurement is a list, too.

    Raises:
        InputError: one line that names the file and line.
    """
    path = Path(path)
    if path.stat().st_size > _MAX_LIST_BYTES:
        raise InputError(f"{path}: over {_MAX_LIST_BYTES // 1_000_000} MB; a list of cells wanted")
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text; a CSV file was wanted") from None
    numbered = [
        (i, line) for i, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"
    ]
    rows = csv.reader(line for _, line in numbered)
    columns = [name.strip() for name in next(rows, [])]
    if not set(_ANGLES) <= set(columns):
        raise InputError(f"{path}: columns {','.join(_ANGLES)} were wanted in its first line")
    places = [columns.index(name) for name in _ANGLES]
    cells = []
    for (line, _), row in zip(numbered[1:], rows, strict=False):
        try:
            cells.append([float(row[place]) for place in places])
        except (ValueError, IndexError):
            raise InputError(f"{path}: line {line}: three angles in degrees were wanted") from None
    if not cells:
        raise InputError(f"{path}: it lists no cells")
    return _checked(cells, str(path))


def make_plan(
    cells: Floats,
    name: str,
    *,
    reachable: Reachable = lambda position: None,
    repeats: int = 1,
    white_at_each: bool = False,
) -> FixedPlan:
    """Put cells into an order of little motion and leave out what the rig cannot reach.

    Raises:
        InputError: nothing is left, or `repeats` is out of its range.
    """
    if not 1 <= repeats <= MAX_REPEATS:
        raise InputError(f"repeats = {repeats}; 1…{MAX_REPEATS} was wanted")
    reasons = [reachable(Position(*cell)) for cell in cells.tolist()]
    within = np.array([reason is None for reason in reasons])
    excluded = tuple(
        (Position(*cell), reason)
        for cell, reason in zip(cells.tolist(), reasons, strict=True)
        if reason is not None
    )
    if not within.any():
        raise InputError(f"{name}: the rig can reach none of the cells ({excluded[0][1]})")
    kept = cells[within]
    return FixedPlan(
        name,
        kept[short_order(kept)],
        repeats,
        white_at_each,
        excluded,
        travel_deg(kept),
    )


def _axis(name: str, first: float, last: float, step: float) -> Floats:
    if not (math.isfinite(first) and math.isfinite(last) and first <= last):
        raise InputError(f"{name} {first:g}…{last:g}: from low to high was wanted")
    steps = round((last - first) / step)
    if not math.isclose(steps * step, last - first, abs_tol=1e-9):
        raise InputError(f"{name} {first:g}…{last:g}: not a whole number of steps of {step:g} deg")
    if steps > MAX_CELLS:
        raise InputError(f"{name}: {steps} steps; at most {MAX_CELLS}")
    return np.round(np.linspace(first, last, steps + 1), _DIGITS)


def _checked(cells: ArrayLike, where: str) -> Floats:
    """The cells as `[M, 3]`; angles in range, none twice."""
    array = np.asarray(cells, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise InputError(f"{where}: cells of shape {list(array.shape)}; [M, 3] was wanted")
    if len(array) > MAX_CELLS:
        raise InputError(f"{where}: {len(array)} cells; at most {MAX_CELLS}")
    wrong = ~((array >= _LOWEST_DEG) & (array < 90) & (array > -90)).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{where}: cell {row + 1} is {array[row].tolist()}; incidence from 0 and receiving "
            "and tilt from -90 to below 90 degrees were wanted"
        )
    _, first, count = np.unique(
        np.round(array, _DIGITS), axis=0, return_index=True, return_counts=True
    )
    if (count > 1).any():
        row = int(first[np.argmax(count > 1)])
        raise InputError(
            f"{where}: cell {row + 1}, {array[row].tolist()}, is there twice; for several readings "
            "of a cell ask for repeats"
        )
    return array


def _angles(position: Position) -> tuple[float, float, float]:
    return position.incidence_deg, position.receiving_deg, position.tilt_deg
