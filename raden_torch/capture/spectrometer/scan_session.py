"""From a rig and a plan to a running scan: its journal, its instruments."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from raden_torch.capture.spectrometer import duration
from raden_torch.capture.spectrometer.journal import Header, JournalFile
from raden_torch.capture.spectrometer.lab_report import now_utc
from raden_torch.capture.spectrometer.ports import (
    Colorimeter,
    ColorReading,
    Goniometer,
    InstrumentError,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.rig import Ask, Rig
from raden_torch.capture.spectrometer.scan import check_resumable
from raden_torch.capture.spectrometer.scan_plan import Plan
from raden_torch.capture.spectrometer.travel import travel_deg
from raden_torch.capture.spectrometer.white_reference import Triple, White
from raden_torch.errors import InputError

_MOST_READINGS = 1000


@dataclass(frozen=True)
class References:
    """How often dark and white are read, and how many readings each time."""

    every_s: float = 600.0
    readings: int = 5

    def __post_init__(self) -> None:
        if not self.every_s > 0:
            raise InputError(
                f"white interval: expected more than 0 min, got {self.every_s / 60:g} min"
            )
        if not 2 <= self.readings <= _MOST_READINGS:
            raise InputError(
                f"white readings: expected 2…{_MOST_READINGS} (two at least, since their spread "
                f"estimates the instrument's), got {self.readings}"
            )


@dataclass(frozen=True)
class Instruments:
    """Both instruments of a rig, open."""

    goniometer: Goniometer
    colorimeter: Colorimeter


def journal_path(output: Path) -> Path:
    """Where the journal of a measurement file lies: beside it."""
    return output.with_name(f"{output.stem}.journal.jsonl")


@contextmanager
def open_instruments(rig: Rig, ask: Ask | None = None) -> Iterator[Instruments]:
    """Open both; nothing moves. `ask` speaks to the operator, where the rig needs one.

    Raises:
        InputError: one is not there, or is something else.
    """
    with ExitStack() as stack:
        try:
            colorimeter = rig.colorimeter()
            stack.callback(_closed, colorimeter)
            goniometer = rig.goniometer(ask)
            stack.callback(_closed, goniometer)
        except InstrumentError as error:
            raise InputError(str(error)) from error
        yield Instruments(goniometer, colorimeter)


def white_of(rig: Rig, plan: Plan) -> White:
    """The rig's white reference, as this plan uses it.

    Raises:
        InputError: it reflects nothing, is not known where it is needed, or cannot be reached.
    """
    white = rig.white
    reason = rig.reachable(white.geometry)
    if reason is not None:
        raise InputError(f"{rig.name}: the white reference is out of reach: {reason}")
    cells = plan.cells.tolist() if plan.white_at_each else []
    return White(
        position=white.geometry,
        xyz=_triple(white.xyz(white.geometry)),
        name=white.name,
        at_cells=tuple(_triple(white.xyz(Position(*cell))) for cell in cells),
        relative_std=white.relative_std,
    )


def open_journal(
    path: Path,
    rig: Rig,
    instruments: Instruments,
    plan: Plan | None,
    *,
    references: References,
    sample: str | None,
    resume: bool,
) -> JournalFile:
    """Begin a journal, or open the one that is there to go on with it.

    Args:
        plan: None to take the journal's own.
        sample: the specimen's name; None for the journal's own, or none.

    Raises:
        InputError: there is a journal and `resume` is False, or none and it is True; the journal
            is of another plan or rig; what is left of the plan is out of reach.
    """
    if not resume:
        if plan is None:
            raise InputError("a plan is needed to begin a scan")
        return JournalFile.create(path, _header(rig, instruments, plan, references, sample or ""))
    journal = JournalFile.resume(path)
    try:
        kept = journal.contents.header
        own = plan or kept.plan
        name = kept.sample if sample is None else sample
        check_resumable(journal, _header(rig, instruments, own, references, name))
        for cell in own.may_read.tolist():
            reason = rig.reachable(Position(*cell))
            if reason is not None:
                raise InputError(f"{path}: its cell {cell} is out of reach now: {reason}")
    except BaseException:
        journal.close()
        raise
    return journal


def forecast(
    rig: Rig, plan: Plan, references: References, *, reading_s: float = duration.READING_S
) -> Iterator[str]:
    """What a plan reads, how far it travels and how long it takes; no instrument is needed.

    Raises:
        InputError: the white reference is not known where it is needed, or cannot be reached.
    """
    expected = duration.expected_duration(
        plan,
        rig.goniometer_settings,
        white_of(rig, plan),
        every_s=references.every_s,
        readings=references.readings,
        reading_s=reading_s,
    )
    cells = plan.likely_cells()
    known = len(cells) == len(plan.cells)
    most = "" if known else f"at most, {len(plan.cells)} cells first; "
    yield f"{rig.name}: {plan.name}, {most}{len(cells)} cells, {plan.steps} readings"
    for reason, count in plan.why_excluded().items():
        yield f"excluded: {count} cells: {reason}"
    if known:
        yield (
            f"travel: {plan.travel_deg:.0f} deg summed over the axes; in the order given "
            f"{plan.as_given_deg:.0f} ({plan.as_given_deg / max(plan.travel_deg, 1e-9):.2g} times)"
        )
    else:
        yield f"travel: at most {travel_deg(cells):.0f} deg summed over the axes"
    yield f"expected{'' if known else ' at most'}: {expected}"
    yield (
        f"counted with {reading_s:g} s a reading, {duration.CHANGE_S:g} s a change of sample and "
        "white, the rig's speed and settling time, dark and white "
        f"{references.readings} times every {references.every_s / 60:g} min"
    )


def check_rig(rig: Rig, instruments: Instruments, *, move: bool) -> Iterator[str]:
    """Talk to each instrument; one line for each answer. Moves only where `move` is True.

    Raises:
        InputError: an instrument does not answer as it should.
    """
    try:
        yield f"rig: {rig.name}{' (simulated)' if rig.simulated else ''}"
        yield f"goniometer: {instruments.goniometer.identity}"
        if instruments.goniometer.homed:
            yield f"  stands at {_words(instruments.goniometer.position())}"
        else:
            yield "  not homed"
        yield f"colorimeter: {instruments.colorimeter.identity}"
        yield f"  {instruments.colorimeter.status()}"
        if not move:
            yield "nothing was moved"
            return
        instruments.goniometer.home()
        yield "homed"
        for target in (Target.DARK, Target.WHITE):
            instruments.goniometer.show(target)
            instruments.goniometer.move(rig.white.geometry)
            yield f"{target.value} at {_words(rig.white.geometry)}: " + _reading_in_words(
                instruments.colorimeter.measure()
            )
    except BaseException as error:
        if move:
            with suppress(InstrumentError):
                instruments.goniometer.stop()
        if isinstance(error, InstrumentError):
            raise InputError(str(error)) from error
        raise


def _header(
    rig: Rig, instruments: Instruments, plan: Plan, references: References, sample: str
) -> Header:
    return Header(
        plan=plan,
        white=white_of(rig, plan),
        reference_every_s=references.every_s,
        reference_readings=references.readings,
        goniometer=instruments.goniometer.identity,
        colorimeter=instruments.colorimeter.identity,
        simulated=rig.simulated,
        sample=sample,
        started=now_utc(),
        stated=rig.stated,
    )


def _closed(instrument: Goniometer | Colorimeter) -> None:
    """A line that is dead already needs no closing."""
    with suppress(InstrumentError, OSError):
        instrument.close()


def _triple(xyz: object) -> Triple:
    x, y, z = (float(value) for value in xyz)  # type: ignore[attr-defined]
    return x, y, z


def _words(position: Position) -> str:
    return (
        f"incidence {position.incidence_deg:.2f}, receiving {position.receiving_deg:.2f}, "
        f"tilt {position.tilt_deg:.2f}"
    )


def _reading_in_words(reading: ColorReading) -> str:
    if reading.range is not Range.OK:
        return f"{reading.range.value} range"
    x, y, z = reading.xyz
    return f"X {x:.5g}, Y {y:.5g}, Z {z:.5g}"
