"""The loop around the instruments: what it takes, in which order, and what it gets over."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.spectrometer.journal import (
    JournalFile,
    read_journal,
)
from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    InstrumentBusyError,
    InstrumentError,
    MotionAlarmError,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.reduction import reduce_readings
from raden_torch.capture.spectrometer.scan import (
    RetryPolicy,
    ScanStoppedError,
    check_resumable,
    run_scan,
)
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import FixedPlan, make_plan
from raden_torch.errors import InputError


@pytest.fixture
def plan() -> FixedPlan:
    cells = grid(step_deg=35, incidence=(0, 35), receiving=(-35, 70), tilt=(-35, 35))
    return make_plan(cells, "small", repeats=2)


@pytest.fixture
def scan(tmp_path: Path, fake, goniometer, colorimeter, header) -> Callable[..., Path]:
    """Run a scan over a journal, resumed where it is there; gives the journal's path."""

    def run(plan: FixedPlan, name: str = "scan.jsonl", attempts: int = 4, **options) -> Path:
        path = tmp_path / name
        made = header(plan, **{k: options.pop(k) for k in ("every_s",) if k in options})
        opened = JournalFile.resume(path) if path.exists() else JournalFile.create(path, made)
        with opened as journal:
            run_scan(
                journal,
                goniometer,
                colorimeter,
                retry_policy=RetryPolicy(attempts, sleep=fake.sleep),
                clock=fake.clock,
                **options,
            )
        return path

    return run


def test_every_reading_is_taken_once_in_the_plan_s_order(scan, plan: FixedPlan, fake) -> None:
    contents = read_journal(scan(plan))
    assert contents.finished
    assert len(contents.taken) == plan.steps == 2 * len(plan.cells)
    assert [t.step.cell for t in contents.taken] == sorted(2 * list(range(len(plan.cells))))
    assert fake.calls.index("home") < fake.calls.index("move")


def test_dark_and_white_at_start_end_and_between(scan, plan: FixedPlan) -> None:
    contents = read_journal(scan(plan, every_s=40.0))
    first, last = contents.taken[0].time_s, contents.taken[-1].time_s
    for target in (Target.DARK, Target.WHITE):
        times = [r.time_s for r in contents.references if r.target is target]
        assert min(times) < first
        assert max(times) > last
    series = {r.series for r in contents.references}
    assert len(series) >= (last - first) / 60
    assert series == set(range(len(series)))


def test_never_moves_before_homing_or_the_operator_s_word(scan, plan: FixedPlan, fake) -> None:
    scan(plan, stands_at=Position(0.0, 0.0, 0.0))
    assert "home" not in fake.calls
    assert fake.calls.index("assume") < fake.calls.index("move")


def test_without_homing_an_alarm_ends_the_scan(scan, plan: FixedPlan, fake) -> None:
    fake.fail("move", [None, None, MotionAlarmError("ALARM:1")])
    with pytest.raises(ScanStoppedError, match="no longer knows where it stands"):
        scan(plan, stands_at=Position(0.0, 0.0, 0.0))
    assert "home" not in fake.calls
    assert fake.calls[-1] == "stop"


FAULTS = [
    ("measure", InstrumentBusyError("ER02"), "busy"),
    ("measure", ConnectionLostError("colorimeter: no answer"), "connection lost"),
    ("move", MotionAlarmError("ALARM:1"), "motion alarm"),
    ("move", ConnectionLostError("goniometer: no answer"), "connection lost"),
    ("position", MotionAlarmError("the controller was reset"), "motion alarm"),
    ("position", ConnectionLostError("goniometer: the port is gone"), "connection lost"),
    ("home", MotionAlarmError("ALARM:8"), "motion alarm"),
    ("show sample", ConnectionLostError("goniometer: no answer"), "connection lost"),
    ("reconnect goniometer", ConnectionLostError("still gone"), "connection lost"),
]


