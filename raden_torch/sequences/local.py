"""The engine of one machine: threads read and write while the calling thread works."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

import torch

from raden_torch.errors import InputError
from raden_torch.sequences.job import Item, Job, Outcome, Timed

_KEPT = object()
"""In place of what was read: there is nothing to do."""


def _processors() -> int:
    """Those that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _readers() -> int:
    return min(max(_processors() // 4, 2), 4)


def _writers() -> int:
    return min(max(_processors() // 3, 2), 6)  # to compress takes longer than to decompress


@dataclass(frozen=True)
class LocalEngine:
    """Overlaps the stages of different items.

    Attributes:
        readers, writers: threads of the first and the last stage; two of each, or more where there
            are more than eight processors.
        memory: bytes for all items under way, beside what the program takes.
        prepared: what `Job.prepare` makes, where it has been made already.
    """

    readers: int = field(default_factory=_readers)
    writers: int = field(default_factory=_writers)
    memory: int = 4 * 1024**3
    prepared: Any = None

    def in_flight(self, job: Job[Any, Any, Any, Any]) -> int:
        """How many items are under way at most: read, waiting, at work, or being written.

        Raises:
            InputError: not even one fits the memory.
        """
        most = self.readers + self.writers + 2
        room = self.memory - job.bytes_working
        if room < 0:
            raise InputError(
                f"memory: expected at least {job.bytes_working} bytes for one frame, got "
                f"{self.memory}"
            )
        return most if job.bytes_waiting == 0 else min(most, 1 + room // job.bytes_waiting)

    def room(self, job: Job[Any, Any, Any, Any]) -> dict[str, int]:
        """`in_flight`, and the bytes that these items may take (`memory_bytes`)."""
        most = self.in_flight(job)
        return {
            "in_flight": most,
            "memory_bytes": job.bytes_working + (most - 1) * job.bytes_waiting,
        }

    def run(
        self, job: Job[Item, Any, Any, Any], items: Sequence[Item]
    ) -> Generator[Outcome[Item], None, None]:
        """As `Engine.run`."""
        most = self.in_flight(job)
        prepared = job.prepare() if self.prepared is None else self.prepared
        threads = torch.get_num_threads()
        reading, writing = (
            ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,))
            for count in (self.readers, self.writers)
        )
        try:
            yield from _Pipeline(job, prepared, reading, writing, most).run(items)
        finally:
            for pool in (reading, writing):
                pool.shutdown(wait=True, cancel_futures=True)
            torch.set_num_threads(threads)  # what its threads set reaches parts of torch for all


class _Pipeline:
    """The items under way."""

    def __init__(
        self,
        job: Job[Any, Any, Any, Any],
        prepared: Any,
        reading: ThreadPoolExecutor,
        writing: ThreadPoolExecutor,
        most: int,
    ) -> None:
        self._job, self._prepared, self._most = job, prepared, most
        self._reading, self._writing = reading, writing
        self._reads: dict[Future[Any], Timed] = {}
        self._writes: dict[Future[bool], Timed] = {}

    def run(self, items: Sequence[Any]) -> Iterator[Outcome[Any]]:
        waiting = deque(items)
        while waiting or self._reads or self._writes:
            while waiting and len(self._reads) + len(self._writes) < self._most:
                timed = Timed(waiting.popleft())
                self._reads[self._reading.submit(self._read, timed)] = timed
            done, _ = wait({*self._reads, *self._writes}, return_when=FIRST_COMPLETED)
            for outcome in self._finished(done):
                if outcome.is_last:
                    waiting.clear()
                yield outcome

    def _finished(self, done: set[Future[Any]]) -> Iterator[Outcome[Any]]:
        """Of futures that are done: writes first, since they make room."""
        for future in [f for f in self._writes if f in done]:
            timed = self._writes.pop(future)
            try:
                yield timed.outcome("written" if future.result() else "kept")
            except Exception as error:
                yield timed.failed(error)
        for future in [f for f in self._reads if f in done]:  # in the items' order
            timed = self._reads.pop(future)
            try:
                read = future.result()
                if read is _KEPT:
                    yield timed.outcome("kept")
                    continue
                worked = timed.stage_of("work", self._job.work, self._prepared, read)
            except Exception as error:
                yield timed.failed(error)
                continue
            write = self._writing.submit(self._write, timed, worked)
            self._writes[write] = timed

    def _read(self, timed: Timed) -> Any:
        if self._job.is_done(timed.item):
            return _KEPT
        return timed.stage_of("read", self._job.read, self._prepared, timed.item)

    def _write(self, timed: Timed, worked: Any) -> bool:
        return timed.stage_of("write", self._job.write, self._prepared, worked, timed.item)
