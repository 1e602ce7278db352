"""Which cells were asked for, in a user's words, and the plan that follows from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.adaptive import BUDGET_SHARE, make_adaptive_plan
from raden_torch.capture.spectrometer.scan_cells import (
    RANDOM_READINGS,
    Reachable,
    grid,
    list_cells,
    random_cells,
)
from raden_torch.capture.spectrometer.scan_plan import Plan, make_plan
from raden_torch.errors import InputError

GRID_STEP_DEG = 5.0


@dataclass(frozen=True)
class PlanChoice:
    """A plan's description; None where nothing was said. Angles in degrees.

    The fields are options of `raden scan`, and what is said of them its help.

    Attributes:
        kind: full (the grid; the default), random (off the grid), or a CSV of cells
        step_deg: step of the grid, degrees; default 5
        incidence: incidence range of the grid, as 0:70, degrees
        receiving: receiving range of the grid, as -70:70
        tilt: tilt range of the grid, as -70:70
        readings: number of random readings, default 200; with --adaptive the most, default 40 % of
            the grid
        repeats: readings of each cell; default 1
        white_at_each: read the white reference in every cell
        seed: seed of random cells, simulated noise and faults
        adaptive: a coarse pass, then further readings where they reduce the error most
        target_error: with --adaptive: stop when the estimated errors are below this
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
    adaptive: bool = False
    target_error: float | None = None

    @property
    def is_made(self) -> bool:
        """Whether anything was said that shapes a plan."""
        return replace(self, seed=0) != type(self)()

    def plan(self, reachable: Reachable) -> Plan:
        """The cells, without those that cannot be reached, in an order of little motion.

        Raises:
            InputError: the choices contradict each other, or the list of cells cannot be read.
        """
        self._check()
        repeats = 1 if self.repeats is None else self.repeats
        if self.adaptive:
            share = round(BUDGET_SHARE * len(self._grid()) * repeats)
            return make_adaptive_plan(
                self._grid(halved=True),
                f"adaptive, between nodes of {self._step_deg:g} deg",
                reachable=reachable,
                repeats=repeats,
                readings=share if self.readings is None else self.readings,
                target=self.target_error,
            )
        cells, name = self._cells()
        return make_plan(
            cells, name, reachable=reachable, repeats=repeats, white_at_each=self.white_at_each
        )

    @property
    def _step_deg(self) -> float:
        return GRID_STEP_DEG if self.step_deg is None else self.step_deg

    def _limits(self) -> dict[str, tuple[float, float]]:
        named = ("incidence", self.incidence), ("receiving", self.receiving), ("tilt", self.tilt)
        return {name: pair for name, pair in named if pair is not None}

    def _check(self) -> None:
        kind = self.kind or "full"
        if kind != "full" and (self.step_deg is not None or self._limits()):
            raise InputError(
                f"`step_deg` and limits of angles are for a grid; they do not go with {kind}"
            )
        if kind != "random" and not self.adaptive and self.readings is not None:
            raise InputError("`readings` goes with a random plan or `adaptive`")
        if self.target_error is not None and not self.adaptive:
            raise InputError("`target_error` goes with `adaptive`")
        if self.adaptive and kind != "full":
            raise InputError(f"`adaptive` refines a grid; it does not go with {kind}")
        if self.adaptive and self.white_at_each:
            raise InputError(
                "`white_at_each` needs to know the cells beforehand; it does not go with `adaptive`"
            )

    def _cells(self) -> tuple[Floats, str]:
        """The cells of a plan that is fixed, and its name."""
        kind = self.kind or "full"
        if kind == "full":
            return self._grid(), f"grid of {self._step_deg:g} deg"
        if kind == "random":
            count = RANDOM_READINGS if self.readings is None else self.readings
            return random_cells(count, seed=self.seed), f"random, seed {self.seed}"
        return list_cells(Path(kind)), Path(kind).name

    def _grid(self, *, halved: bool = False) -> Floats:
        grid(step_deg=self._step_deg, **self._limits())  # a wrong step is told as it was given
        return grid(step_deg=self._step_deg / 2 if halved else self._step_deg, **self._limits())
