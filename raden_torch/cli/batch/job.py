"""One job of a batch: `raden` commands in a folder, run here, and what became of them."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Literal

from raden_torch.cli.endings import Ending, ending_of
from raden_torch.errors import InputError
from raden_torch.interrupts import Interrupted

State = Literal["done", "skipped", "failed", "not begun"]
Command = tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """What is to be run.

    Attributes:
        name: in the report.
        folder: in which the commands run: the paths in them are seen from there.
        commands: arguments of `raden`, one command after another.
        outputs: the files and folders that they write, seen from `folder`.
    """

    name: str
    folder: Path
    commands: tuple[Command, ...]
    outputs: tuple[str, ...]

    def fingerprint(self) -> str:
        """Of the commands, and of the size and time of every file that they name: a job with
        another one is not the job that was done."""
        given = {word for command in self.commands for word in command}
        words = given | {word.partition("=")[2] for word in given} - {""}
        files = []
        with contextlib.chdir(self.folder):
            for word in sorted(words - set(self.outputs)):
                for path in sorted(glob(word)):
                    with contextlib.suppress(OSError):  # a link that leads nowhere
                        about = os.stat(path)
                        files.append((path, about.st_size, about.st_mtime_ns))
        return hashlib.sha256(json.dumps([self.commands, files]).encode()).hexdigest()

    def has_outputs(self) -> bool:
        return all((self.folder / output).exists() for output in self.outputs)


@dataclass
class Outcome:
    """What became of a job; the report's record of it.

    Attributes:
        name: the job's.
        state: "skipped" where it was done before; "not begun" where the batch ended before.
        message: why it failed or was not begun; else empty.
        exit_code: as `raden` would have ended: 0, 2, 3, or 128 + a signal's number.
        seconds: it took.
        outputs: see `Job`.
        warnings: of the commands.
        text: what they printed.
        fingerprint: of a job that was done.
    """

    name: str
    state: State
    message: str = ""
    exit_code: int = 0
    seconds: float = 0.0
    outputs: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    text: str = ""
    fingerprint: str = ""


def run_job(job: Job) -> Outcome:
    """Run a job's commands until one fails.

    Raises:
        Interrupted: by a signal, which ends the batch, too.
    """
    outcome = Outcome(job.name, "done", outputs=job.outputs, fingerprint=job.fingerprint())
    said, begun = io.StringIO(), time.monotonic()
    with warnings.catch_warnings(record=True) as caught, contextlib.chdir(job.folder):
        for command in job.commands:
            ending = run_command(command, said)
            if ending is not None:
                step = " ".join(word for word in command[:2] if not word.startswith("-"))
                outcome.state, outcome.exit_code = "failed", ending.exit_code
                outcome.message = f"raden {step}: {ending.message}"
                outcome.fingerprint = ""
                break
    outcome.seconds = round(time.monotonic() - begun, 3)
    outcome.text = said.getvalue()
    outcome.warnings = tuple(dict.fromkeys(" ".join(str(w.message).split()) for w in caught))
    return outcome


def run_command(arguments: Sequence[str], said: io.StringIO) -> Ending | None:
    """Run one command here; None where it came to its end.

    Args:
        said: takes what it prints.

    Raises:
        Interrupted: by a signal.
    """
    from raden_torch.cli import run

    try:
        with contextlib.redirect_stdout(said):
            run(arguments)
    except Interrupted:
        raise
    except (Exception, SystemExit) as error:
        ending = ending_of(error, arguments)
        if ending is None:
            raise
        return ending
    return None


def check_command(arguments: Sequence[str], where: str) -> None:
    """Read a command's options, and run nothing.

    Args:
        where: they stand, for the message.

    Raises:
        InputError: one of them is wrong.
    """
    from raden_torch.cli.command_table import app

    try:
        app.parse_args(arguments)
    except Exception as error:
        ending = ending_of(error, arguments)
        if ending is None:
            raise
        raise InputError(f"{where}: {ending.message}") from None
