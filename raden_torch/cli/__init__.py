"""The `raden` command: one thin function a subcommand; the work is done in the library."""

from __future__ import annotations

import atexit
import io
import signal
import sys
import warnings
from collections.abc import Sequence

try:
    from cyclopts import CycloptsError

    from raden_torch.cli.command_table import app
    from raden_torch.cli.option_names import options_of, with_options
    from raden_torch.cli.refusals import refusal
except KeyboardInterrupt:  # while the command starts
    sys.exit(128 + signal.SIGINT)
from raden_torch.errors import InputError
from raden_torch.interrupts import Interrupted, ignore_signals, signals_interrupt

_NO_MEMORY = "not enough memory; smaller pictures (--size) or fewer readings need less"


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
    except CycloptsError as error:
        _fail(refusal(error))
    except Interrupted as error:
        print(f"raden: stopped by {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except InputError as error:
        _fail(str(error))
    except Warning as error:  # PYTHONWARNINGS=error
        _fail(f"stopped at a warning: {error}")
    except OSError as error:
        _fail(f"{error.filename or 'output'}: {error.strerror or error}")
    except MemoryError:
        _fail(_NO_MEMORY)
    except RuntimeError as error:
        if "allocate memory" not in str(error):  # how torch says it
            raise
        _fail(_NO_MEMORY)
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
    print(f"raden: warning: {_in_options(str(message))}", file=sys.stderr)


def _fail(message: str) -> None:
    print(f"raden: {_in_options(message)}", file=sys.stderr)
    sys.exit(2)


def _in_options(message: str) -> str:
    """One line, in which the library's parameters are this command's options."""
    return with_options(" ".join(message.split()), options_of(app, sys.argv[1:]))
