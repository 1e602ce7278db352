"""`raden sweep`: one command over a table of its options, one row a file."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Self

from cyclopts import CycloptsError, Parameter

from raden_torch.cli.engine_options import ON_THIS_MACHINE, EngineOptions
from raden_torch.cli.option_types import argument, output
from raden_torch.cli.refusals import refusal
from raden_torch.cli.sequence_run import run_items
from raden_torch.errors import InputError
from raden_torch.files import write_once
from raden_torch.measurement.text_file import read_text
from raden_torch.sequences.job import Job
from raden_torch.sequences.local import LocalEngine
from raden_torch.sequences.report import Report

COMMANDS = ("render", "fit", "relight", "plot", "export")
"""Subcommands that write one file."""
_NAME = "name"
_MOST_ROWS = 1_000_000
_MOST_BYTES = 1 << 28


@dataclass(frozen=True)
class Row:
    """A row of the table: the file to write, and the options of its own."""

    name: str
    options: tuple[str, ...]


@dataclass(frozen=True)
class SweepJob(Job[Row, None, Row, bool]):
    """A subcommand run once for each row.

    Attributes:
        folder: of the results.
        command: its name, and what all rows share; files are absolute.
        force: replace results that are there.
    """

    folder: Path
    command: tuple[str, ...]
    force: bool = False

    @property
    def shared(self) -> tuple[Path, ...]:
        return tuple(Path(word) for word in self.command[1:] if Path(word).is_file())

    def relocated(self, places: Mapping[Path, Path]) -> Self:
        name, *words = self.command
        moved = (str(places.get(Path(word), word)) for word in words)
        return replace(self, command=(name, *moved))

    def inputs(self, item: Row) -> tuple[Path, ...]:
        return tuple(Path(word) for word in item.options if Path(word).is_file())

    def output(self, item: Row) -> Path:
        return self.folder / item.name

    def arguments(self, item: Row, path: Path) -> list[str]:
        """Of `raden`, to write a row's result there."""
        return [*self.command, *item.options, "--output", str(path)]

    def prepare(self) -> None:
        return None

    def is_done(self, item: Row) -> bool:
        return self.output(item).exists() and not self.force

    def read(self, prepared: None, item: Row) -> Row:
        return item

    def work(self, prepared: None, read: Row) -> bool:
        from raden_torch.cli import run

        def write(path: Path) -> None:
            try:
                with redirect_stdout(io.StringIO()):
                    run(self.arguments(read, path))
            except SystemExit as ended:
                raise InputError(f"{read.name}: ended with exit code {ended.code}") from None

        self.folder.mkdir(parents=True, exist_ok=True)
        return write_once(self.output(read), write, replace=self.force)

    def write(self, prepared: None, worked: bool, item: Row) -> bool:
        return worked


def sweep(
    table: Annotated[
        Path, argument('a CSV: a column "name" of files to write, and a column for each option')
    ],
    /,
    *command: Annotated[
        str, Parameter(help="the subcommand that all rows share, with its options, after --")
    ],
    output: Annotated[Path, output("the folder for the results")],
    force: Annotated[
        bool, Parameter(help="replace results that are there; they are kept unless stated")
    ] = False,
    where: EngineOptions = ON_THIS_MACHINE,
) -> None:
    if not command or command[0] not in COMMANDS:
        raise InputError(
            f"sweep: expected {', '.join(COMMANDS)} after --, got {' '.join(command[:1]) or 'none'}"
        )
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder, got a file")
    job = SweepJob(output, _with_absolute_files(command), force)
    rows = read_rows(table)
    for row in rows:
        _check(job, row, table)
    engine = where.among(LocalEngine(readers=1, writers=1))
    report = Report(rows, named=lambda failed: ", ".join(row.name for row in failed))
    run_items(job, rows, engine, output, report, noun="row", called=lambda row: row.name)


def read_rows(path: Path) -> list[Row]:
    """The rows of a table: an empty cell leaves its option out, "yes" is a switch.

    Raises:
        InputError: no table; no column "name"; names that are no plain, different file names.
    """
    lines = [
        line for line in csv.reader(io.StringIO(read_text(path, _MOST_BYTES).text)) if any(line)
    ]
    columns = [column.strip() for column in lines[0]] if lines else []
    if columns.count(_NAME) != 1 or not all(columns):
        raise InputError(
            f"{path}: expected a line of column names, one of them {_NAME}, got "
            f"{','.join(columns) or 'nothing'}"
        )
    if not 1 < len(lines) <= _MOST_ROWS:
        raise InputError(f"{path}: expected 1…{_MOST_ROWS} rows, got {len(lines) - 1}")
    rows, seen = list[Row](), set[str]()
    for number, cells in enumerate(lines[1:], 2):
        if len(cells) != len(columns):
            raise InputError(
                f"{path}: row {number}: expected {len(columns)} cells, got {len(cells)}"
            )
        values = [cell.strip() for cell in cells]
        name = values[columns.index(_NAME)]
        if Path(name).name != name or name.startswith(".") or not name or name in seen:
            raise InputError(
                f"{path}: row {number}: name: expected a file name, different in each row, got "
                f"{name or 'nothing'}"
            )
        seen.add(name)
        rows.append(Row(name, tuple(_options(columns, values))))
    return rows


def _options(columns: Sequence[str], values: Sequence[str]) -> list[str]:
    given: list[str] = []
    for column, value in zip(columns, values, strict=True):
        if value and column != _NAME:
            given += [f"--{column}"] if value == "yes" else [f"--{column}", value]
    return list(_with_absolute_files(given))


def _with_absolute_files(words: Sequence[str]) -> tuple[str, ...]:
    """As other machines need them."""
    return tuple(str(Path(word).absolute()) if Path(word).is_file() else word for word in words)


def _check(job: SweepJob, row: Row, table: Path) -> None:
    """Raise InputError for options that the subcommand does not take."""
    from raden_torch.cli.command_table import app

    if "--frames" in job.arguments(row, job.output(row)):
        raise InputError(f"{table}: {row.name}: expected one file a row, got --frames")
    try:
        app.parse_args(job.arguments(row, job.output(row)), print_error=False, exit_on_error=False)
    except CycloptsError as error:
        raise InputError(f"{table}: {row.name}: {refusal(error)}") from None
    except InputError as error:
        raise InputError(f"{table}: {row.name}: {error}") from None
