"""A plan that decides: what it may read, where it reads, and what its journal keeps of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.capture.spectrometer import adaptive
from raden_torch.capture.spectrometer.adaptive import AdaptivePlan, make_adaptive_plan
from raden_torch.capture.spectrometer.journal import JournalFile, read_journal
from raden_torch.capture.spectrometer.lab_report import make_report
from raden_torch.capture.spectrometer.next_cells import estimate
from raden_torch.capture.spectrometer.plan_choice import PlanChoice
from raden_torch.capture.spectrometer.plan_json import plan_from_json
from raden_torch.capture.spectrometer.ports import Position
from raden_torch.capture.spectrometer.reduction import reduce_readings
from raden_torch.capture.spectrometer.rehearsal import rehearse
from raden_torch.capture.spectrometer.scan import check_resumable, run_scan
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import make_plan
from raden_torch.capture.spectrometer.travel import travel_deg
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement


def ridge(cells: np.ndarray, *, tilt: float = 20.0, noise: float = 0.0) -> BrdfMeasurement:
    """A simulated sample: a flat body and one narrow ridge along r = a, off the middle in tilt."""
    a, r, t = cells.T
    y = 20 + 300 * np.exp(-(((r - a) / 16) ** 2) - ((t - tilt) / 10) ** 2)
    y = y * (1 + noise * np.random.default_rng(0).standard_normal(len(y)))
    xyz = y[:, None] * [0.9, 1.0, 1.1]
    return BrdfMeasurement(a, r, t, xyz, std=noise * xyz if noise else None)


def keys(cells: np.ndarray) -> list[tuple[float, ...]]:
    return [tuple(cell) for cell in np.round(cells, 6).tolist()]


def hidden(position: Position) -> str | None:
    return "detector" if abs(position.incidence_deg + position.receiving_deg) < 12 else None


@settings(max_examples=6, deadline=None)
@given(
    step=st.sampled_from([17.5, 35.0]),
    budget=st.integers(20, 110),
    repeats=st.integers(1, 3),
    tilt=st.floats(-60, 60),
    unreachable=st.booleans(),
)
def test_any_plan_ends_within_its_budget(step, budget, repeats, tilt, unreachable) -> None:
    """Reads only candidates in reach, none twice, none at an equivalent; the same each time."""
    candidates = grid(step_deg=step)
    reachable = hidden if unreachable else (lambda position: None)
    try:
        plan = make_adaptive_plan(
            candidates,
            "any",
            reachable=reachable,
            readings=budget * repeats,
            repeats=repeats,
        )
    except InputError as error:
        assert "which are read first, got" in str(error)  # noqa: PT017
        return
    end = rehearse(plan, lambda cells: ridge(cells, tilt=tilt))
    assert isinstance(end, AdaptivePlan)
    assert end.ended
    read = keys(end.cells)
    assert len(read) == len(set(read)) <= budget
    assert set(read) <= set(keys(candidates))
    assert all(reachable(Position(*cell)) is None for cell in read)
    twins = {(0.0, -r + 0.0, -t + 0.0) for a, r, t in read if a == 0}
    assert twins & set(read) <= {(0.0, 0.0, 0.0)}
    assert end.steps == len(read) * repeats
    assert travel_deg(end.cells) < travel_deg(plan.likely_cells()) * 1.5


def test_readings_gather_on_a_narrow_ridge() -> None:
    """Physics: where the sample is flat a coarse pass is enough."""
    box = {"incidence": (0.0, 42.0), "receiving": (-42.0, 42.0), "tilt": (-70.0, 70.0)}
    candidates = grid(step_deg=7, **box)
    coarse = grid(step_deg=14, **box)
    plan = make_adaptive_plan(candidates, "ridge", coarse=coarse, readings=500)
    decided = rehearse(plan, ridge).cells[len(plan.cells) :]

    def share(cells: np.ndarray) -> float:
        a, r, t = cells.T
        return float(np.mean((abs(r - a) < 32) & (abs(t - 20) < 20)))

    assert share(decided) > 2.5 * share(candidates)


def test_noise_that_is_stated_is_not_taken_for_change() -> None:
    cells = grid(step_deg=17.5)
    noisy = ridge(cells, tilt=500.0, noise=0.02)
    between = 0.9 * cells + 3.0
    with_std = estimate(noisy, between)
    without = estimate(BrdfMeasurement(*cells.T, noisy.values), between)
    assert with_std.log_error < 0.5 * without.log_error


def test_it_ends_when_the_estimated_error_is_under_its_target() -> None:
    smooth = lambda cells: ridge(cells, tilt=500.0)  # noqa: E731
    plan = make_adaptive_plan(grid(step_deg=17.5), "smooth", readings=400, target=0.01)
    end = rehearse(plan, smooth)
    assert len(end.cells) == len(plan.cells)
    assert end.steps == len(end.cells)


def test_a_plan_survives_its_json() -> None:
    plan = make_adaptive_plan(
        grid(step_deg=17.5), "p", reachable=hidden, readings=160, repeats=2, target=0.1
    )
    again = plan_from_json(json.loads(json.dumps(plan.as_json())))
    assert again.hash == plan.hash
    np.testing.assert_array_equal(
        rehearse(again, ridge).cells,
        rehearse(plan, ridge).cells,
    )
    data = plan.as_json() | {"candidates": grid(step_deg=35, incidence=(35, 70)).tolist()}
    with pytest.raises(InputError, match="expected cells among its candidates"):
        plan_from_json(data)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"readings": 10}, "expected at least 20 cells, got 10 readings"),
        ({"target": 0.0}, "target error: expected 0…1, got 0"),
        ({"target": float("nan")}, "target error: expected 0…1, got nan"),
        ({"repeats": 0}, "repeats: expected 1…100, got 0"),
        ({"reachable": lambda position: "nowhere"}, "can reach none"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_adaptive_plan(grid(step_deg=35), "p", **options)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        (PlanChoice("random", adaptive=True), "does not go with random"),
        (PlanChoice(adaptive=True, white_at_each=True), "`white_at_each` needs"),
        (PlanChoice(target_error=0.1), "`target_error` goes with `adaptive`"),
        (PlanChoice(readings=10), "`readings` goes with a random plan or `adaptive`"),
        (PlanChoice(adaptive=True, step_deg=3.0), "steps of 3 deg"),
    ],
)
def test_options_that_contradict(choice: PlanChoice, message: str) -> None:
    with pytest.raises(InputError, match=message):
        choice.plan(lambda position: None)


def test_the_default_budget_is_two_fifths_of_the_grid() -> None:
    plan = PlanChoice(step_deg=35.0, adaptive=True).plan(lambda position: None)
    assert plan.steps == round(0.4 * 75)


# -- in the journal ----------------------------------------------------------------------------


@pytest.fixture
def plan() -> AdaptivePlan:
    return make_adaptive_plan(grid(step_deg=17.5), "adaptive", readings=90)


@pytest.fixture
def scanned(tmp_path: Path, header, plan, fake, goniometer, colorimeter) -> Path:
    path = tmp_path / "scan.jsonl"
    with JournalFile.create(path, header(plan)) as journal:
        run_scan(journal, goniometer, colorimeter, clock=fake.clock)
    return path


def lines_of(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_every_decision_is_on_the_disk_before_its_first_reading(scanned: Path, plan) -> None:
    contents = read_journal(scanned)
    assert contents.finished
    assert len(contents.taken) == contents.plan.steps == 90
    assert len(contents.decisions) >= 2
    taken = 0
    for record in lines_of(scanned):
        if record["record"] == "decision":
            assert record["after"] == taken
            assert record["why"]
            assert record["estimated_rms"] > 0
        taken += record["record"] == "reading"
    assert not contents.decisions[-1].cells.size
    reduced = reduce_readings(contents)
    assert reduced.measurement.valid.sum() == 90
    report = str(make_report(contents, reduced))
    assert f"decisions: {len(plan.cells)} cells first" in report
    assert "90 cells are the budget" in report
    assert "lost 0" in report


def test_cut_anywhere_and_resumed_it_is_the_same_scan(
    scanned: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fake,
    goniometer,
    colorimeter,
    true_factor,
) -> None:
    """As kill −9 leaves it: bytes up to anywhere. Decisions that are whole are not taken again; the
    others are asked the same question, and are the same."""
    whole = scanned.read_bytes()
    asked = []
    real = adaptive.estimate
    monkeypatch.setattr(adaptive, "estimate", lambda *args: asked.append(1) or real(*args))
    random = np.random.default_rng(0)
    path = tmp_path / "cut.jsonl"
    for cut in random.integers(whole.index(b"\n") + 1, len(whole), 4).tolist():
        path.write_bytes(whole[:cut])
        rig = type(fake)()
        asked.clear()
        with JournalFile.resume(path) as journal:
            kept = len(journal.contents.decisions)
            run_scan(journal, type(goniometer)(rig), type(colorimeter)(rig), clock=rig.clock)
            contents = journal.contents
        assert kept + len(asked) == len(contents.decisions)
        assert [t.step for t in read_journal(path).taken] == [
            t.step for t in read_journal(scanned).taken
        ]
        found = reduce_readings(contents).measurement
        np.testing.assert_array_equal(
            found.values, reduce_readings(read_journal(scanned)).measurement.values
        )
        truth = [
            true_factor(Position(*cell))
            for cell in zip(found.incidence_deg, found.receiving_deg, found.tilt_deg, strict=True)
        ]
        np.testing.assert_allclose(found.values, truth, rtol=1e-9)


def test_a_torn_decision_is_taken_again(scanned: Path) -> None:
    lines = scanned.read_bytes().splitlines(keepends=True)
    row = next(i for i, line in enumerate(lines) if b'"decision"' in line)
    scanned.write_bytes(b"".join(lines[:row]) + lines[row][:-30])
    contents = read_journal(scanned)
    assert not contents.decisions
    assert contents.torn_bytes == len(lines[row]) - 30


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"after": 3}, "before all cells were read"),
        ({"cells": [[1.0, 2.0, 3.0]]}, "is not in the plan"),
        ({"cells": [[0.0, 0.0, 0.0]]}, "cell that was read"),
        ({"cells": [[1.0, 2.0]]}, r"cells\[0\]: expected 3 numbers, got \[1.0, 2.0\]"),
        ({"cells": [["x", 2.0, 3.0]]}, r"cells\[0\]\[0\]: expected a number, got 'x'"),
        ({"cells": grid(step_deg=17.5).tolist()}, "beyond the budget"),
        ({"why": None, "estimated_rms": None}, "why: expected a text, got None"),
        ({"cells": []}, "after the one that ended the plan"),
    ],
)
def test_a_decision_that_was_changed_is_refused(scanned: Path, change: dict, message: str) -> None:
    lines = lines_of(scanned)
    row = next(i for i, line in enumerate(lines) if line["record"] == "decision")
    lines[row] |= change
    scanned.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match=message):
        read_journal(scanned)


def test_a_fixed_plan_takes_no_decision(scanned: Path, tmp_path: Path, header) -> None:
    lines = lines_of(scanned)
    plan = make_plan(grid(step_deg=35), "fixed")
    decision = next(line for line in lines if line["record"] == "decision") | {"after": 0}
    text = [json.dumps(header(plan).as_json()), json.dumps(decision)]
    path = tmp_path / "fixed.jsonl"
    path.write_text("\n".join(text) + "\n")
    with pytest.raises(InputError, match="line 2: a decision"):
        read_journal(path)


def test_a_journal_of_another_plan_says_what_differs(scanned: Path, header, plan) -> None:
    other = make_adaptive_plan(grid(step_deg=17.5), "adaptive", readings=240, repeats=2)
    with JournalFile.resume(scanned) as journal:
        with pytest.raises(InputError, match=r"repeats: 1 and 2; .*budget: 90 and 120"):
            check_resumable(journal, header(other))
        fixed = make_plan(grid(step_deg=35), "grid of 35 deg")
        with pytest.raises(InputError, match=r"kind: 'adaptive' and 'fixed'"):
            check_resumable(journal, header(fixed))
        check_resumable(journal, header(plan))


def test_an_estimate_is_not_asked_for_what_the_journal_says(
    scanned: Path, monkeypatch: pytest.MonkeyPatch, goniometer, colorimeter, fake
) -> None:
    lines = scanned.read_bytes().splitlines(keepends=True)
    end = next(i for i, line in enumerate(lines) if b'"after":90' in line)
    scanned.write_bytes(b"".join(lines[: end + 1]))

    def other(*_: object) -> None:
        pytest.fail("decided again")

    monkeypatch.setattr(adaptive, "estimate", other)
    with JournalFile.resume(scanned) as journal:
        run_scan(journal, goniometer, colorimeter, clock=fake.clock)
        assert journal.contents.finished
