"""scan --queue: scans one after another, each with its journal, and one report.

    ask = true                     # the default: before each scan of a real rig, the operator
    [defaults]                     # options of `raden scan` that all scans share
    config = "rig.toml"            # paths are seen from the queue's folder
    step = 10
    [[scan]]
    sample = "yakogai 3"
    output = "yakogai_3.csv"

All options are read before the first scan begins; a wrong one refuses the queue. A scan that was
finished is skipped; one that has a journal goes on from there. One that fails is
told, its journal kept, and the rest go on, unless its rig no longer answers (`raden scan --check`):
then the scans that are left on that rig are not begun.
"""

from __future__ import annotations

import contextlib
import io
import tomllib
from pathlib import Path
from typing import Any

import msgspec

from raden_torch.cli.batch.job import Job, Outcome, check_command, run_command
from raden_torch.cli.batch.report import Batch
from raden_torch.cli.batch.table_arguments import arguments_of
from raden_torch.cli.endings import WRONG_INPUT
from raden_torch.errors import InputError
from raden_torch.schema import checked, read_document

_RIG_KEYS = ("config", "simulate", "specimen", "time_scale", "time-scale", "fault")
_IN_THE_JOURNAL = ("white_every", "white-every", "white_readings", "white-readings")
_NOT_OF_A_QUEUE = ("queue", "resume", "from_journal", "from-journal", "check", "dry_run", "dry-run")


class _Queue(msgspec.Struct, forbid_unknown_fields=True):
    """The file; the tables' keys are options of `raden scan`."""

    scan: list[dict[str, Any]]
    defaults: dict[str, Any] = {}
    ask: bool = True


def run_queue(path: Path) -> None:
    """Take the scans of a queue's file.

    Raises:
        InputError: a wrong file; afterwards, where a scan failed or was not begun.
    """
    queue = checked(read_document(path, "a queue of scans", tomllib.loads), _Queue, str(path))
    scans = _scans(path, queue)
    batch = Batch(f"scans of {path}", path.with_suffix(".report.json"), list(scans))
    gone: dict[str, str] = {}
    with batch.alone():
        for output, table in scans.items():
            rig = str(table.get("config", "the simulated rig"))
            if _is_finished(path.parent / output):
                batch.skip(_job(path, output, table))
            elif rig in gone:
                batch.record(Outcome(output, "not begun", gone[rig], WRONG_INPUT))
            else:
                if queue.ask and "config" in table:
                    _ask_for_the_sample(table, output)
                outcome = batch.run(_job(path, output, table))
                if outcome.state == "failed" and (why := _no_answer(path, table)):
                    gone[rig] = f"{rig} does not answer: {why}"
    batch.finish()


def _scans(path: Path, queue: _Queue) -> dict[str, dict[str, Any]]:
    """Each scan's options, defaults included, by its output."""
    found: dict[str, dict[str, Any]] = {}
    for place, own in enumerate(queue.scan, 1):
        where = f"{path}: scan {place}"
        table = queue.defaults | own
        for key in _NOT_OF_A_QUEUE:
            if key in table:
                raise InputError(f"{where}: expected no {key}, which is not of a queue")
        output = table.pop("output", None)
        if not isinstance(output, str) or "output" in queue.defaults:
            raise InputError(f"{where}: output: expected the file to write, .csv, got {output!r}")
        if output in found:
            raise InputError(f"{where}: output: expected another file than scan {output!r} has")
        found[output] = table
        check_command(_job(path, output, table).commands[0], where)
    if not found:
        raise InputError(f"{path}: scan: expected one [[scan]] or more, got none")
    return found


def _job(path: Path, output: str, table: dict[str, Any]) -> Job:
    """The scan, from its beginning or from its journal."""
    options = dict(table)
    if _journal(path.parent / output).exists():
        options = {k: v for k, v in table.items() if k not in _IN_THE_JOURNAL} | {"resume": True}
    command = ("scan", *arguments_of(options, str(path)), f"--output={output}")
    return Job(output, path.parent, (command,), (output,))


def _journal(output: Path) -> Path:
    from raden_torch.capture.spectrometer.scan_session import journal_path

    return journal_path(output)


def _is_finished(output: Path) -> bool:
    """Whether its measurement is there, and its journal says that the scan came to its end."""
    from raden_torch.capture.spectrometer.journal import read_journal

    journal = _journal(output)
    try:
        return output.exists() and journal.exists() and read_journal(journal).finished
    except InputError:
        return False  # a damaged journal: the scan says so


def _ask_for_the_sample(table: dict[str, Any], output: str) -> None:
    from raden_torch.capture.spectrometer.drivers import ask_at_terminal

    ask_at_terminal(f"{table['config']}: mount {table.get('sample', output)!r}")


def _no_answer(path: Path, table: dict[str, Any]) -> str:
    """What is wrong with a scan's rig; empty where it answers."""
    rig = {key: table[key] for key in _RIG_KEYS if key in table}
    if "config" not in rig:
        return ""  # a simulated rig is another one for each scan
    with contextlib.chdir(path.parent):
        ending = run_command(("scan", *arguments_of(rig, str(path)), "--check"), io.StringIO())
    return "" if ending is None else ending.message
