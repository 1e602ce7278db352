"""A plan that reads a coarse grid first, then where a further reading reduces the error most.

What it decides, and from what, is in `next_cells`. Every decision is a batch of cells, an eighth of
what was read before, in an order of little travel; the plan ends with its budget, with an estimated
error under its target, or when every cell is read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.next_cells import choose, estimate
from raden_torch.capture.spectrometer.scan_cells import Reachable, checked_cells, within_reach
from raden_torch.capture.spectrometer.scan_plan import (
    Decision,
    Plan,
    cells_as_json,
    checked_repeats,
)
from raden_torch.capture.spectrometer.travel import short_order, travel_deg
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.grid import distinct
from raden_torch.reflectance.symmetry import canonical

BUDGET_SHARE = 0.4
"""Of the readings of the grid between whose nodes it refines, where nobody says."""

LEAST_READINGS = 20

_BATCH_SHARE, _LEAST_BATCH = 1 / 8, 10
_COARSE = (4, 7, 14, 28)  # the coarse pass reads each 4th, 7th, … node of the finest grid
_COARSE_SHARE = 0.6  # of the budget that the coarse pass may take
_DIGITS = 6


@final
@dataclass(frozen=True, eq=False)
class AdaptivePlan(Plan):
    """See the module's text. `cells` are those of the coarse pass and of all decisions so far.

    Attributes:
        candidates: `[N, 3]` all cells that may be read, those of the coarse pass among them.
        budget: how many cells are read at most.
        target: the plan ends when both estimated errors are below this; None for never.
        ended: it has decided to read no more.
    """

    candidates: Floats = None  # type: ignore[assignment]  # a dataclass' defaults come last
    budget: int = 0
    target: float | None = None
    ended: bool = False

    @property
    def steps(self) -> int:
        return (len(self.cells) if self.ended else self.budget) * self.per_cell

    @property
    def may_read(self) -> Floats:
        return self.candidates

    def likely_cells(self) -> Floats:
        """The coarse pass, and batches that are spread evenly: no others travel further."""
        plan: Plan = self
        rng = np.random.default_rng(0)
        while (count := self._next_count(len(plan.cells))) > 0:
            left = _without(self.candidates, plan.cells)
            cells = left[rng.choice(len(left), count, replace=False)]
            plan = plan.after(Decision(0, cells[short_order(cells)], "", np.nan, np.nan))
        return plan.cells

    def decide(self, taken: int, readings: Callable[[], BrdfMeasurement]) -> Decision | None:
        if self.ended:
            return None
        left, known = _without(self.candidates, self.cells), readings()
        # the candidates stand for all places, so the ones that are read are estimated, too
        found = estimate(known, self.candidates)
        end = lambda why: Decision(taken, np.zeros((0, 3)), why, found.rms, found.log_error)  # noqa: E731
        if self.target is not None and max(found.rms, found.log_error) < self.target:
            return end(f"both estimated errors are under {self.target:g}")
        count = self._next_count(len(self.cells))
        if count == 0:
            all_read = len(left) == 0
            return end("every cell is read" if all_read else f"{self.budget} cells are the budget")
        gain = found.gain[is_in(self.candidates, left)]
        cells = left[choose(gain, left, self.cells, count)]
        share = gain[is_in(left, cells)].sum() / max(gain.sum(), np.finfo(float).tiny)
        return Decision(
            taken,
            _from(self.cells[-1], cells[short_order(cells)]),
            f"{len(cells)} of {len(left)} cells, with {100 * share:.3g} % of the expected error",
            found.rms,
            found.log_error,
        )

    def after(self, decision: Decision) -> AdaptivePlan:
        if self.ended:
            raise InputError("a decision after the one that ended the plan")
        if not len(decision.cells):
            return replace(self, ended=True)
        cells = np.round(decision.cells, _DIGITS)
        if len(self.cells) + len(cells) > self.budget:
            raise InputError(f"a decision beyond the budget of {self.budget} cells")
        if not is_in(cells, _without(self.candidates, self.cells)).all():
            raise InputError("a decision for a cell that was read already, or is not in the plan")
        return replace(self, cells=checked_cells(np.concatenate([self.cells, cells]), "decision"))

    def as_json(self) -> dict[str, Any]:
        return {
            "kind": "adaptive",
            **cells_as_json(self),
            "candidates": self.candidates.tolist(),
            "budget": self.budget,
            "target": self.target,
        }

    def _next_count(self, cells: int) -> int:
        """How many cells the next batch has, after so many."""
        batch = max(_LEAST_BATCH, round(_BATCH_SHARE * cells))
        return min(batch, self.budget - cells, len(self.candidates) - cells)


def make_adaptive_plan(
    candidates: Floats,
    name: str,
    *,
    coarse: Floats | None = None,
    reachable: Reachable = lambda position: None,
    repeats: int = 1,
    readings: int | None = None,
    target: float | None = None,
) -> AdaptivePlan:
    """A plan over cells of which the rig may reach only some.

    Args:
        candidates: `[N, 3]` in degrees; of the equivalents (0, r, t) ≡ (0, −r, −t) one is kept.
        coarse: which of them are read first; every fourth node or so where None.
        readings: the budget, `repeats` counted; at least `LEAST_READINGS` cells.
        target: see `AdaptivePlan`.

    Raises:
        InputError: nothing is within reach, or a number is out of its range.
    """
    repeats = checked_repeats(repeats)
    budget = len(candidates) if readings is None else readings // repeats
    if budget < LEAST_READINGS:
        raise InputError(
            f"adaptive plan: expected at least {LEAST_READINGS} cells, got {readings} readings of "
            f"{repeats} a cell"
        )
    if target is not None and not 0 < target < 1:
        raise InputError(f"target error: expected 0…1, got {target:g}")
    first = _coarse_nodes(candidates, budget) if coarse is None else coarse
    given, excluded = within_reach(first, name, reachable)
    given = _one_of_equivalents(given)
    kept, _ = within_reach(candidates, name, reachable)
    kept = np.concatenate([given, _without(_one_of_equivalents(kept), given)])
    if len(given) > budget:
        raise InputError(
            f"{name}: expected a budget of at least {len(given)} cells, which are read first, got "
            f"{budget}"
        )
    return AdaptivePlan(
        name,
        given[short_order(given)],
        repeats,
        False,
        excluded,
        travel_deg(given),
        checked_cells(np.round(kept, _DIGITS), name),
        min(budget, len(kept)),
        target,
    )


def _coarse_nodes(candidates: Floats, budget: int) -> Floats:
    """The nodes of the finest coarse grid that leaves the budget its decisions."""
    axes = [np.unique(column) for column in candidates.T]
    for every in _COARSE:
        kept = [np.unique(np.append(axis[::every], axis[-1])) for axis in axes]
        nodes = np.all([np.isin(c, k) for c, k in zip(candidates.T, kept, strict=True)], axis=0)
        if nodes.sum() <= _COARSE_SHARE * budget:
            break
    return candidates[nodes]


def _one_of_equivalents(cells: Floats) -> Floats:
    """In their order; (0, r, t) and (0, −r, −t) are one cell."""
    _, first = np.unique(np.round(canonical(cells), _DIGITS), axis=0, return_index=True)
    return np.asarray(cells[np.sort(first)])


def _without(cells: Floats, others: Floats) -> Floats:
    return np.asarray(cells[~is_in(cells, others)])


def is_in(cells: Floats, others: Floats) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """`[M]`: which cells are among the others."""
    _, index = distinct(np.concatenate([others, cells]))
    return np.isin(index[len(others) :], index[: len(others)])


def _from(here: Floats, cells: Floats) -> Floats:
    """In this order or turned round, whichever begins nearer to where the rig stands."""
    first, last = (abs(cells[end] - here).sum() for end in (0, -1))
    return cells if first <= last else np.asarray(cells[::-1])