@pytest.mark.parametrize(("call", "error", "kind"), FAULTS)
@pytest.mark.parametrize("at", [0, 1])
def test_a_fault_that_passes_changes_nothing(
    scan, plan: FixedPlan, fake, call: str, error: Exception, kind: str, at: int
) -> None:
    undisturbed = reduce_readings(read_journal(scan(plan, "undisturbed.jsonl")))
    if call == "reconnect goniometer":
        fake.fail("move", [ConnectionLostError("goniometer: no answer")])
        at = 0
    fake.fail(call, [*([None] * at if call != "home" else []), error, error])
    if call == "home":
        fake.fail("move", [None, MotionAlarmError("ALARM:1")])
    contents = read_journal(scan(plan, "disturbed.jsonl"))
    assert contents.finished
    assert kind in {fault.kind for fault in contents.faults}
    assert [t.step for t in contents.taken] == [
        plan.next_step(contents.taken[:i]) for i in range(plan.steps)
    ]
    disturbed = reduce_readings(contents)
    np.testing.assert_allclose(
        disturbed.measurement.values, undisturbed.measurement.values, rtol=1e-12
    )


def test_after_an_alarm_the_stage_is_homed_and_the_reading_taken_again(
    scan, plan: FixedPlan, fake
) -> None:
    fake.fail("position", [None] * 6 + [MotionAlarmError("ALARM:3")])
    scan(plan)
    at = [i for i, call in enumerate(fake.calls) if call == "position"][6]
    after = fake.calls[at + 1 : at + 5]
    assert after[0] == "home"
    assert after[1].startswith("show")
    assert after[2:] == ["move", "measure"]


def test_after_a_lost_line_it_is_opened_and_homed(scan, plan: FixedPlan, fake) -> None:
    fake.fail("move", [None] * 8 + [ConnectionLostError("goniometer: gone")])
    scan(plan)
    at = fake.calls.index("reconnect goniometer")
    assert fake.calls[at + 1] == "home"
    assert "reconnect colorimeter" not in fake.calls


def test_a_fault_that_stays_stops_the_scan_and_can_be_resumed(scan, plan: FixedPlan, fake) -> None:
    fake.fail("measure", [None] * 9 + [InstrumentBusyError("ER02: still warming up")] * 4)
    with pytest.raises(ScanStoppedError, match=r"ER02.*tried 4 times.*resume"):
        scan(plan)
    assert fake.calls[-1] == "stop"
    contents = read_journal(scan(plan))
    assert contents.finished
    assert len(contents.taken) == plan.steps
    assert [s.what for s in contents.sessions] == ["started", "stopped", "resumed", "finished"]


def test_an_error_of_no_known_kind_stops_at_once(scan, plan: FixedPlan, fake) -> None:
    fake.fail("measure", [None] * 9 + [InstrumentError("ER51: too hot")])
    with pytest.raises(ScanStoppedError, match=r"ER51: too hot; set it right, then resume"):
        scan(plan)
    assert fake.measures == 9


