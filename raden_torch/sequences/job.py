"""What is done with each of many items, in three stages that an engine may overlap.

An item is a small thing that travels: a frame's number, or a path. A `Job` is a frozen dataclass of
plain data and paths, which travels, too; what is large (a model, surroundings) each process makes
of it once, by `prepare`. Engines: `local.py` for this machine, `cluster.py` for many.
"""

from __future__ import annotations

import errno
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, Protocol, Self, TypeVar

from raden_torch.errors import InputError

Item = TypeVar("Item")
Prepared = TypeVar("Prepared")
Read = TypeVar("Read")
Worked = TypeVar("Worked")
_T = TypeVar("_T")

Stage = Literal["read", "work", "write"]
State = Literal["written", "kept", "failed"]

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""Errors of a write after which no other frame can be written, either."""


class Job(ABC, Generic[Item, Prepared, Read, Worked]):
    """What is done with each item. Subclasses are frozen dataclasses that can be pickled."""

    @property
    @abstractmethod
    def shared(self) -> tuple[Path, ...]:
        """All files that every item needs, as the model and the surroundings."""

    @abstractmethod
    def relocated(self, places: Mapping[Path, Path]) -> Self:
        """The same job with copies of its shared files: `{path in shared: its copy}`."""

    @abstractmethod
    def inputs(self, item: Item) -> Sequence[Path]:
        """Files that this item alone needs."""

    @abstractmethod
    def output(self, item: Item) -> Path:
        """The file that is written."""

    @abstractmethod
    def prepare(self) -> Prepared:
        """What all items share, loaded: called once in each process."""

    @abstractmethod
    def is_done(self, item: Item) -> bool:
        """Whether the output is there and is kept.

        Raises:
            InputError: it is there, and is none of this job's (a picture of another size).
        """

    @abstractmethod
    def read(self, prepared: Prepared, item: Item) -> Read:
        """First stage: files into memory. Several threads may be in it, each with its item."""

    @abstractmethod
    def work(self, prepared: Prepared, read: Read) -> Worked:
        """Second stage: no thread but one is in it at a time; it may use all processors."""

    @abstractmethod
    def write(self, prepared: Prepared, worked: Worked, item: Item) -> bool:
        """Third stage, by several threads as the first: the output appears, whole.

        Returns:
            Whether it was put in place; False where another process has done so meanwhile.
        """

    @property
    def bytes_waiting(self) -> int:
        """The most that one item takes while it waits between two stages."""
        return 0

    @property
    def bytes_working(self) -> int:
        """The most that the item takes, and the second stage beside it."""
        return 0


@dataclass(frozen=True)
class Outcome(Generic[Item]):
    """What became of an item.

    Attributes:
        state: "kept" where the output was there.
        message: of a failed one: one line that says why.
        seconds: that each stage took, as far as it came.
        is_last: nothing more can be written (the disk is full), so the engine takes no new items.
    """

    item: Item
    state: State
    message: str = ""
    seconds: Mapping[Stage, float] = field(default_factory=dict)
    is_last: bool = False


class Engine(Protocol):
    """Who does the items."""

    def run(
        self, job: Job[Item, Any, Any, Any], items: Sequence[Item]
    ) -> Generator[Outcome[Item], None, None]:
        """Outcomes as items finish, in any order; one that fails does not keep the others back.

        Where the loop is left before its end, by an error or Ctrl-C, items under way are given up
        and leave no partial file.

        Raises:
            InputError: what `Job.prepare` raises.
        """


class Timed:
    """An item on its way through the stages: their seconds, and what became of it."""

    def __init__(self, item: Any) -> None:
        self.item, self.seconds = item, dict[Stage, float]()
        self.stage: Stage = "read"

    def stage_of(self, stage: Stage, call: Callable[..., _T], *arguments: Any) -> _T:
        """What the call returns; its time counts for the stage."""
        self.stage, start = stage, time.perf_counter()
        try:
            return call(*arguments)
        finally:
            self.seconds[stage] = time.perf_counter() - start

    def outcome(self, state: State) -> Outcome[Any]:
        return Outcome(self.item, state, seconds=dict(self.seconds))

    def failed(self, error: Exception) -> Outcome[Any]:
        """What is told of an error."""
        is_full = self.stage == "write" and isinstance(error, OSError) and error.errno in _FULL
        return Outcome(self.item, "failed", message_of(error), dict(self.seconds), is_full)


def done_alone(
    job: Job[Item, Prepared, Any, Any],
    prepared: Prepared,
    item: Item,
    working: AbstractContextManager[object] | None = None,
) -> Outcome[Item]:
    """One item through all stages, one after the other; raises nothing but interrupts.

    Args:
        working: held in the second stage: a lock, where several threads do items of a job.
    """
    timed = Timed(item)
    try:
        if job.is_done(item):
            return timed.outcome("kept")
        read = timed.stage_of("read", job.read, prepared, item)
        with working or nullcontext():
            worked = timed.stage_of("work", job.work, prepared, read)
        is_ours = timed.stage_of("write", job.write, prepared, worked, item)
    except Exception as error:
        return timed.failed(error)
    return timed.outcome("written" if is_ours else "kept")


def message_of(error: Exception) -> str:
    """An error in one line, as the command line says it."""
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename or 'output'}: {error.strerror}"
    elif isinstance(error, InputError):
        text = str(error)
    elif isinstance(error, MemoryError) or "allocate memory" in str(error):
        text = "not enough memory"
    else:
        text = f"{type(error).__name__}: {error}"
    return " ".join(text.split())
