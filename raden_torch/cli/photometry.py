"""From photographs under several lamps: capture lights, capture normals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from raden_torch.cli.capture import capture
from raden_torch.errors import InputError


class Coded(str, Enum):
    """What stored values mean."""

    auto = "auto"
    srgb = "srgb"
    linear = "linear"


class Shape(str, Enum):
    """Of a matt reference."""

    sphere = "sphere"
    card = "card"


class Solver(str, Enum):
    """How normals are solved."""

    robust = "robust"
    least_squares = "least-squares"
    selection = "selection"


CODED_HELP = "what the stored values mean; auto: sRGB for whole numbers, linear for floats and raw"


@capture.command(
    epilog="Example: raden capture lights chrome1.png chrome2.png chrome3.png --mask ball.png "
    "-o lights.json"
)
def lights(
    photos: Annotated[list[Path], typer.Argument(help="a chrome ball under each lamp, in order")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .json file to write")],
    mask: Annotated[
        list[Path] | None,
        typer.Option(help="white on the ball; once a ball (two or more place near lamps)"),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(help="of `raden capture calibrate`; else the camera is far away")
    ] = None,
    ball_radius: Annotated[
        float | None, typer.Option(help="of the balls in mm, for positions; with --camera")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(help="photographs of a matt grey reference, as 'grey.*.png' (in quotes)"),
    ] = None,
    reference_mask: Annotated[Path | None, typer.Option(help="white on the reference")] = None,
    reference_shape: Annotated[
        Shape, typer.Option(help="a sphere, or a card that faces the camera")
    ] = Shape.sphere,
    fit_response: Annotated[
        bool, typer.Option(help="also fit the camera's response, on a reference sphere")
    ] = False,
    coded: Annotated[Coded, typer.Option(help=CODED_HELP)] = Coded.auto,
) -> None:
    """Find the directions to the lamps (or their places) in photographs of a chrome ball."""
    from raden_torch.capture.photo.capture_lights import Reference, capture_lights
    from raden_torch.capture.photo.lamps import write_lamps
    from raden_torch.capture.photo.result_file import check_result_path
    from raden_torch.plots.found import draw_lamps
    from raden_torch.plots.sheet import save_plot

    check_result_path(output)
    if (reference is None) != (reference_mask is None):
        raise InputError("--reference and --reference-mask go together; give both or neither")
    matt = None
    if reference is not None and reference_mask is not None:
        matt = Reference(reference, reference_mask, reference_shape.value, fit_response)
    elif fit_response:
        raise InputError("--fit-response: a reference sphere is needed; give --reference")
    with steps("finding the lamps") as progress:
        found = capture_lights(
            photos,
            mask or [],
            camera=camera,
            ball_radius_mm=ball_radius,
            reference=matt,
            coded=coded.value,
            progress=progress,
        )
    write_lamps(found.lamps, output, balls=found.balls, made_from=photos)
    picture = output.with_suffix(".png")
    save_plot(draw_lamps(found.photos, found.balls, found.highlights, found.lamps), picture)
    print(found.lamps)
    print(f"wrote {output}\nwrote {picture} (look at it)")


@capture.command(
    epilog="Example: raden capture normals box1.png box2.png box3.png box4.png "
    "--lights lights.json --mask box.png -o box"
)
def normals(
    photos: Annotated[list[Path], typer.Argument(help="the object under each lamp, in order")],
    lights: Annotated[Path, typer.Option(help="what `raden capture lights` wrote")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the folder for the maps")],
    mask: Annotated[Path | None, typer.Option(help="white on the object; else all")] = None,
    method: Annotated[Solver, typer.Option(help="against shadows and highlights")] = Solver.robust,
    refine_intensity: Annotated[
        bool, typer.Option(help="also fit the lamps' brightness, known to about 10 %")
    ] = False,
    exponent: Annotated[
        float | None, typer.Option(help="of the response; else what the lights file says")
    ] = None,
    shadow: Annotated[
        float, typer.Option(help="darker than this share of the third brightest is shadow")
    ] = 0.1,
    plane_z: Annotated[
        float, typer.Option(help="near lamps: the object's plane, in the lights file's unit")
    ] = 0.0,
    keep_order: Annotated[
        bool, typer.Option(help="do not stop where another order of the lamps fits better")
    ] = False,
    coded: Annotated[Coded, typer.Option(help=CODED_HELP)] = Coded.auto,
) -> None:
    """Solve normals, albedo and confidence from photographs under known lamps."""
    from raden_torch.capture.photo.capture_normals import capture_normals
    from raden_torch.capture.photo.normals_file import write_normals
    from raden_torch.plots.found import draw_normals
    from raden_torch.plots.sheet import save_plot

    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; name a folder")
    with steps("solving normals") as progress:
        found = capture_normals(
            photos,
            lights,
            mask,
            method=method.value,
            refine_intensity=refine_intensity,
            exponent=exponent,
            shadow=shadow,
            plane_z=plane_z,
            keep_order=keep_order,
            coded=coded.value,
            progress=progress,
        )
    output.mkdir(parents=True, exist_ok=True)
    written = write_normals(
        found.surface,
        output,
        found.lamps,
        photos,
        method=method.value,
        exponent=found.exponent,
        order=found.order,
        notes=found.notes,
    )
    picture = output / "found.png"
    save_plot(draw_normals(found.surface, found.lamps, photos, found.mask), picture)
    for path in written:
        print(f"wrote {path}")
    print(f"wrote {picture} (look at it)")


@contextmanager
def steps(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr that takes the share that is done."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)
