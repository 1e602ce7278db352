"""The `raden` command: one thin function a subcommand; the work is done in the library."""

from __future__ import annotations

import atexit
import io
import signal
import sys
import warnings
from collections.abc import Sequence

try:
    from raden_torch.cli.command_table import app
    from raden_torch.cli.endings import ending_of, in_options
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
            run(sys.argv[1:])
    except (Exception, Interrupted) as error:
        ending = ending_of(error, sys.argv[1:])
        if ending is None:
            raise
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
    _, apps, rest = app.parse_commands(arguments)
    if apps[-1].default_command is None and not rest:
        app.help_print(arguments)
        sys.exit(2)
    command, given, _ = app.parse_args(arguments)
    command(*given.args, **given.kwargs)


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"raden: warning: {in_options(str(message), sys.argv[1:])}", file=sys.stderr)
