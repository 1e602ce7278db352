"""What is read, in which order; how far that is."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.capture.spectrometer.plan_json import plan_from_json
from raden_torch.capture.spectrometer.ports import Position, Target
from raden_torch.capture.spectrometer.scan_cells import grid, list_cells, random_cells
from raden_torch.capture.spectrometer.scan_plan import FixedPlan, make_plan
from raden_torch.capture.spectrometer.travel import longest_axis_deg, short_order, travel_deg
from raden_torch.errors import InputError


def steps_of(plan: FixedPlan) -> list:
    taken: list = []
    while (step := plan.next_step(taken)) is not None:
        taken.append(step)
    return taken


def hidden(position: Position) -> str | None:
    return "detector" if abs(position.incidence_deg + position.receiving_deg) < 10 else None


def test_full_grid_is_the_paper_s() -> None:
    cells = grid()
    assert len(cells) == 15 * 29 * 29 == 12615
    assert [cells[:, i].min() for i in range(3)] == [0, -70, -70]
    assert (cells.max(axis=0) == 70).all()


def test_no_order_of_the_full_grid_is_shorter() -> None:
    """Every move between two cells is one step at least; the plan has no longer one."""
    plan = make_plan(grid(), "full")
    assert sorted(map(tuple, plan.cells)) == sorted(map(tuple, grid()))
    assert plan.travel_deg == 5.0 * (len(plan.cells) - 1)
    assert (longest_axis_deg(plan.cells) == 5.0).all()
    assert plan.as_given_deg > 1.99 * plan.travel_deg
    shuffled = np.random.default_rng(0).permutation(plan.cells)
    assert travel_deg(shuffled) > 20 * plan.travel_deg


def test_excluded_cells_are_kept_apart_with_their_reason() -> None:
    plan = make_plan(grid(step_deg=10), "grid", reachable=hidden)
    assert len(plan.cells) + len(plan.excluded) == 1800
    assert plan.why_excluded() == {"detector": len(plan.excluded)}
    assert all(hidden(Position(*cell)) is None for cell in plan.cells.tolist())
    assert plan.travel_deg < 1.2 * 10 * len(plan.cells)


def test_random_readings_lie_off_the_grid_and_travel_a_third() -> None:
    cells = random_cells()
    assert len(cells) == 200
    assert (cells >= [0, -70, -70]).all()
    assert (cells <= 70).all()
    np.testing.assert_array_equal(cells, random_cells(seed=0))
    plan = make_plan(cells, "random")
    assert plan.as_given_deg > 3 * plan.travel_deg


@settings(max_examples=50, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 14), st.integers(-14, 14), st.integers(-14, 14)),
        min_size=1,
        max_size=60,
        unique=True,
    )
)
def test_an_order_visits_each_cell_once_and_is_no_longer(cells: list) -> None:
    array = np.array(cells, float) * 5
    order = short_order(array)
    assert sorted(order) == list(range(len(cells)))
    tour = array[np.lexsort(array.T[::-1])]
    assert travel_deg(array[order]) <= travel_deg(tour) + 1e-9


def test_many_scattered_cells_are_ordered_quickly_too() -> None:
    cells = random_cells(20_000, seed=1)
    plan = make_plan(cells, "many")
    assert plan.as_given_deg > 10 * plan.travel_deg


def test_repeats_follow_one_another() -> None:
    steps = steps_of(make_plan(grid(step_deg=70), "coarse", repeats=3))
    assert [s.cell for s in steps] == sorted(3 * list(range(18)))
    assert {s.target for s in steps} == {Target.SAMPLE}


def test_white_at_each_cell_takes_turns() -> None:
    steps = steps_of(make_plan(grid(step_deg=70), "coarse", repeats=2, white_at_each=True))
    for cell in range(18):
        targets = [s.target for s in steps if s.cell == cell]
        assert sorted(t.value for t in targets) == ["sample", "sample", "white"]
    assert sum(a.target is not b.target for a, b in pairwise(steps)) == 18


@pytest.mark.parametrize("white_at_each", [False, True])
def test_a_plan_survives_its_json(white_at_each: bool) -> None:
    plan = make_plan(
        grid(step_deg=35), "g", reachable=hidden, repeats=2, white_at_each=white_at_each
    )
    again = plan_from_json(json.loads(json.dumps(plan.as_json())))
    assert again.hash == plan.hash
    assert steps_of(again) == steps_of(plan)
    assert again.excluded == plan.excluded


def test_the_hash_tells_plans_apart() -> None:
    cells = grid(step_deg=35)
    plans = [
        make_plan(cells, "g"),
        make_plan(cells, "g", repeats=2),
        make_plan(cells, "g", white_at_each=True),
        make_plan(cells[:-1], "g"),
        make_plan(cells, "g", reachable=hidden),
    ]
    assert len({plan.hash for plan in plans}) == len(plans)


def test_a_list_of_cells_may_be_a_measurement(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(
        "# material: x\ntilt_deg,X,incidence_deg,receiving_deg\n5,1.0,10,-20\n\n# more\n0,2,30,40\n"
    )
    np.testing.assert_array_equal(list_cells(path), [[10, -20, 5], [30, 40, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"expected columns incidence_deg,receiving_deg,tilt_deg"),
        ("a,b,c\n1,2,3\n", r"expected columns incidence_deg,receiving_deg,tilt_deg"),
        ("incidence_deg,receiving_deg,tilt_deg\n", "expected a list of cells, got none"),
        ("incidence_deg,receiving_deg,tilt_deg\n1,2\n", "line 2: expected 3 values, got 2"),
        (
            "incidence_deg,receiving_deg,tilt_deg\n1,2,3\n\n1,x,3\n",
            "line 4, column receiving_deg: expected a number, got 'x'",
        ),
        ("incidence_deg,receiving_deg,tilt_deg\n1,2,nan\n", "cell 1: expected .*nan"),
        (
            "incidence_deg,receiving_deg,tilt_deg\n1,2,3\n-1,2,3\n",
            r"cell 2: expected .*, got \[-1.0, 2.0, 3.0\]",
        ),
        (
            "incidence_deg,receiving_deg,tilt_deg\n1,90,3\n",
            r"cell 1: expected .*, got \[1.0, 90.0, 3.0\]",
        ),
        (
            "incidence_deg,receiving_deg,tilt_deg\n1,2,3\n4,5,6\n1,2,3\n",
            "cell 1: expected each cell once, got .* twice",
        ),
    ],
)
def test_a_wrong_list_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        list_cells(path)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_as_a_list_are_read_or_refused(tmp_path_factory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("list") / "list.csv"
    path.write_bytes(data)
    with pytest.raises(InputError):
        list_cells(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"step_deg": 0.0}, "step: expected more than 0 deg, got 0"),
        ({"step_deg": float("nan")}, "step: expected more than 0 deg, got nan"),
        ({"step_deg": 3.0}, "expected a whole number of steps of 3 deg, got 0…70"),
        ({"step_deg": 0.1}, "step: expected at most 1000000 cells, got 1375923501"),
        ({"step_deg": 1e-9}, "expected at most 1000000 steps, got 70000000000"),
        ({"tilt": (10.0, -10.0)}, "from low to high"),
        ({"incidence": (-5.0, 10.0)}, "incidence from 0"),
        ({"receiving": (0.0, 90.0)}, "below 90"),
    ],
)
def test_a_wrong_grid_is_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        grid(**options)


def test_a_plan_without_a_reachable_cell_is_refused() -> None:
    with pytest.raises(InputError, match=r"can reach none of the cells \(nowhere\)"):
        make_plan(grid(step_deg=35), "g", reachable=lambda position: "nowhere")


@pytest.mark.parametrize("repeats", [0, 101])
def test_repeats_out_of_range(repeats: int) -> None:
    with pytest.raises(InputError, match="repeats: expected 1…100, got "):
        make_plan(grid(step_deg=35), "g", repeats=repeats)
