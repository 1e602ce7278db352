"""The scan's memory: one JSON object a line, only ever appended, on the disk before it counts.

The first line is the header: format version, the plan and its hash, the settings, the instruments,
whether they are simulated. Every later line is a `reading` of the plan, a `decision` of it (which
cells are read next, and why), a `reference` (dark or white), a `fault`, or a `session` mark
(started, resumed, interrupted, stopped, finished). A line that was cut by a crash is the last one,
and is taken off when the journal is opened to go on.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np

from raden_torch.capture.spectrometer.plan_json import plan_from_json
from raden_torch.capture.spectrometer.ports import ColorReading, Position, Range, Target
from raden_torch.capture.spectrometer.scan_plan import Decision, Plan, Step, TakenReading
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.capture.spectrometer.white_reference import White
from raden_torch.errors import InputError
from raden_torch.files import check_writable, written_beside

FORMAT = 1
MAX_BYTES = 8_000_000_000
FINISHED = "finished"


class JournalWriteError(Exception):
    """A record could not be put on the disk; what was there before is whole."""


@dataclass(frozen=True)
class Header:
    """What a journal says once, at its beginning.

    Attributes:
        plan: what is read, in which order.
        white: the white reference, and where it is read.
        reference_every_s: dark and white are read again after so many seconds.
        reference_readings: how many readings of each.
        goniometer, colorimeter: what the instruments said they are.
        simulated: True where the instruments are simulated.
        sample: the specimen's name.
        started: date and time in UTC.
        stated: what the rig states of its own uncertainty; nothing in the journals of old.
    """

    plan: Plan
    white: White
    reference_every_s: float
    reference_readings: int
    goniometer: str
    colorimeter: str
    simulated: bool
    sample: str
    started: str
    stated: StatedUncertainty = field(default_factory=StatedUncertainty)

    def as_json(self) -> dict[str, Any]:
        return {
            "record": "header",
            "format": FORMAT,
            "plan_hash": self.plan.hash,
            "plan": self.plan.as_json(),
            "white": self.white.as_json(),
            "reference_every_s": self.reference_every_s,
            "reference_readings": self.reference_readings,
            "goniometer": self.goniometer,
            "colorimeter": self.colorimeter,
            "simulated": self.simulated,
            "sample": self.sample,
            "started": self.started,
            "stated": self.stated.as_json(),
        }


@dataclass(frozen=True, slots=True)
class Reference:
    """One dark or white reading; those taken one after another have the same `series`."""

    series: int
    target: Target
    reading: ColorReading
    time_s: float


@dataclass(frozen=True, slots=True)
class Fault:
    """What an instrument did wrong, and how often the same reading had been tried by then."""

    kind: str
    text: str
    attempt: int
    time_s: float


@dataclass(frozen=True, slots=True)
class Session:
    """Where a run began or ended."""

    what: str
    text: str
    time_s: float


Record = TakenReading | Decision | Reference | Fault | Session


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
                    contents = JournalContents(_header(record))
                else:
                    _check_number(record, len(contents.taken))
                    contents.add(_record(record))
            except InputError as error:
                raise InputError(f"{path}: line {number}: {error}") from None
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                raise InputError(
                    f"{path}: line {number}: {type(error).__name__} {error}; not what a scan writes"
                ) from None
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
        with written_beside(target) as temporary, temporary.open("wb") as file:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
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
        line = memoryview(_line(_as_json(record, len(self.contents.taken))))
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


def _check_number(record: dict[str, Any], taken: int) -> None:
    if record["record"] == "reading" and record["number"] != taken:
        raise InputError(
            f"reading {record['number']} where {taken} was to follow; one is missing or there twice"
        )


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


def _header(record: dict[str, Any]) -> Header:
    if record.get("record") != "header":
        raise InputError("not the header of a scan's journal")
    if record["format"] != FORMAT:
        raise InputError(f"journal format: expected {FORMAT}, got {record['format']!r}")
    header = Header(
        plan=plan_from_json(record["plan"]),
        white=White.from_json(record["white"]),
        reference_every_s=float(record["reference_every_s"]),
        reference_readings=int(record["reference_readings"]),
        goniometer=str(record["goniometer"]),
        colorimeter=str(record["colorimeter"]),
        simulated=bool(record["simulated"]),
        sample=str(record["sample"]),
        started=str(record["started"]),
        stated=StatedUncertainty.from_json(record["stated"])
        if "stated" in record
        else StatedUncertainty(),
    )
    if header.plan.hash != record["plan_hash"]:
        raise InputError("the plan is not the one that its hash was made of; it was changed")
    return header


def _as_json(record: Record, number: int) -> dict[str, Any]:
    if isinstance(record, TakenReading):
        position = record.step.position
        return {
            "record": "reading",
            "number": number,
            "cell": record.step.cell,
            "target": record.step.target.value,
            "angles_deg": [position.incidence_deg, position.receiving_deg, position.tilt_deg],
            "time_s": record.time_s,
            **_reading_as_json(record.reading),
        }
    if isinstance(record, Decision):
        return {
            "record": "decision",
            "after": record.after,
            "cells": record.cells.tolist(),
            "why": record.why,
            "estimated_rms": record.rms,
            "estimated_log_error": record.log_error,
        }
    if isinstance(record, Reference):
        return {
            "record": "reference",
            "series": record.series,
            "target": record.target.value,
            "time_s": record.time_s,
            **_reading_as_json(record.reading),
        }
    if isinstance(record, Fault):
        return {
            "record": "fault",
            "kind": record.kind,
            "text": record.text,
            "attempt": record.attempt,
            "time_s": record.time_s,
        }
    return {
        "record": "session",
        "what": record.what,
        "text": record.text,
        "time_s": record.time_s,
    }


def _record(data: dict[str, Any]) -> Record:
    kind = data["record"]
    if kind == "decision":
        return Decision(
            int(data["after"]),
            np.array(data["cells"], np.float64).reshape(-1, 3),
            str(data["why"]),
            float(data["estimated_rms"]),
            float(data["estimated_log_error"]),
        )
    time_s = float(data["time_s"])
    if kind == "reading":
        position = Position(*(float(angle) for angle in data["angles_deg"]))
        step = Step(int(data["cell"]), position, Target(data["target"]))
        return TakenReading(step, _reading(data), time_s)
    if kind == "reference":
        return Reference(int(data["series"]), Target(data["target"]), _reading(data), time_s)
    if kind == "fault":
        return Fault(str(data["kind"]), str(data["text"]), int(data["attempt"]), time_s)
    if kind == "session":
        return Session(str(data["what"]), str(data["text"]), time_s)
    raise InputError(f"record {kind!r} is not known")


def _reading_as_json(reading: ColorReading) -> dict[str, Any]:
    data: dict[str, Any] = {
        "range": reading.range.value,
        "xyz": reading.xyz.tolist() if reading.range is Range.OK else None,
        "integration_s": reading.integration_s,
    }
    if reading.radiance is not None and reading.wavelengths_nm is not None:
        data["nm"] = _compact(reading.wavelengths_nm.tolist())
        data["radiance"] = reading.radiance.tolist()
    return data


def _reading(data: dict[str, Any]) -> ColorReading:
    xyz = np.array([math.nan] * 3 if data["xyz"] is None else data["xyz"], np.float64)
    if xyz.shape != (3,):
        raise ValueError(f"xyz of shape {list(xyz.shape)}")
    wavelengths = radiance = None
    if "radiance" in data:
        radiance = np.array(data["radiance"], np.float64)
        wavelengths = _expanded(data["nm"], len(radiance))
    integration = data["integration_s"]
    return ColorReading(
        xyz,
        Range(data["range"]),
        None if integration is None else float(integration),
        wavelengths,
        radiance,
    )


def _compact(wavelengths: Sequence[float]) -> Any:
    """First and last where they are evenly spaced: a spectrum has some 400 of them."""
    even = np.linspace(wavelengths[0], wavelengths[-1], len(wavelengths))
    return [wavelengths[0], wavelengths[-1]] if np.array_equal(even, wavelengths) else wavelengths


def _expanded(data: Sequence[float], count: int) -> Any:
    if len(data) == 2 and count != 2:
        return np.linspace(float(data[0]), float(data[1]), count)
    if len(data) != count:
        raise ValueError(f"{len(data)} wavelengths for {count} values")
    return np.array(data, np.float64)


def _lock(file: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing keeps a second scan away
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path}: another scan is using this journal") from None
