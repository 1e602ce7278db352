"""The engine of many machines: items are tasks of a Dask cluster (decision 41).

A run is an `Order` that a plugin brings to every worker once, also to those that come later. A
worker that is fit for it says so by a resource of the run's name, and tasks go to such workers
alone. What was not done when the scheduler went away is sent again when it is back.

An order is pickled, as Dask's own messages are: whoever reaches a scheduler's port can run code on
its workers in any case. It is bytes until a worker has found this package, and never a file.
"""

from __future__ import annotations

import pickle
import queue
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from secrets import token_hex
from typing import Any

from raden_torch.errors import InputError
from raden_torch.files import remove_leftovers
from raden_torch.sequences.cluster_client import Lost, RunOnCluster, connected
from raden_torch.sequences.cluster_worker import Order, absolute, shared_files
from raden_torch.sequences.job import Item, Job, Outcome
from raden_torch.sequences.machine import this_machine

_CONNECT_S = 10.0
_LOOK_S = 5.0
_TICK_S = 1.0
_AHEAD = 2
"""Tasks per thread of a worker that are sent: one at work, one that waits for it."""
_MOST_SHARED = 1 << 30


@dataclass(frozen=True)
class DaskEngine:
    """The workers of a scheduler.

    Attributes:
        scheduler: its address, as tcp://host:8786.
        wait_s: how long to wait for workers, and for a scheduler that went away.
        mixed: whether workers whose results differ in the last bits do, too: those with another
            instruction set, and GPUs, which are used then.
        say: called with a line about workers and the scheduler, for a person.
    """

    scheduler: str
    wait_s: float = 60.0
    mixed: bool = False
    say: Callable[[str], object] = lambda line: None

    def run(
        self, job: Job[Item, Any, Any, Any], items: Sequence[Item]
    ) -> Generator[Outcome[Item], None, None]:
        """As `Engine.run`.

        Raises:
            InputError: no scheduler there; no fit worker within `wait_s`, or one that came back;
                the shared files take too much.
        """
        left = dict.fromkeys(items)
        record = _Record({item for item in items if job.output(item).exists()})
        with connected(self.scheduler, _CONNECT_S):
            pass  # before anything else is done
        with ExitStack() as marks:
            order = self._order(job, list(left), marks)
            payload = pickle.dumps(order)
            while left:
                try:
                    for outcome in self._sent(payload, order, list(left), record):
                        del left[outcome.item]
                        yield outcome
                        if outcome.is_last:
                            left.clear()
                            break
                except Lost:
                    self.say(
                        f"{self.scheduler}: the scheduler went away; {len(left)} of {len(items)} "
                        f"are left; waiting up to {self.wait_s:g} s for it"
                    )
                    self._await_scheduler(len(left))
            for item in record.disturbed:
                remove_leftovers(order.job.output(absolute(item)))

    def _order(self, job: Job[Any, Any, Any, Any], items: list[Any], marks: ExitStack) -> Order:
        job = absolute(job, [str(path) for path in job.shared])
        folders = {job.output(absolute(item)).parent for item in items}
        seen = [marks.enter_context(_mark(folder)) for folder in sorted(folders)]
        seen += [path for path in job.inputs(absolute(items[0])) if path.exists()]
        return Order(
            job,
            shared_files(job, _MOST_SHARED),
            tuple(map(str, seen)),
            this_machine(),
            self.mixed,
        )

    def _sent(
        self, payload: bytes, order: Order, items: list[Any], record: _Record
    ) -> Iterator[Outcome[Any]]:
        """The items until all are done.

        Raises:
            Lost: the scheduler went away.
        """
        with (
            connected(self.scheduler, _CONNECT_S) as client,
            RunOnCluster(client, f"raden-{token_hex(4)}", payload, self.say) as run,
        ):
            run.await_workers(self.wait_s)
            yield from _Flow(run, items, self.wait_s, record).outcomes()

    def _await_scheduler(self, left: int) -> None:
        latest = time.monotonic() + self.wait_s
        while True:
            left_s = latest - time.monotonic()
            timeout_s = min(max(left_s, _TICK_S), _CONNECT_S)
            with suppress(InputError), connected(self.scheduler, timeout_s):
                self.say(f"{self.scheduler}: the scheduler is back")
                return
            if left_s < 0:
                raise InputError(
                    f"{self.scheduler}: expected the scheduler back within {self.wait_s:g} s, got "
                    f"none; {left} are left, which the same command does when it is back"
                )


@dataclass
class _Record:
    """What is known of a run's outputs.

    Attributes:
        there: items whose output was there before.
        disturbed: items under way when a worker, or the scheduler, was lost: their outputs may have
            been written without a word, or be left in temporary files.
    """

    there: set[Any]
    disturbed: set[Any] = field(default_factory=set)


class _Flow:
    """Items on their way: no more are sent than the workers soon need, so that those who come
    later get some, and a lost worker loses few."""

    def __init__(self, run: RunOnCluster, items: list[Any], wait_s: float, record: _Record) -> None:
        self._run, self._wait_s, self._record = run, wait_s, record
        self._waiting, self._under_way = deque(items), dict[Any, Any]()
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._lately: set[Any] = set()
        """Items that were under way since the last look at the workers."""
        self._seen_at = time.monotonic()

    def outcomes(self) -> Iterator[Outcome[Any]]:
        """Of all items, as they finish; raises what `_look` does."""
        try:
            yield from self._outcomes()
            self._look(0)
        except Lost:
            self._record.disturbed |= self._lately
            raise

    def _outcomes(self) -> Iterator[Outcome[Any]]:
        while self._waiting or self._under_way:
            self._look(_LOOK_S)
            self._send()
            try:
                future = self._finished.get(timeout=_TICK_S)
            except queue.Empty:
                continue
            outcome = self._run.outcome(future, self._under_way[future.key])
            if outcome.state == "kept" and outcome.item not in self._record.there:
                self._look(0)  # has a worker been lost that wrote it?
                if outcome.item in self._record.disturbed:
                    outcome = replace(outcome, state="written")
            del self._under_way[future.key]
            yield outcome

    def _look(self, after_s: float) -> None:
        """At the workers, unless that was done less than `after_s` ago.

        Raises:
            Lost: the scheduler went away.
            InputError: there has been no worker for too long.
        """
        lost = self._run.look(after_s)
        if lost:
            self._record.disturbed |= self._lately
        if lost is not None:
            self._lately = set(self._under_way.values())
        if self._run.slots:
            self._seen_at = time.monotonic()
        elif time.monotonic() - self._seen_at > self._wait_s:
            left = len(self._waiting) + len(self._under_way)
            raise InputError(
                f"{self._run.scheduler}: expected a worker within {self._wait_s:g} s, got none; "
                f"{left} are left, which the same command does when there is one"
            )

    def _send(self) -> None:
        while self._waiting and len(self._under_way) < _AHEAD * self._run.slots:
            item = self._waiting.popleft()
            future = self._run.send(absolute(item))
            self._under_way[future.key] = item
            self._lately.add(item)
            future.add_done_callback(self._finished.put)


@contextmanager
def _mark(folder: Path) -> Iterator[Path]:
    """A hidden file that only those see who see the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f".raden-{token_hex(8)}"
    path.touch()
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
