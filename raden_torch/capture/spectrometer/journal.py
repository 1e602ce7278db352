"""The scan's memory: one JSON object a line, only ever appended, on the disk before it counts.

The first line is the header: format version, the plan and its hash, the settings, the instruments,
whether they are simulated. Every later line is a `reading` of the plan, a `decision` of it (which
cells are read next, and why), a `reference` (dark or white), a `fault`, or a `session` mark
(started, resumed, interrupted, stopped, finished). A line that was cut by a crash is the last one,
and is taken off when the journal is opened to go on.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from raden_torch.capture.spectrometer.journal_records import (
    Fault,
    Header,
    Record,
    Reference,
    Session,
    header_from_json,
    record_as_json,
    record_from_json,
)
from raden_torch.capture.spectrometer.scan_plan import Decision, TakenReading
from raden_torch.errors import InputError
from raden_torch.files import check_writable, write_durably

__all__ = ["Fault", "Header", "Record", "Reference", "Session"]  # beside what is defined here

MAX_BYTES = 8_000_000_000
FINISHED = "finished"


class JournalWriteError(Exception):
    """A record could not be put on the disk; what was there before is whole."""


@dataclass
class JournalContents:
    """All that a journal holds.

    `plan` is the header's, with the cells of all decisions so far. `whole_bytes` is where its last
    whole line ends, `torn_bytes` what was cut behind that.
    """

    header: Header
    taken: list[TakenReading] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    sessions: list[Session] = field(default_factory=list)
    whole_bytes: int = 0
    torn_bytes: int = 0

    def __post_init__(self) -> None:
        self.plan = self.header.plan

    @property
    def finished(self) -> bool:
        return any(session.what == FINISHED for session in self.sessions)

    def add(self, record: Record) -> None:
        """Raises InputError for a decision that the plan cannot have made here."""
        if isinstance(record, TakenReading):
            self.taken.append(record)
        elif isinstance(record, Decision):
            if record.after != len(self.taken) or self.plan.next_step(self.taken) is not None:
                raise InputError("a decision before all cells were read that were known")
            self.plan = self.plan.after(record)
            self.decisions.append(record)
        elif isinstance(record, Reference):
            self.references.append(record)
        elif isinstance(record, Fault):
            self.faults.append(record)
        else:
            self.sessions.append(record)


def read_journal(path: str | os.PathLike[str]) -> JournalContents:
    """Everything in a journal; a cut last line is left out and counted.

    Raises:
        InputError: not a journal, one of another format, a damaged line that is not the last, or
            readings that are not those of its plan: one missing, one twice.
    """
    path = Path(path)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(
            f"{path}: expected a journal of at most {MAX_BYTES / 1e9:g} GB, got {size / 1e9:.1f} GB"
        )
    contents: JournalContents | None = None
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            record = _parsed(line)
            if record is None:
                rest = file.read(1)
                if rest or contents is None:
                    what = "damaged" if contents else "not the header of a scan's journal"
                    raise InputError(f"{path}: line {number} is {what}; restore it from a copy")
                break
            try:
                if contents is None:
                    contents = JournalContents(header_from_json(record))
                else:
                    contents.add(record_from_json(record, len(contents.taken)))
            except InputError as error:
                raise InputError(f"{path}: line {number}: {error}") from None
            contents.whole_bytes += len(line)
    if contents is None:
        raise InputError(f"{path}: expected the journal of a scan, got an empty file")
    contents.torn_bytes = size - contents.whole_bytes
    _check_replay(path, contents)
    return contents


class Journal(Protocol):
    """What a scan needs of its journal: what is in it, and that it takes one record more."""

    contents: JournalContents

    def append(self, record: Record) -> None: ...


class JournalFile:
    """A journal open for appending; `contents` is always what is on the disk.

    Only one process can hold it. A line that cannot be written whole (a full disk) is taken off
    again.
    """

    def __init__(self, path: Path, contents: JournalContents) -> None:
        self.path = path
        self.contents = contents
        self._file = os.open(path, os.O_RDWR | os.O_APPEND)
        try:
            _lock(self._file, path)
            if os.fstat(self._file).st_size != contents.whole_bytes + contents.torn_bytes:
                raise InputError(f"{path}: another scan has just written to it")
            if contents.torn_bytes:
                os.ftruncate(self._file, contents.whole_bytes)
                os.fsync(self._file)
        except BaseException:
            os.close(self._file)
            raise

    @classmethod
    def create(cls, path: str | os.PathLike[str], header: Header) -> JournalFile:
        """Begin a journal. Raises InputError where there is one already."""
        target = check_writable(path)
        if target.exists():
            raise InputError(
                f"{target}: there is a journal of an earlier scan; continue it with `resume`, or "
                "move it away"
            )
        line = _line(header.as_json())
        write_durably(target, line)
        return cls(target, JournalContents(header, whole_bytes=len(line)))

    @classmethod
    def resume(cls, path: str | os.PathLike[str]) -> JournalFile:
        """Open a journal to go on with it; a cut last line is taken off."""
        path = Path(path)
        if not path.is_file():
            raise InputError(
                f"{path}: expected a journal to resume, got none; leave out `resume` to begin"
            )
        return cls(path, read_journal(path))

    def append(self, record: Record) -> None:
        """Put a record on the disk; it counts when this returns.

        Raises:
            JournalWriteError: it could not be written.
        """
        line = memoryview(_line(record_as_json(record, len(self.contents.taken))))
        size = len(line)
        try:
            while line:
                line = line[os.write(self._file, line) :]
            os.fsync(self._file)
        except OSError as error:
            self._take_back()
            raise JournalWriteError(f"{self.path}: {error.strerror}") from error
        except BaseException:  # Ctrl-C between two parts of a line, or behind the last
            if line:
                self._take_back()
            else:
                self._count(record, size)
            raise
        self._count(record, size)

    def _count(self, record: Record, size: int) -> None:
        self.contents.whole_bytes += size
        self.contents.torn_bytes = 0
        self.contents.add(record)

    def _take_back(self) -> None:
        with suppress(OSError):
            os.ftruncate(self._file, self.contents.whole_bytes)

    def close(self) -> None:
        os.close(self._file)

    def __enter__(self) -> JournalFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _check_replay(path: Path, contents: JournalContents) -> None:
    """Ask the plan again for every step: what was read must be what it says, in its order."""
    so_far: list[TakenReading] = []
    for number, taken in enumerate(contents.taken):
        if contents.plan.next_step(so_far) != taken.step:
            raise InputError(
                f"{path}: reading {number} (cell {taken.step.cell}) is not the one that the plan "
                "asks for there; the journal was changed"
            )
        so_far.append(taken)


def _parsed(line: bytes) -> dict[str, Any] | None:
    """The object in a line; None where the line is cut or damaged."""
    if not line.endswith(b"\n"):
        return None
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def _line(record: dict[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _lock(file: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing keeps a second scan away
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path}: another scan is using this journal") from None