def test_ctrl_c_stops_the_stage_and_keeps_the_journal(scan, plan: FixedPlan, fake) -> None:
    fake.fail("move", [None] * 11 + [KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        scan(plan)
    assert fake.calls[-1] == "stop"
    path = scan(plan)
    contents = read_journal(path)
    assert len(contents.taken) == plan.steps
    assert "interrupted" in {s.what for s in contents.sessions}


def test_a_finished_journal_touches_no_instrument(scan, plan: FixedPlan, fake) -> None:
    path = scan(plan)
    before, text = len(fake.calls), path.read_bytes()
    scan(plan)
    assert len(fake.calls) == before
    assert path.read_bytes() == text


def test_over_range_is_confirmed_then_marked(scan, plan: FixedPlan, fake) -> None:
    fake.over_above = 1500.0
    contents = read_journal(scan(plan))
    over = [t for t in contents.taken if t.reading.range is Range.OVER]
    assert over
    assert np.isnan(over[0].reading.xyz).all()
    reduced = reduce_readings(contents)
    cells = {t.step.cell for t in over}
    assert int((~reduced.measurement.valid).sum()) == len(cells)
    assert fake.measures == len(contents.references) + len(contents.taken) + 2 * len(over)


@pytest.mark.parametrize("value", [np.nan, 1e30])
def test_values_that_cannot_be_are_not_kept(
    scan, plan: FixedPlan, fake, colorimeter, monkeypatch, value: float
) -> None:
    honest = colorimeter.measure
    answers = iter([False] * 7 + [True])

    def lies() -> object:
        reading = honest()
        if next(answers, False):
            reading.xyz[1] = value
        return reading

    monkeypatch.setattr(colorimeter, "measure", lies)
    contents = read_journal(scan(plan))
    assert [f.kind for f in contents.faults] == ["connection lost"]
    assert "is no reading" in contents.faults[0].text
    assert all(np.isfinite(t.reading.xyz).all() for t in contents.taken)


def test_a_white_without_light_stops_before_the_sample_is_read(
    scan, plan: FixedPlan, fake, goniometer, monkeypatch
) -> None:
    monkeypatch.setattr(goniometer, "show", lambda target: setattr(fake, "shown", Target.DARK))
    with pytest.raises(ScanStoppedError, match="no more light"):
        scan(plan)
    assert fake.measures == 3  # two dark, one white


def test_white_over_range_stops(scan, plan: FixedPlan, fake) -> None:
    fake.over_above = 100.0
    with pytest.raises(ScanStoppedError, match=r"white reference is over"):
        scan(plan)


def test_a_full_disk_leaves_the_journal_whole(scan, plan: FixedPlan, fake, tmp_path: Path) -> None:
    import resource

    scan_path = tmp_path / "scan.jsonl"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    fake.fail("measure", [None] * 4)
    real = fake.called

    def limited(call: str) -> None:
        if call == "measure" and fake.measures == 12:
            size = scan_path.stat().st_size
            resource.setrlimit(resource.RLIMIT_FSIZE, (size + 40, hard))  # cuts the next line
        real(call)

    fake.called = limited
    try:
        with pytest.raises(ScanStoppedError, match=r"readings are whole; make room"):
            scan(plan)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    fake.called = real
    assert fake.calls[-1] == "stop"
    contents = read_journal(scan_path)
    assert contents.torn_bytes == 0
    assert contents.taken
    assert len(read_journal(scan(plan)).taken) == plan.steps


def test_white_at_each_cell_changes_it_once_a_cell(scan, fake, header, tmp_path: Path) -> None:
    plan = make_plan(grid(step_deg=35, incidence=(0, 35)), "each", white_at_each=True)
    scan(plan)
    shown = [call for call in fake.calls if call.startswith("show")]
    assert sum(a != b for a, b in pairwise(shown)) <= len(plan.cells) + 4


@pytest.mark.parametrize(
    ("what", "value"),
    [
        ("goniometer", "another"),
        ("colorimeter", "another"),
        ("simulated", False),
        ("sample", "another shell"),
    ],
)
def test_another_rig_does_not_go_on_with_a_journal(
    tmp_path: Path, header, plan: FixedPlan, what: str, value: object
) -> None:
    with (
        JournalFile.create(tmp_path / "j.jsonl", header(plan)) as journal,
        pytest.raises(InputError, match=rf"was begun with {what} "),
    ):
        check_resumable(journal, header(plan, **{what: value}))


def test_another_plan_does_not_go_on_with_a_journal(tmp_path: Path, header, plan) -> None:
    other = make_plan(plan.cells, "small", repeats=3)
    with JournalFile.create(tmp_path / "j.jsonl", header(plan)) as journal:
        check_resumable(journal, header(plan))
        with pytest.raises(InputError, match="is of another plan"):
            check_resumable(journal, header(other))
