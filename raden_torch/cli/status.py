"""What the subcommands say while they work, and which files they leave out."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.files import is_same_file


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
    if left_out:
        names = ", ".join(left_out)
        print(f"raden: left out, given as another input: {names}", file=sys.stderr)
    if not kept:
        raise InputError("expected files besides the other inputs, got none")
    return kept


@contextmanager
def working(what: str) -> Iterator[None]:
    """A spinner on stderr where a person looks on."""
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr where a person looks on; yields what moves it, to a share of 0…1."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share: bar.update(task, completed=share)
