"""What the subcommands share: the application, its options as values, and a spinner."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.brdf.lights import Light

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Measure how mother-of-pearl reflects, keep it as a small model, light images with it.",
)

ModelFile = Annotated[Path, typer.Argument(help="a model that `raden fit` wrote")]


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


def light_of(text: str) -> Light:
    from raden_torch.brdf.lights import DirectionalLight, PointLight

    kind, colon, numbers = text.rpartition(":")
    if colon and kind != "point":
        raise InputError(f"--light {text}: x,y,z or point:x,y,z was wanted")
    position = triple("--light", numbers)
    return PointLight(position) if kind else DirectionalLight(position)


def triple(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{option} {text}: three numbers as 1,1,2 were wanted") from None
    return x, y, z


def pair(option: str, text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise InputError(f"{option} {text}: name=value, as normal=N, was wanted")
    return name, value


def stops_of(text: str) -> float | None:
    if text == "auto":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--exposure {text}: a number of stops, or auto, was wanted") from None


def bytes_of(text: str) -> int:
    """`2G`, `512M`; a bare number is bytes."""
    units = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([KMGT]?)i?B?", text.strip(), re.IGNORECASE)
    if found is None:
        raise InputError(f"--memory {text}: a size as 2G or 512M was wanted")
    number, unit = found.groups()
    return int(float(number) * 1024 ** units[unit.upper()])
