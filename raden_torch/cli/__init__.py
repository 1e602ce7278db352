"""The `raden` command: one thin function a subcommand; the work is done in the library."""

from __future__ import annotations

import atexit
import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any

try:
    from raden_torch.cli.command_table import app
    from raden_torch.cli.endings import ending_of, in_options
    from raden_torch.cli.status import Level, level, set_level
except KeyboardInterrupt:  # while the command starts
    sys.exit(128 + signal.SIGINT)
from raden_torch.interrupts import Interrupted, ignore_signals, signals_interrupt


def main() -> None:
    """Run the command; anything wrong with the input is one line on stderr and exit code 2.

    A signal that ends it is one line, too, and exit code 128 + its number.
    """
    warnings.showwarning = _print_warning
    if isinstance(sys.stdout, io.TextIOWrapper):  # what a terminal's encoding lacks is escaped
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with signals_interrupt():
            run(set_level(sys.argv[1:]))
    except (Exception, Interrupted) as error:
        ending = ending_of(error, sys.argv[1:])
        if ending is None:
            raise
        if level() is Level.VERBOSE:
            traceback.print_exc()
        print(f"raden: {ending.message}", file=sys.stderr)
        sys.exit(ending.exit_code)
    finally:
        atexit.register(ignore_signals)
    sys.exit(0)


def run(arguments: Sequence[str]) -> None:
    """Run a subcommand; where none is named, show those there are and exit with 2.

    Raises:
        CycloptsError: the arguments are none of its.
    """
    names, apps, rest = app.parse_commands(arguments)
    if apps[-1].default_command is None and not rest:
        app.help_print(arguments)
        sys.exit(2)
    command, given, _ = app.parse_args(arguments)
    if level() is Level.VERBOSE:
        print(f"raden: {_versions()}", file=sys.stderr)
    given.apply_defaults()
    with _said(names, given.arguments):
        command(*given.args, **given.kwargs)


_WRITE_INTO_FOLDERS = {("catalogue", "add")}
"""Commands that take no name of what they write."""


@contextmanager
def _said(names: Sequence[str], given: dict[str, Any]) -> Iterator[None]:
    """Under --quiet a command that writes files prints nothing, unless it is asked for JSON."""
    writes = any(given.get(name) is not None for name in ("output", "out", "queue"))
    writes = writes or tuple(names) in _WRITE_INTO_FOLDERS
    as_json = given.get("as_json") or getattr(given.get("sequence"), "json", False)
    if level() is not Level.QUIET or as_json or not writes:
        yield
        return
    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
        yield


def _versions() -> str:
    from importlib.metadata import version

    of = ", ".join(f"{name} {version(name)}" for name in ("raden_torch", "torch", "numpy"))
    return f"{of}, Python {sys.version.split()[0]}"


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"raden: warning: {in_options(str(message), sys.argv[1:])}", file=sys.stderr)
