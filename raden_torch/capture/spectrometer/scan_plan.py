"""Which cells are read, and in which order.

A plan is asked for its next step with all readings that were taken so far. When all its cells are
read, it is asked whether it decides on more of them; a fixed plan does not. A decision is kept in
the journal and makes a plan with more cells: nothing is decided again when a journal is replayed.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import ColorReading, Position, Target
from raden_torch.capture.spectrometer.scan_cells import Reachable, within_reach
from raden_torch.capture.spectrometer.travel import short_order, travel_deg
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement

MAX_REPEATS = 100


@dataclass(frozen=True, slots=True)
class Step:
    """One reading to take: which cell of the plan, where that is, and of what."""

    cell: int
    position: Position
    target: Target


@dataclass(frozen=True, slots=True)
class TakenReading:
    """One reading that was taken: the step, the answer, and when, in seconds since 1970."""

    step: Step
    reading: ColorReading
    time_s: float


@dataclass(frozen=True)
class Decision:
    """Further cells, and why.

    Attributes:
        after: how many readings had been taken.
        cells: `[K, 3]` what is read next, in that order; none where the plan is at its end.
        why: one sentence.
        rms: estimated RMS error of Y over its 99.9 % quantile, of a fit to the readings so far.
        log_error: estimated mean |Δ log(1 + Y)|.
    """

    after: int
    cells: Floats
    why: str
    rms: float
    log_error: float


@dataclass(frozen=True, eq=False)
class Plan(ABC):
    """Decides what is read next. The same readings and decisions always lead to the same step.

    Attributes:
        name: what it is, for people.
        cells: `[M, 3]` incidence, receiving and tilt in degrees, in the order of measuring: all
            that are known so far.
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
    @abstractmethod
    def steps(self) -> int:
        """How many readings it takes at most."""

    @property
    @abstractmethod
    def may_read(self) -> Floats:
        """`[N, 3]` the cells that it reads, or may decide to read."""

    @abstractmethod
    def likely_cells(self) -> Floats:
        """`[N, 3]` as many cells as it reads at most, for a forecast of travel and time."""

    @abstractmethod
    def decide(self, taken: int, readings: Callable[[], BrdfMeasurement]) -> Decision | None:
        """What is read once all `cells` are; None where nothing more is to be decided.

        Args:
            taken: how many readings there are.
            readings: makes reflectance factors of them.
        """

    @abstractmethod
    def after(self, decision: Decision) -> Plan:
        """The plan with a decision's cells.

        Raises:
            InputError: it is not one that this plan can have made.
        """

    @abstractmethod
    def as_json(self) -> dict[str, Any]:
        """Everything that is needed to make an equal plan again, as plain JSON values."""

    def next_step(self, taken: Sequence[TakenReading]) -> Step | None:
        """The step after these readings; None where all cells are read."""
        cell, turn = divmod(len(taken), self.per_cell)
        if cell >= len(self.cells):
            return None
        white_turn = -1 if not self.white_at_each else self.repeats if cell % 2 == 0 else 0
        target = Target.WHITE if turn == white_turn else Target.SAMPLE
        return Step(cell, Position(*self.cells[cell].tolist()), target)

    @property
    def per_cell(self) -> int:
        """How many readings a cell takes."""
        return self.repeats + self.white_at_each

    @property
    def travel_deg(self) -> float:
        """Degrees of travel in the order of measuring, summed over the axes."""
        return travel_deg(self.cells)

    def why_excluded(self) -> dict[str, int]:
        """How many cells were left out, by reason."""
        return dict(Counter(reason for _, reason in self.excluded))

    @property
    def hash(self) -> str:
        """SHA-256 of `as_json`."""
        text = json.dumps(self.as_json(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def difference(self, other: Plan) -> str:
        """What differs between this plan and another, in words; empty where nothing does."""
        ours, theirs = self.as_json(), other.as_json()
        return "; ".join(
            f"{name.replace('_', ' ')}: {_in_words(ours.get(name), theirs.get(name))}"
            for name in dict.fromkeys((*ours, *theirs))
            if ours.get(name) != theirs.get(name)
        )


@final
class FixedPlan(Plan):
    """Cells that are known beforehand."""

    @property
    def steps(self) -> int:
        return len(self.cells) * self.per_cell

    @property
    def may_read(self) -> Floats:
        return self.cells

    def likely_cells(self) -> Floats:
        return self.cells

    def decide(self, taken: int, readings: Callable[[], BrdfMeasurement]) -> Decision | None:
        return None

    def after(self, decision: Decision) -> Plan:
        raise InputError("a decision; this plan has fixed cells and takes none")

    def as_json(self) -> dict[str, Any]:
        return {"kind": "fixed", **cells_as_json(self)}


def cells_as_json(plan: Plan) -> dict[str, Any]:
    """What every plan is made of."""
    return {
        "name": plan.name,
        "cells": plan.cells.tolist(),
        "repeats": plan.repeats,
        "white_at_each": plan.white_at_each,
        "excluded": [[*position.angles_deg, reason] for position, reason in plan.excluded],
        "as_given_deg": plan.as_given_deg,
    }


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
    kept, excluded = within_reach(cells, name, reachable)
    return FixedPlan(
        name,
        kept[short_order(kept)],
        checked_repeats(repeats),
        white_at_each,
        excluded,
        travel_deg(kept),
    )


def checked_repeats(repeats: int) -> int:
    """Raises InputError where it is out of its range."""
    if not 1 <= repeats <= MAX_REPEATS:
        raise InputError(f"repeats: expected 1…{MAX_REPEATS}, got {repeats}")
    return repeats


def _in_words(ours: Any, theirs: Any) -> str:
    if not (isinstance(ours, list) and isinstance(theirs, list)):
        return f"{ours!r} and {theirs!r}"
    if len(ours) != len(theirs):
        return f"{len(ours)} and {len(theirs)} of them"
    return f"{sum(a != b for a, b in zip(ours, theirs, strict=True))} of {len(ours)} differ"
