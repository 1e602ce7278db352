"""What the subcommands share: the application, its options as values, and a spinner."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raden_torch.errors import InputError
from raden_torch.files import is_same_file

if TYPE_CHECKING:
    from raden_torch.brdf.shading.lights import Light

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Measure how mother-of-pearl reflects, keep it as a small model, light images with it.",
)

ModelFile = Annotated[Path, typer.Argument(help="a model that `raden fit` wrote")]


def _say_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"raden {version('raden_torch')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_say_version, is_eager=True, help="show the version and exit"
        ),
    ] = False,
) -> None:
    """Measure how mother-of-pearl reflects, keep it as a small model, light images with it."""


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
        typer.echo(f"raden: left out, given as another input: {', '.join(left_out)}", err=True)
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


def light_of(text: str) -> Light:
    from raden_torch.brdf.shading.lights import DirectionalLight, PointLight

    kind, colon, numbers = text.rpartition(":")
    if colon and kind != "point":
        raise InputError(f"--light: expected x,y,z or point:x,y,z, got {text}")
    position = triple("--light", numbers)
    return PointLight(position) if kind else DirectionalLight(position)


def triple(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{option}: expected three numbers as 1,1,2, got {text}") from None
    return x, y, z


def pair(option: str, text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise InputError(f"{option}: expected name=value, as normal=N, got {text}")
    return name, value


def stops_of(text: str) -> float | None:
    if text == "auto":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--exposure: expected a number of stops, or auto, got {text}") from None


def bytes_of(text: str) -> int:
    """`2G`, `512M`; a bare number is bytes."""
    units = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([KMGT]?)i?B?", text.strip(), re.IGNORECASE)
    if found is None:
        raise InputError(f"--memory: expected a size as 2G or 512M, got {text}")
    number, unit = found.groups()
    return int(float(number) * 1024 ** units[unit.upper()])
