"""The engine of one machine: every item once, failures told, stages overlapped, memory bounded."""

from __future__ import annotations

import errno
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from raden_torch.errors import InputError
from raden_torch.interrupts import Interrupted
from raden_torch.sequences.job import Job, Outcome, done_alone
from raden_torch.sequences.local import LocalEngine


@dataclass
class Counting(Job[int, int, int, int]):
    """Adds 1 to numbers, and counts what is under way."""

    folder: Path
    waits: int = 0
    fails: dict[tuple[str, int], Exception] = field(default_factory=dict)
    under_way: set[int] = field(default_factory=set)
    most: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def shared(self) -> tuple[Path, ...]:
        return ()

    def relocated(self, places: Mapping[Path, Path]) -> Counting:
        return self

    @property
    def bytes_waiting(self) -> int:
        return self.waits

    @property
    def bytes_working(self) -> int:
        return self.waits

    def inputs(self, item: int) -> Sequence[Path]:
        return ()

    def output(self, item: int) -> Path:
        return self.folder / str(item)

    def prepare(self) -> int:
        return 1

    def is_done(self, item: int) -> bool:
        return self.output(item).exists()

    def read(self, prepared: int, item: int) -> int:
        with self.lock:
            self.under_way.add(item)
            self.most = max(self.most, len(self.under_way))
        self._fail("read", item)
        return item

    def work(self, prepared: int, read: int) -> int:
        self._fail("work", read)
        return read + prepared

    def write(self, prepared: int, worked: int, item: int) -> bool:
        self._fail("write", item)
        self.output(item).write_text(str(worked))
        with self.lock:
            self.under_way.discard(item)
        return True

    def _fail(self, stage: str, item: int) -> None:
        if (stage, item) in self.fails:
            with self.lock:
                self.under_way.discard(item)
            raise self.fails[stage, item]


def states(outcomes: Sequence[Outcome[int]]) -> dict[int, str]:
    return {o.item: o.state for o in outcomes}


def test_every_item_once(tmp_path: Path) -> None:
    job = Counting(tmp_path)
    (tmp_path / "3").write_text("older")
    outcomes = list(LocalEngine().run(job, range(40)))
    assert states(outcomes) == {n: "kept" if n == 3 else "written" for n in range(40)}
    assert len(outcomes) == 40
    texts = {int(path.name): path.read_text() for path in tmp_path.iterdir()}
    assert texts == {n: "older" if n == 3 else str(n + 1) for n in range(40)}
    assert all(
        set(o.seconds) == {"read", "work", "write"} for o in outcomes if o.state == "written"
    )


@pytest.mark.parametrize("stage", ["read", "work", "write"])
def test_one_that_fails_is_told_and_the_rest_goes_on(tmp_path: Path, stage: str) -> None:
    job = Counting(tmp_path, fails={(stage, 5): InputError("5: expected 6")})
    outcomes = list(LocalEngine().run(job, range(12)))
    assert states(outcomes) == {n: "failed" if n == 5 else "written" for n in range(12)}
    assert [o.message for o in outcomes if o.state == "failed"] == ["5: expected 6"]


def test_a_full_disk_ends_it(tmp_path: Path) -> None:
    full = OSError(errno.ENOSPC, "No space left on device", "lit.5.exr")
    job = Counting(tmp_path, fails={("write", n): full for n in range(5, 100)})
    outcomes = list(LocalEngine(readers=1, writers=1).run(job, range(100)))
    failed = [o for o in outcomes if o.state == "failed"]
    assert {o.message for o in failed} == {"lit.5.exr: No space left on device"}
    assert 1 <= len(failed) <= 4  # those that were under way
    assert len(outcomes) < 15


def test_a_closed_folder_is_a_frames_failure(tmp_path: Path) -> None:
    job = Counting(tmp_path, fails={("write", 1): OSError(errno.EACCES, "Permission denied", "x")})
    assert states(list(LocalEngine().run(job, range(9))))[8] == "written"


@pytest.mark.parametrize(("memory", "most"), [(100, 1), (250, 2), (399, 3), (100_000, 6)])
def test_memory_bounds_what_is_under_way(tmp_path: Path, memory: int, most: int) -> None:
    job = Counting(tmp_path, waits=100)
    engine = LocalEngine(readers=2, writers=2, memory=memory)
    assert engine.in_flight(job) == most
    assert len(list(engine.run(job, range(30)))) == 30
    assert job.most <= most


def test_less_memory_than_one_item_needs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="memory: expected at least 100 bytes"):
        list(LocalEngine(memory=99).run(Counting(tmp_path, waits=100), [1]))


def test_an_interrupt_ends_it_and_the_threads(tmp_path: Path) -> None:
    job = Counting(tmp_path, fails={("work", 7): Interrupted(2)})  # type: ignore[dict-item]
    before = threading.active_count()
    with pytest.raises(Interrupted):
        list(LocalEngine().run(job, range(100)))
    assert threading.active_count() == before
    assert len(list(tmp_path.iterdir())) < 20


def test_stages_overlap(tmp_path: Path) -> None:
    """Each read waits until another item has been read and a third is at work."""
    meeting = threading.Barrier(2, timeout=20)

    class Meeting(Counting):
        def read(self, prepared: int, item: int) -> int:
            if item > 0:
                meeting.wait()
            return item

        def work(self, prepared: int, read: int) -> int:
            if read < 4:
                meeting.wait()
            return read

    engine = LocalEngine(readers=1, writers=1)
    assert len(list(engine.run(Meeting(tmp_path), range(5)))) == 5


def test_one_alone(tmp_path: Path) -> None:
    job = Counting(tmp_path, fails={("work", 2): RuntimeError("a\nbug")})
    assert done_alone(job, 1, 1).state == "written"
    assert done_alone(job, 1, 1).state == "kept"
    assert done_alone(job, 1, 2).message == "RuntimeError: a bug"
