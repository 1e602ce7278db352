"""What the command line cannot read, as one line: which option, what was expected, what came."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any, Literal, get_args, get_origin

from cyclopts import (
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

_KINDS = {int: "a whole number", float: "a number", bool: "true or false"}


def refusal(error: CycloptsError) -> str:
    """The line for an error that reading the arguments raised."""
    command = " ".join(error.command_chain or ())
    help_command = f"`raden {command} -h`" if command else "`raden -h`"
    if isinstance(error, UnknownOptionError):
        word = error.token.keyword or error.token.value
        names = [name for argument in error.argument_collection for name in argument.names]
        return f"{word}: no such option{_nearest(word, names)}; {help_command} lists them"
    if isinstance(error, UnknownCommandError):
        word, names = (error.unused_tokens or [""])[0], list(error.app or ())
        kind = "option" if word.startswith("-") else "command"
        return f"{word}: no such {kind}{_nearest(word, names)}; {help_command} lists them"
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        if error.keyword is not None:
            return f"{error.keyword}: expected a value, got none"
        return f"{command}: {error.argument.name} is missing; {help_command} says what it is"
    if isinstance(error, CoercionError) and error.argument is not None:
        name = error.token.keyword if error.token else None
        given = error.token.value if error.token else "something else"
        wanted = error.msg or f"expected {_kind(error.target_type)}, got {given or 'nothing'}"
        return f"{name or error.argument.name}: {wanted}"
    if isinstance(error, UnusedCliTokensError):
        return f"{command}: expected no further argument, got {' '.join(error.unused_tokens or ())}"
    return str(error)


def _nearest(word: str, names: list[str]) -> str:
    found = get_close_matches(word.partition("=")[0], names, n=1, cutoff=0.7)
    return f", did you mean {found[0]}?" if found else ""


def _kind(wanted: Any) -> str:
    """A type in words."""
    inner = [part for part in get_args(wanted) if part is not type(None)]
    if get_origin(wanted) is Literal:
        *others, last = map(str, inner)
        return f"{', '.join(others)} or {last}" if others else last
    if inner:
        return _kind(inner[0])
    return _KINDS.get(wanted, getattr(wanted, "__name__", str(wanted)))
