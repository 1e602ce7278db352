"""A goniospectrometer: scan."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from raden_torch.cli.batch.scan_queue import run_queue
from raden_torch.cli.endings import Ending, StoppedError
from raden_torch.cli.option_types import output
from raden_torch.cli.scan_options import PlanOptions, ReferenceOptions, RigOptions, SessionOptions
from raden_torch.cli.status import console, working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs
from raden_torch.interrupts import Interrupted

if TYPE_CHECKING:
    from rich.progress import Progress

    from raden_torch.capture.spectrometer.journal import JournalContents, JournalFile
    from raden_torch.capture.spectrometer.rig import Rig
    from raden_torch.capture.spectrometer.scan_plan import Plan
    from raden_torch.capture.spectrometer.scan_session import Instruments, References

STOPPED = 3
"""The exit code of a scan that stopped before its end and can be resumed."""


def scan(
    *,
    output: Annotated[Path | None, output("the measurement to write, .csv")] = None,
    session: SessionOptions = SessionOptions(),
    rig: RigOptions = RigOptions(),
    plan: PlanOptions = PlanOptions(),
    white: ReferenceOptions = ReferenceOptions(),
) -> None:
    from raden_torch.capture.spectrometer import scan_session
    from raden_torch.capture.spectrometer.journal import read_journal

    if session.queue is not None:
        usual = SessionOptions(queue=session.queue), RigOptions(), PlanOptions(), ReferenceOptions()
        if output is not None or (session, rig, plan, white) != usual:
            raise InputError("--queue: expected alone; the options of each scan are in its file")
        run_queue(session.queue)
        return
    _check(output, session, rig, white)
    if session.from_journal is not None:
        assert output is not None
        check_output(output, (".csv",), inputs=(session.from_journal,))
        _write(read_journal(session.from_journal), session.from_journal, output)
        return
    if output is not None:
        check_output(output, (".csv",), inputs=(rig.config, plan.kind, rig.specimen))
    scale = rig.scale(session.dry_run)
    with rig.rig(scale, plan.seed) as opened:
        if output is not None:
            inputs = (opened.white.file,)
            check_outputs(output, scan_session.journal_path(output), inputs=inputs)
        # a resumed scan has its plan in the journal
        is_known = session.check or (session.resume and not plan.is_made)
        wanted = None if is_known else plan.plan(opened.reachable)
        if session.dry_run:
            _print_forecast(opened, wanted, white.references(), session.reading_seconds)
            return
        sample = session.sample
        if rig.simulate:
            sample = sample or Path(rig.specimen).stem
        with scan_session.open_instruments(opened, operator := _Operator()) as instruments:
            if session.check:
                _print_check(opened, instruments, move=session.yes)
                return
            assert output is not None
            with scan_session.open_journal(
                scan_session.journal_path(output),
                opened,
                instruments,
                wanted,
                references=white.references(scale),
                sample=sample,
                resume=session.resume,
            ) as journal:
                # a simulated fault passes sooner; the computer is as slow as ever
                _run(journal, instruments, session.stands_at, operator, 1.0 / scale**0.5)
                _write(journal.contents, journal.path, output)


def _check(
    output: Path | None, session: SessionOptions, rig: RigOptions, white: ReferenceOptions
) -> None:
    """Refuse options that contradict each other."""
    if rig.simulate + (rig.config is not None) + (session.from_journal is not None) != 1:
        raise InputError(
            "scan: give --config RIG.toml, --simulate, --queue FILE.toml, or --from-journal"
        )
    if output is None and session.needs_output:
        raise InputError("scan: name the measurement to write, as -o shell.csv")
    if session.resume and output is None:
        raise InputError("--resume: name the measurement whose scan goes on, as -o shell.csv")
    if session.from_journal is not None and (
        output is None or session.check or session.dry_run or session.resume
    ):
        raise InputError("--from-journal reads one file and writes another: it goes with -o alone")
    if session.resume and white.are_made:
        raise InputError(
            "--resume: --white-every and --white-readings are in the journal; leave them out"
        )
    white.references()  # refused before a rig is opened


class _Operator:
    """Asks a person at the terminal, with the progress bar out of the way."""

    def __init__(self) -> None:
        self.bar: Progress | None = None

    def __call__(self, text: str) -> None:
        from raden_torch.capture.spectrometer.drivers import ask_at_terminal

        if self.bar is None:
            ask_at_terminal(text)
            return
        self.bar.stop()
        ask_at_terminal(text)
        self.bar.start()


def _print_forecast(
    rig: Rig, wanted: Plan | None, references: References, reading_s: float
) -> None:
    from raden_torch.capture.spectrometer import scan_session

    if wanted is None:
        raise InputError("--dry-run says what a plan takes; leave out --check and --resume")
    for line in scan_session.forecast(rig, wanted, references, reading_s=reading_s):
        print(line)


def _print_check(rig: Rig, instruments: Instruments, *, move: bool) -> None:
    from raden_torch.capture.spectrometer import scan_session

    for line in scan_session.check_rig(rig, instruments, move=move):
        print(line, flush=True)
    if not move:
        print("--yes also homes the rig and reads dark and white")


def _run(
    journal: JournalFile,
    instruments: Instruments,
    stands_at: tuple[float, float, float] | None,
    operator: _Operator,
    waiting_s: float,
) -> None:
    """Scan until the plan is done; anything else ends the command with how to go on."""
    from raden_torch.capture.spectrometer.ports import Position
    from raden_torch.capture.spectrometer.scan import RetryPolicy, ScanStoppedError, run_scan

    try:
        with _progress(journal, operator) as on_step:
            run_scan(
                journal,
                instruments.goniometer,
                instruments.colorimeter,
                stands_at=None if stands_at is None else Position(*stands_at),
                on_step=on_step,
                retry_policy=RetryPolicy(first_wait_s=waiting_s),
            )
    except ScanStoppedError as error:
        raise _stopped(journal, Ending(STOPPED, " ".join(str(error).split()))) from error
    except Interrupted as error:
        raise _stopped(journal, Ending(error.exit_code, f"stopped by {error}")) from error


def _stopped(journal: JournalFile, ending: Ending) -> StoppedError:
    """Says how to go on."""
    contents = journal.contents
    print(f"raden: {ending.message}", file=sys.stderr)
    partial = "" if not contents.taken else "; --from-journal writes what there is"
    print(
        f"raden: {len(contents.taken)} of {contents.plan.steps} readings are in "
        f"{journal.path}; go on with the same command and --resume{partial}",
        file=sys.stderr,
    )
    return StoppedError(ending)


@contextmanager
def _progress(journal: JournalFile, operator: _Operator) -> Iterator[Callable[[int, str], None]]:
    """A bar with the time that is left, on stderr where a person looks on."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("readings"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    contents = journal.contents
    with Progress(*columns, console=console(), speed_estimate_period=600) as bar:
        task = bar.add_task("", total=contents.plan.steps, completed=len(contents.taken), note="")
        operator.bar = bar
        yield lambda taken, note: bar.update(
            task, total=contents.plan.steps, completed=taken, note=note[:60]
        )


def _write(contents: JournalContents, journal: Path, output: Path) -> None:
    from raden_torch.capture.spectrometer.lab_report import make_report, with_report
    from raden_torch.capture.spectrometer.reduction import reduce_readings

    with working("reducing"):
        reduced = reduce_readings(contents)
        report = make_report(contents, reduced)
        with_report(reduced.measurement, report).save(output)
    print(f"{report}\nwrote {output}\njournal {journal}")
