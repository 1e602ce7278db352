"""How a command ended: its exit code, and the line that says why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cyclopts import CycloptsError

from raden_torch.cli.command_table import app
from raden_torch.cli.option_names import options_of, with_options
from raden_torch.cli.refusals import refusal
from raden_torch.errors import InputError
from raden_torch.interrupts import Interrupted

WRONG_INPUT = 2
_NO_MEMORY = "not enough memory; smaller pictures (--size) or fewer readings need less"


@dataclass(frozen=True)
class Ending:
    """An exit code other than 0, and one line without the program's name."""

    exit_code: int
    message: str


class StoppedError(SystemExit):
    """A command that has said on stderr why it stops before its end."""

    def __init__(self, ending: Ending) -> None:
        super().__init__(ending.exit_code)
        self.ending = ending


def ending_of(error: BaseException, arguments: Sequence[str]) -> Ending | None:
    """What an exception means to whoever ran the command; None where it is a fault of the program.

    Args:
        arguments: of the command, without "raden".
    """
    if isinstance(error, StoppedError):
        return error.ending
    if isinstance(error, Interrupted):
        return Ending(error.exit_code, f"stopped by {error}")
    message = _message(error)
    return None if message is None else Ending(WRONG_INPUT, in_options(message, arguments))


def in_options(message: str, arguments: Sequence[str]) -> str:
    """One line, in which the library's parameters are the command's options."""
    return with_options(" ".join(message.split()), options_of(app, arguments))


def _message(error: BaseException) -> str | None:
    if isinstance(error, CycloptsError):
        return refusal(error)
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, Warning):  # PYTHONWARNINGS=error
        return f"stopped at a warning: {error}"
    if isinstance(error, OSError):
        return f"{error.filename or 'output'}: {error.strerror or error}"
    no_memory = isinstance(error, RuntimeError) and "allocate memory" in str(error)  # torch's
    return _NO_MEMORY if no_memory or isinstance(error, MemoryError) else None
