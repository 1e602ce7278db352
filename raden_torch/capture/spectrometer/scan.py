"""The scan: take every reading of a plan, keep it, and get over what instruments do.

Dark and white are read when a session begins, when it ends, and every so often between. A reading
counts once it is in the journal and not before, so that a scan that was killed goes on from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.journal import (
    FINISHED,
    Fault,
    Header,
    Journal,
    JournalFile,
    JournalWriteError,
    Reference,
    Session,
)
from raden_torch.capture.spectrometer.ports import (
    Colorimeter,
    ColorReading,
    ConnectionLostError,
    Goniometer,
    InstrumentBusyError,
    InstrumentError,
    MotionAlarmError,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.reduction import reduce_readings
from raden_torch.capture.spectrometer.scan_plan import Step, TakenReading
from raden_torch.errors import InputError

POSITION_TOLERANCE_DEG = 0.1
"""How far from its cell the rig may stand, after a reading, for the reading to count."""

_LONGEST_WAIT_S = 60.0
_OVER_CONFIRMED = 3  # readings over range, one after another, before a cell is believed to be
_HUGE = 1e12  # no instrument tells more, in its own unit
_RECOVERABLE = {
    InstrumentBusyError: "busy",
    ConnectionLostError: "connection lost",
    MotionAlarmError: "motion alarm",
}


class ScanStoppedError(Exception):
    """A scan ended before its plan did; the journal is whole, and the message says what to do."""


@dataclass(frozen=True)
class RetryPolicy:
    """How often and at what intervals a failed reading is repeated before the scan stops.

    Attributes:
        attempts: how often one reading is tried.
        first_wait_s: before the second attempt; doubled before each further one, up to a minute.
        sleep: waits; for tests.
    """

    attempts: int = 8
    first_wait_s: float = 1.0
    sleep: Callable[[float], None] = time.sleep

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise InputError(f"attempts: expected at least 1, got {self.attempts}")


def check_resumable(journal: JournalFile, header: Header) -> None:
    """Raise InputError unless the journal's scan is the one that `header` would begin.

    The hash of the plan, the instruments' identities, the white reference, and whether they are
    simulated must agree.
    """
    kept = journal.contents.header
    if kept.plan.hash != header.plan.hash:
        raise InputError(
            f"{journal.path}: is of another plan ({kept.plan.name}) than this "
            f"({header.plan.name}): {kept.plan.difference(header.plan)}; leave out the plan's "
            "options to go on with it, or begin a new scan"
        )
    for what in ("simulated", "goniometer", "colorimeter", "white", "sample"):
        before, now = getattr(kept, what), getattr(header, what)
        if before != now:
            raise InputError(
                f"{journal.path}: was begun with {what} {before!r}, this is {now!r}; go on with "
                "what it was begun with, or begin a new scan"
            )


def run_scan(
    journal: Journal,
    goniometer: Goniometer,
    colorimeter: Colorimeter,
    *,
    stands_at: Position | None = None,
    on_step: Callable[[int, str], None] = lambda taken, note: None,
    retry_policy: RetryPolicy | None = None,
    clock: Callable[[], float] = time.time,
) -> None:
    """Take the readings that are missing from a journal, until its plan is done.

    The rig is homed first, unless `stands_at` says where it stands. However this ends, the stage
    is told to stop and the journal says how it ended.

    Args:
        journal: new, or opened to resume.
        stands_at: the operator's word for the rig's position; nothing is homed then, and an alarm
            or a lost controller ends the scan.
        on_step: called after every reading with how many there are and what is being done.

    Raises:
        ScanStoppedError: a fault outlasted its attempts, the white reference gives no light or
            too much, or the disk is full. `journal` can be resumed.
    """
    if journal.contents.finished:
        return
    scan = _Scan(journal, goniometer, colorimeter, on_step, retry_policy or RetryPolicy(), clock)
    before = len(journal.contents.taken)
    try:
        scan.note("resumed" if journal.contents.sessions else "started", f"{before} readings")
        if stands_at is not None:
            scan.take_word(stands_at)
        scan.to_the_end()
        scan.note(FINISHED, f"{len(journal.contents.taken)} readings")
    except JournalWriteError as error:
        _leave(scan, "stopped", str(error))
        raise ScanStoppedError(
            f"{error}; its {len(journal.contents.taken)} readings are whole; make room on the "
            "disk, then resume"
        ) from error
    except InstrumentError as error:
        _leave(scan, "stopped", str(error))
        raise ScanStoppedError(f"{error}; set it right, then resume") from error
    except (ScanStoppedError, InputError) as error:
        _leave(scan, "stopped", str(error))
        raise
    except BaseException as error:
        _leave(scan, "interrupted", str(error) or type(error).__name__)
        raise


def _leave(scan: _Scan, what: str, why: str) -> None:
    """Stop the stage, then say so: neither may keep the other from happening."""
    with suppress(InstrumentError):
        scan.goniometer.stop()
    with suppress(JournalWriteError):
        scan.note(what, why)


class _Scan:
    """What a running scan remembers beside its journal."""

    def __init__(
        self,
        journal: Journal,
        goniometer: Goniometer,
        colorimeter: Colorimeter,
        on_step: Callable[[int, str], None],
        retry_policy: RetryPolicy,
        clock: Callable[[], float],
    ) -> None:
        self.journal = journal
        self.goniometer = goniometer
        self.colorimeter = colorimeter
        self.on_step = on_step
        self.retry_policy = retry_policy
        self.clock = clock
        self.may_home = True
        self.must_home = not goniometer.homed
        self.lost: set[Goniometer | Colorimeter] = set()  # whose line has to be opened again
        self.references_s: float | None = None  # when they were last read, in this session

    def note(self, what: str, text: str) -> None:
        self.journal.append(Session(what, text, self.clock()))

    def take_word(self, position: Position) -> None:
        self.goniometer.assume_position(position)
        self.may_home = self.must_home = False

    def to_the_end(self) -> None:
        while (step := self._next_step()) is not None:
            if self._references_due():
                self._read_references()
            self._take(step)
        self._read_references()

    def _next_step(self) -> Step | None:
        """What the plan asks for; a decision that leads there is on the disk before it counts."""
        contents = self.journal.contents
        step = contents.plan.next_step(contents.taken)
        if step is not None:
            return step
        decision = contents.plan.decide(
            len(contents.taken), lambda: reduce_readings(contents).measurement
        )
        if decision is None:
            return None
        self.journal.append(decision)
        self.on_step(len(contents.taken), decision.why)
        return contents.plan.next_step(contents.taken)

    def _take(self, step: Step) -> None:
        reading = self._tried(step.position, step.target)
        self.journal.append(TakenReading(step, reading, self.clock()))
        self.on_step(len(self.journal.contents.taken), "")

    def _references_due(self) -> bool:
        if self.references_s is None:
            return True
        every_s = self.journal.contents.header.reference_every_s
        return not 0 <= self.clock() - self.references_s < every_s

    def _read_references(self) -> None:
        """One series: dark, then white, at the white's own position."""
        header, references = self.journal.contents.header, self.journal.contents.references
        series = references[-1].series + 1 if references else 0
        dark = np.zeros(3)
        for target in (Target.DARK, Target.WHITE):
            self.on_step(len(self.journal.contents.taken), f"reading {target.value}")
            for _ in range(header.reference_readings):
                reading = self._tried(header.white.position, target)
                if target is Target.WHITE:
                    self._check_white(reading, dark)
                elif reading.range is Range.OVER:
                    raise ScanStoppedError(
                        "the dark reading is over range: light reaches the detector with the lamp "
                        "shut; darken the room or mend the shutter, then resume"
                    )
                elif reading.range is Range.OK:
                    dark = reading.xyz
                self.journal.append(Reference(series, target, reading, self.clock()))
        self.references_s = self.clock()

    def _check_white(self, reading: ColorReading, dark: Floats) -> None:
        if reading.range is not Range.OK:
            raise ScanStoppedError(
                f"the white reference is {reading.range.value} the instrument's range; change the "
                "lamp's level or the instrument's aperture, then begin again"
            )
        if not (reading.xyz > dark).all():
            raise ScanStoppedError(
                f"the white reference gives no more light (Y = {reading.xyz[1]:g}) than the dark "
                f"(Y = {dark[1]:g}); check lamp, shutter and white reference, then resume"
            )

    def _tried(self, position: Position, target: Target) -> ColorReading:
        """One reading, tried again after faults that pass."""
        wait_s = self.retry_policy.first_wait_s
        for attempt in range(1, self.retry_policy.attempts + 1):
            try:
                return self._confirmed(position, target)
            except tuple(_RECOVERABLE) as error:
                last = error
                kind = next(name for cls, name in _RECOVERABLE.items() if isinstance(error, cls))
                self.journal.append(Fault(kind, str(error), attempt, self.clock()))
                self.on_step(len(self.journal.contents.taken), f"{kind}: {error}")
            if attempt < self.retry_policy.attempts:
                self.retry_policy.sleep(wait_s)
                wait_s = min(2 * wait_s, _LONGEST_WAIT_S)
        raise ScanStoppedError(
            f"{last} (tried {self.retry_policy.attempts} times); see to the instrument, then resume"
        ) from last

    def _confirmed(self, position: Position, target: Target) -> ColorReading:
        """One reading; over range only if it is so several times: a glint passes."""
        for _ in range(_OVER_CONFIRMED):
            reading = self._read(position, target)
            if reading.range is not Range.OVER:
                break
        return reading

    def _read(self, position: Position, target: Target) -> ColorReading:
        with self._talking_to(self.goniometer):
            self._make_ready()
            self.goniometer.show(target)  # before every reading: homing may have undone it
            self.goniometer.move(position)
        with self._talking_to(self.colorimeter):
            reading = self.colorimeter.measure()
            _check_plausible(reading)
        with self._talking_to(self.goniometer):
            _check_still_there(self.goniometer.position(), position)
        return reading

    def _make_ready(self) -> None:
        """Home a stage that does not know where it is."""
        if self.goniometer.homed and not self.must_home:
            return
        if not self.may_home:
            raise ScanStoppedError(
                "the rig no longer knows where it stands, and was started without homing; put it "
                "where it is said to stand, then resume"
            )
        self.must_home = True
        self.goniometer.home()
        self.must_home = False

    @contextmanager
    def _talking_to(self, instrument: Goniometer | Colorimeter) -> Iterator[None]:
        """Open a line that was lost again first; remember what a fault in here calls for."""
        try:
            if instrument in self.lost:
                instrument.reconnect()
                self.lost.remove(instrument)
            yield
        except ConnectionLostError:
            self.lost.add(instrument)
            self.must_home |= instrument is self.goniometer
            raise
        except MotionAlarmError:
            self.must_home = True
            raise


def _check_plausible(reading: ColorReading) -> None:
    if reading.range is Range.OK and not (abs(reading.xyz) < _HUGE).all():
        raise ConnectionLostError(f"colorimeter: XYZ {reading.xyz.tolist()} is no reading")
    if reading.radiance is not None and not (abs(reading.radiance) < _HUGE).all():
        raise ConnectionLostError("colorimeter: a spectrum with values that are not numbers")


def _check_still_there(stands: Position, wanted: Position) -> None:
    away = max(
        abs(stands.incidence_deg - wanted.incidence_deg),
        abs(stands.receiving_deg - wanted.receiving_deg),
        abs(stands.tilt_deg - wanted.tilt_deg),
    )
    if not away <= POSITION_TOLERANCE_DEG:
        raise MotionAlarmError(
            f"goniometer: stands {away:g} degrees from where the reading was to be taken"
        )
