"""What the subcommands say while they work, and which files they leave out."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from raden_torch.errors import InputError
from raden_torch.files import is_same_file

if TYPE_CHECKING:
    from rich.console import Console


class Level(Enum):
    """How much is said beside results, warnings and errors."""

    QUIET = "--quiet"
    USUAL = ""
    VERBOSE = "--verbose"


_OPTIONS = {"-q": Level.QUIET, "--quiet": Level.QUIET, "--verbose": Level.VERBOSE}
_level = Level.USUAL


def level() -> Level:
    """Of the command that runs."""
    return _level


def set_level(arguments: Sequence[str]) -> list[str]:
    """Take --quiet, -q and --verbose, which every command has, out of a command's arguments.

    Returns:
        The other arguments. What follows `--` is left as it is.

    Raises:
        InputError: both are given.
    """
    global _level
    _level = Level.USUAL
    words = list(arguments)
    end = words.index("--") if "--" in words else len(words)
    given = {_OPTIONS[word] for word in words[:end] if word in _OPTIONS}
    if len(given) > 1:
        raise InputError("--quiet and --verbose contradict each other; give one of them")
    _level = next(iter(given), Level.USUAL)
    return [word for word in words[:end] if word not in _OPTIONS] + words[end:]


def console() -> Console:
    """Stderr for progress: silent under --quiet; bars and colours only on a terminal."""
    from rich.console import Console

    return Console(stderr=True, quiet=_level is Level.QUIET)


def without_other_inputs(files: Sequence[Path], *others: Path | None) -> list[Path]:
    """A list of files less those that are given as another input of the same command.

    A pattern such as `chrome.*.png` matches the mask `chrome.mask.png`, too. What is left out is
    said on stderr. An EXR stays: it may hold a picture and its normals.

    Raises:
        InputError: nothing is left.
    """
    given = [other for other in others if other is not None and other.suffix.lower() != ".exr"]
    kept = [file for file in files if not any(is_same_file(file, other) for other in given)]
    left_out = [str(file) for file in files if file not in kept]
    if left_out and _level is not Level.QUIET:
        names = ", ".join(left_out)
        print(f"raden: left out, given as another input: {names}", file=sys.stderr)
    if not kept:
        raise InputError("expected files besides the other inputs, got none")
    return kept


@contextmanager
def working(what: str) -> Iterator[None]:
    """A spinner on stderr where a person looks on; --verbose says what took how long instead."""
    if _level is Level.VERBOSE:
        with _timed(what):
            yield
        return
    with console().status(what):
        yield


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr where a person looks on; yields what moves it, to a share of 0…1."""
    if _level is Level.VERBOSE:
        with _timed(what):
            yield lambda share: None
        return
    from rich.progress import Progress

    shown = console()
    with Progress(console=shown, disable=not shown.is_terminal, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share: bar.update(task, completed=share)


@contextmanager
def _timed(what: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    print(f"raden: {what}: {time.perf_counter() - started:.2f} s", file=sys.stderr)
