"""Which cells were asked for, in a user's words, and the plan that follows from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from raden_torch.capture.spectrometer.plan import (
    RANDOM_READINGS,
    FixedPlan,
    Reachable,
    grid,
    list_cells,
    make_plan,
    random_cells,
)
from raden_torch.errors import InputError

GRID_STEP_DEG = 5.0


@dataclass(frozen=True)
class PlanChoice:
    """A plan's description; None where nothing was said. Angles in degrees.

    Attributes:
        kind: "full", "random", or the path of a CSV file of cells.
        step_deg: of the grid.
        incidence, receiving, tilt: first and last node of the grid.
        readings: how many random ones.
        repeats: readings of each cell.
        white_at_each: read the white reference in every cell.
        seed: of the random cells.
    """

    kind: str | None = None
    step_deg: float | None = None
    incidence: tuple[float, float] | None = None
    receiving: tuple[float, float] | None = None
    tilt: tuple[float, float] | None = None
    readings: int | None = None
    repeats: int | None = None
    white_at_each: bool = False
    seed: int = 0

    @property
    def is_made(self) -> bool:
        """Whether anything was said that shapes a plan."""
        return self != PlanChoice(seed=self.seed)

    def plan(self, reachable: Reachable) -> FixedPlan:
        """The cells, without those that cannot be reached, in an order of little motion.

        Raises:
            InputError: the choices contradict each other, or the list of cells cannot be read.
        """
        kind = self.kind or "full"
        step_deg = GRID_STEP_DEG if self.step_deg is None else self.step_deg
        named = ("incidence", self.incidence), ("receiving", self.receiving), ("tilt", self.tilt)
        limits = {name: pair for name, pair in named if pair is not None}
        if kind != "full" and (self.step_deg is not None or limits):
            raise InputError(
                f"--step and limits of angles shape a grid; they do not go with {kind}"
            )
        if kind != "random" and self.readings is not None:
            raise InputError("--readings goes with --plan random")
        if kind == "full":
            cells, name = grid(step_deg=step_deg, **limits), f"grid of {step_deg:g} deg"
        elif kind == "random":
            count = RANDOM_READINGS if self.readings is None else self.readings
            cells, name = random_cells(count, seed=self.seed), f"random, seed {self.seed}"
        else:
            cells, name = list_cells(Path(kind)), Path(kind).name
        return make_plan(
            cells,
            name,
            reachable=reachable,
            repeats=1 if self.repeats is None else self.repeats,
            white_at_each=self.white_at_each,
        )
