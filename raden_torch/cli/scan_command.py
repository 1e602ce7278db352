"""A goniospectrometer: scan."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raden_torch.cli.common import app, pair, triple, working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs
from raden_torch.interrupts import Interrupted

if TYPE_CHECKING:
    from rich.progress import Progress

    from raden_torch.capture.spectrometer.journal import JournalContents, JournalFile
    from raden_torch.capture.spectrometer.rig import Rig
    from raden_torch.capture.spectrometer.scan_session import Instruments

STOPPED = 3
"""The exit code of a scan that stopped before its end and can be resumed."""

_FINE_STEP_DEG = 2.5


@app.command(epilog="Example: raden scan --config rig.toml --sample yakogai -o shell.csv")
def scan(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="the measurement to write, .csv")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="the rig file; see docs/rig.md")] = None,
    simulate: Annotated[
        bool,
        typer.Option(
            "--simulate", help="use a simulated rig instead, over the same serial protocols"
        ),
    ] = False,
    specimen: Annotated[
        str, typer.Option(help="what the simulated rig measures: yakogai, …, or a measurement file")
    ] = "yakogai",
    sample: Annotated[str | None, typer.Option(help="name of the specimen")] = None,
    plan: Annotated[
        str | None,
        typer.Option(help="full (the grid; the default), random (off the grid), or a CSV of cells"),
    ] = None,
    step: Annotated[float | None, typer.Option(help="step of the grid, degrees; default 5")] = None,
    incidence: Annotated[
        str | None, typer.Option(help="incidence range of the grid, as 0:70, degrees")
    ] = None,
    receiving: Annotated[
        str | None, typer.Option(help="receiving range of the grid, as -70:70")
    ] = None,
    tilt: Annotated[str | None, typer.Option(help="tilt range of the grid, as -70:70")] = None,
    readings: Annotated[
        int | None,
        typer.Option(
            help="number of random readings, default 200; with --adaptive the most, default 40 % "
            "of the grid"
        ),
    ] = None,
    adaptive: Annotated[
        bool,
        typer.Option(
            "--adaptive",
            help="a coarse pass, then further readings where they reduce the error most",
        ),
    ] = False,
    target_error: Annotated[
        float | None,
        typer.Option(help="with --adaptive: stop when the estimated errors are below this"),
    ] = None,
    repeats: Annotated[int | None, typer.Option(help="readings of each cell; default 1")] = None,
    white_at_each: Annotated[
        bool, typer.Option("--white-at-each", help="read the white reference in every cell")
    ] = False,
    white_every: Annotated[
        float | None,
        typer.Option(help="interval between dark and white readings, minutes; default 10"),
    ] = None,
    white_readings: Annotated[
        int | None, typer.Option(help="number of dark and of white readings each time; default 5")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="continue a scan from its journal")
    ] = False,
    from_journal: Annotated[
        Path | None,
        typer.Option(help="write what a journal holds so far; needs no instrument"),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="show what would be read and how long it takes")
    ] = False,
    reading_seconds: Annotated[
        float, typer.Option(help="time of one reading, with --dry-run only")
    ] = 3.0,
    check: Annotated[
        bool, typer.Option("--check", help="talk to each instrument, without moving anything")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="with --check: home, and read dark and white")
    ] = False,
    stands_at: Annotated[
        str | None,
        typer.Option(help="do not home: the rig stands at this incidence,receiving,tilt"),
    ] = None,
    time_scale: Annotated[
        float, typer.Option(help="how much faster than a real rig a simulated one runs")
    ] = 300.0,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="fault of the simulated rig and its probability, as busy=0.01; may be repeated"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="seed of random cells, simulated noise and faults")] = 0,
) -> None:
    """Measure a sample with a goniospectrometer, from its plan to a measurement file."""
    from raden_torch.capture.spectrometer import scan_session
    from raden_torch.capture.spectrometer.journal import read_journal
    from raden_torch.capture.spectrometer.plan_choice import PlanChoice

    if simulate + (config is not None) + (from_journal is not None) != 1:
        raise InputError("scan: give --config RIG.toml, --simulate, or --from-journal")
    if output is None and not (check or dry_run):
        raise InputError("scan: name the measurement to write, as -o shell.csv")
    if yes and not check:
        raise InputError("--yes goes with --check")
    if resume and output is None:
        raise InputError("--resume: name the measurement whose scan goes on, as -o shell.csv")
    if from_journal is not None:
        if output is None or check or dry_run or resume:
            raise InputError(
                "--from-journal reads one file and writes another: it goes with -o alone"
            )
        check_output(output, (".csv",), inputs=(from_journal,))
        _write(read_journal(from_journal), from_journal, output)
        return
    if output is not None:
        check_output(output, (".csv",), inputs=(config, plan, specimen))
    journal_path = None if output is None else scan_session.journal_path(output)
    position = None if stands_at is None else triple("--stands-at", stands_at)
    if resume and (white_every is not None or white_readings is not None):
        raise InputError(
            "--resume: --white-every and --white-readings are in the journal; leave them out"
        )
    every_s = 600.0 if white_every is None else 60 * white_every
    references = scan_session.References(every_s, 5 if white_readings is None else white_readings)
    choice = PlanChoice(
        plan,
        step,
        _limits("incidence", incidence),
        _limits("receiving", receiving),
        _limits("tilt", tilt),
        readings,
        repeats,
        white_at_each,
        seed,
        adaptive,
        target_error,
    )
    scale = 1.0 if dry_run or not simulate else time_scale
    waiting = 1.0 / scale**0.5  # a simulated fault passes sooner; the computer is as slow as ever
    with _rig_of(config, specimen, scale, fault or [], seed) as rig:
        if output is not None and journal_path is not None:
            check_outputs(output, journal_path, inputs=(rig.white.file,))
        # a resumed scan has its plan in the journal
        wanted = None if check or (resume and not choice.is_made) else choice.plan(rig.reachable)
        if dry_run:
            if wanted is None:
                raise InputError("--dry-run says what a plan takes; leave out --check and --resume")
            for line in scan_session.forecast(rig, wanted, references, reading_s=reading_seconds):
                print(line)
            return
        if simulate:
            references = scan_session.References(every_s / scale, references.readings)
            sample = sample or Path(specimen).stem
        operator = _Operator()
        with scan_session.open_instruments(rig, operator) as instruments:
            if check:
                _print_check(rig, instruments, move=yes)
                return
            assert output is not None
            assert journal_path is not None
            with scan_session.open_journal(
                journal_path,
                rig,
                instruments,
                wanted,
                references=references,
                sample=sample,
                resume=resume,
            ) as journal:
                _run(journal, instruments, position, operator, waiting)
                _write(journal.contents, journal.path, output)


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


@contextmanager
def _rig_of(
    config: Path | None, specimen: str, time_scale: float, faults: list[str], seed: int
) -> Iterator[Rig]:
    """The rig of a file; or a simulated one, which runs inside the block."""
    if config is not None:
        from raden_torch.capture.spectrometer.rig_config import load_rig

        if faults:
            raise InputError("--fault: only a simulated rig has faults on demand")
        yield load_rig(config)
        return
    from raden_torch.capture.spectrometer.simulation import Fault, simulated_rig
    from raden_torch.optics import SPECIMENS, simulate_specimen

    chances = {}
    for name, chance in (pair("--fault", text) for text in faults):
        if name not in {fault.value for fault in Fault}:
            known = ", ".join(fault.value for fault in Fault)
            raise InputError(f"--fault: expected one of {known}, got {name}")
        chances[Fault(name)] = _number("--fault", chance)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(specimen)
        if specimen in SPECIMENS:
            path = Path(folder) / f"{specimen}.csv"
            with working("simulating the specimen"):
                simulate_specimen(specimen, step_deg=_FINE_STEP_DEG).save(path)
        with simulated_rig(path, seed=seed, faults=chances, time_scale=time_scale) as simulated:
            yield simulated.rig


def _print_check(rig: Rig, instruments: Instruments, *, move: bool) -> None:
    from raden_torch.capture.spectrometer import scan_session

    for line in scan_session.check_rig(rig, instruments, move=move):
        print(line, flush=True)


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
        _say_resume(journal, str(error))
        raise typer.Exit(STOPPED) from error
    except Interrupted as error:
        _say_resume(journal, f"stopped by {error}")
        raise typer.Exit(error.exit_code) from error


def _say_resume(journal: JournalFile, why: str) -> None:
    contents = journal.contents
    typer.echo(f"raden: {' '.join(why.split())}", err=True)
    partial = "" if not contents.taken else "; --from-journal writes what there is"
    typer.echo(
        f"raden: {len(contents.taken)} of {contents.plan.steps} readings are in "
        f"{journal.path}; go on with the same command and --resume{partial}",
        err=True,
    )


@contextmanager
def _progress(journal: JournalFile, operator: _Operator) -> Iterator[Callable[[int, str], None]]:
    """A bar with the time that is left, on stderr where a person looks on."""
    from rich.console import Console
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
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=600) as bar:
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


def _limits(name: str, text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"--{name}: expected first and last in degrees, as 0:70, got {text}")
    return _number(f"--{name}", low), _number(f"--{name}", high)


def _number(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{option}: expected a number, got {text}") from None
