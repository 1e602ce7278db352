"""The journal: whole lines only, one process only, the plan's readings only."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raden_torch.capture.spectrometer.journal import (
    Fault,
    JournalFile,
    Reference,
    Session,
    read_journal,
)
from raden_torch.capture.spectrometer.ports import ColorReading, Range, Target
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import FixedPlan, TakenReading, make_plan
from raden_torch.errors import InputError


@pytest.fixture
def plan() -> FixedPlan:
    return make_plan(grid(step_deg=70), "coarse", repeats=2)


def readings(plan: FixedPlan, count: int) -> list[TakenReading]:
    taken: list[TakenReading] = []
    for i in range(count):
        step = plan.next_step(taken)
        assert step is not None
        taken.append(
            TakenReading(step, ColorReading(np.array([0.1, 1 / 3, i]), Range.OK, 0.5), 1e9 + i)
        )
    return taken


@pytest.fixture
def journal_of_ten(tmp_path: Path, header, plan: FixedPlan) -> Path:
    path = tmp_path / "scan.jsonl"
    with JournalFile.create(path, header(plan)) as journal:
        for taken in readings(plan, 10):
            journal.append(taken)
    return path


def test_what_is_written_is_read(tmp_path: Path, header, plan: FixedPlan) -> None:
    path = tmp_path / "scan.jsonl"
    nm = np.linspace(380.0, 780.0, 401)
    spectral = ColorReading(np.array([1.0, 2, 3]), Range.OK, 2.0, nm, np.sqrt(nm) * 1e-5)
    uneven = np.array([400.0, 500, 555])
    over = ColorReading(np.full(3, np.nan), Range.OVER)
    [first, second] = readings(plan, 2)
    records = [
        Session("started", "0 readings", np.float64(1.0)),
        Reference(0, Target.DARK, ColorReading(np.full(3, np.nan), Range.UNDER), 2.0),
        Reference(0, Target.WHITE, spectral, 3.0),
        Reference(0, Target.WHITE, ColorReading(np.ones(3), Range.OK, None, uneven, uneven), 3.5),
        TakenReading(first.step, spectral, 4.0),
        Fault("busy", "ER02 — not now", 1, 5.0),
        TakenReading(second.step, over, 6.0),
    ]
    with JournalFile.create(path, header(plan)) as journal:
        for record in records:
            journal.append(record)
        kept = journal.contents
    contents = read_journal(path)
    assert contents.header.as_json() == header(plan).as_json()
    for again in (contents, kept):
        assert again.sessions == [records[0]]
        assert again.faults == [records[5]]
        assert [t.step for t in again.taken] == [first.step, second.step]
        assert again.taken[1].reading.range is Range.OVER
    same = contents.taken[0].reading
    np.testing.assert_array_equal(same.xyz, spectral.xyz)
    np.testing.assert_array_equal(same.wavelengths_nm, nm)
    np.testing.assert_array_equal(same.radiance, spectral.radiance)
    assert same.integration_s == 2.0
    np.testing.assert_array_equal(contents.references[2].reading.wavelengths_nm, uneven)
    assert contents.whole_bytes == kept.whole_bytes == path.stat().st_size
    for line in path.read_text().splitlines():
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def test_a_cut_line_is_taken_off_wherever_it_was_cut(journal_of_ten: Path, plan: FixedPlan) -> None:
    whole = journal_of_ten.read_bytes()
    last = whole.rstrip(b"\n").rindex(b"\n") + 1
    for cut in range(last, len(whole)):
        journal_of_ten.write_bytes(whole[:cut])
        with JournalFile.resume(journal_of_ten) as journal:
            assert len(journal.contents.taken) == 9
            if cut % 7 == 0:
                journal.append(readings(plan, 10)[9])
                assert len(read_journal(journal_of_ten).taken) == 10
                assert journal_of_ten.read_bytes() == whole


@pytest.mark.parametrize(
    "tail", [b"\0" * 300, b"\0" * 300 + b"\n", b'{"record":\n', b"[1]\n", b"\xff"]
)
def test_what_a_power_cut_leaves_behind_is_taken_off(journal_of_ten: Path, tail: bytes) -> None:
    whole = journal_of_ten.read_bytes()
    journal_of_ten.write_bytes(whole + tail)
    with JournalFile.resume(journal_of_ten) as journal:
        assert len(journal.contents.taken) == 10
    assert journal_of_ten.read_bytes() == whole


def test_damage_in_the_middle_is_told(journal_of_ten: Path) -> None:
    lines = journal_of_ten.read_bytes().splitlines(keepends=True)
    lines[4] = lines[4][:20] + b"\n"
    journal_of_ten.write_bytes(b"".join(lines))
    with pytest.raises(InputError, match="line 5 is damaged"):
        read_journal(journal_of_ten)


def test_a_reading_twice_and_a_reading_missing_are_told(journal_of_ten: Path) -> None:
    lines = journal_of_ten.read_bytes().splitlines(keepends=True)
    journal_of_ten.write_bytes(b"".join([*lines[:5], lines[4], *lines[5:]]))
    with pytest.raises(InputError, match=r"line 6: reading 3 where 4 .*missing or there twice"):
        read_journal(journal_of_ten)
    journal_of_ten.write_bytes(b"".join([*lines[:5], *lines[6:]]))
    with pytest.raises(InputError, match=r"line 6: reading 5 where 4 .*missing or there twice"):
        read_journal(journal_of_ten)


def test_one_scan_at_a_time(journal_of_ten: Path) -> None:
    with (
        JournalFile.resume(journal_of_ten),
        pytest.raises(InputError, match="another scan is using this journal"),
    ):
        JournalFile.resume(journal_of_ten)
    JournalFile.resume(journal_of_ten).close()


def test_a_journal_is_not_begun_twice(journal_of_ten: Path, header, plan) -> None:
    before = journal_of_ten.read_bytes()
    with pytest.raises(InputError, match="continue it with `resume`"):
        JournalFile.create(journal_of_ten, header(plan))
    assert journal_of_ten.read_bytes() == before


def test_no_journal_no_resume(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a journal to resume, got none"):
        JournalFile.resume(tmp_path / "none.jsonl")


def test_a_changed_plan_is_noticed(journal_of_ten: Path) -> None:
    first, rest = journal_of_ten.read_text().split("\n", 1)
    data = json.loads(first)
    data["plan"]["cells"][3][0] += 1
    journal_of_ten.write_text(json.dumps(data) + "\n" + rest)
    with pytest.raises(InputError, match="line 1: the plan is not the one"):
        read_journal(journal_of_ten)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "journal format: expected 1, got 2"),
        ({"plan": {"kind": "clever"}}, "plan: kind: expected fixed or adaptive, got 'clever'"),
        ({"plan": 3}, "line 1"),
        ({"white": {}}, r"line 1: white\.position_deg: expected 3 numbers, got none"),
        ({"record": "reading"}, "not the header"),
    ],
)
def test_another_header_is_refused(journal_of_ten: Path, change: dict, message: str) -> None:
    first, rest = journal_of_ten.read_text().split("\n", 1)
    journal_of_ten.write_text(json.dumps(json.loads(first) | change) + "\n" + rest)
    with pytest.raises(InputError, match=message):
        read_journal(journal_of_ten)


@pytest.mark.parametrize(
    "data", [b"", b"\n", b"{}", b"incidence_deg,receiving_deg\n1,2\n", b"{}\n"]
)
def test_what_is_no_journal_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "j.jsonl"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"journal"):
        read_journal(path)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(at=st.integers(0, 10**6), value=st.integers(0, 255))
def test_a_changed_byte_is_told_or_harmless(journal_of_ten: Path, at: int, value: int) -> None:
    data = bytearray(journal_of_ten.read_bytes())
    data[at % len(data)] = value
    path = journal_of_ten.with_name("changed.jsonl")
    path.write_bytes(data)
    with suppress(InputError):
        # without the line end between them, the last two are one cut line
        assert 8 <= len(read_journal(path).taken) <= 10


def test_a_line_that_cannot_be_written_whole_is_taken_back(
    journal_of_ten: Path, plan: FixedPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = journal_of_ten.read_bytes()
    real = os.write
    calls = []

    def stops_half_way(file: int, data: bytes) -> int:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(file, bytes(data)[:25])

    with JournalFile.resume(journal_of_ten) as journal:
        monkeypatch.setattr(os, "write", stops_half_way)
        with pytest.raises(KeyboardInterrupt):
            journal.append(readings(plan, 11)[10])
        monkeypatch.undo()
        assert journal_of_ten.read_bytes() == whole
        journal.append(readings(plan, 11)[10])
    assert len(read_journal(journal_of_ten).taken) == 11
