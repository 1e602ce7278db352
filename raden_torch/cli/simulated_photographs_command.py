"""capture simulate: simulated photographs for the other steps of `raden capture`."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from raden_torch.cli.capture_commands import capture
from raden_torch.cli.common import progress
from raden_torch.packages import require


class Variant(str, Enum):
    """Of Mitsuba."""

    scalar = "scalar_rgb"
    llvm = "llvm_ad_rgb"


class Specimen(str, Enum):
    """Shapes of a specimen."""

    sphere = "sphere"
    plane = "plane"


@capture.command(epilog="Example: raden capture simulate --material yakogai -o photographs")
def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", help="the folder to make")],
    material: Annotated[
        str,
        typer.Option(
            help="yakogai, abalone, akoya, rough-plastic, rough-conductor, clear-coat, white, "
            "or a measurement (.csv)"
        ),
    ] = "yakogai",
    shape: Annotated[Specimen, typer.Option(help="shape of the specimen")] = Specimen.sphere,
    lamps: Annotated[int, typer.Option(help="number of lamps, one per photograph")] = 29,
    views: Annotated[int, typer.Option(help="number of camera positions, for a plane")] = 6,
    near: Annotated[
        bool, typer.Option("--near", help="place the lamps at about 1 m instead of far away")
    ] = False,
    width: Annotated[
        int, typer.Option(help="width of a photograph, pixels; its height is 2/3 of that")
    ] = 1200,
    bits: Annotated[int, typer.Option(help="bits of the camera; 8 makes 8-bit files")] = 14,
    stack: Annotated[
        int, typer.Option(help="exposures per photograph, each 4 times longer than the last")
    ] = 1,
    seed: Annotated[int, typer.Option(help="seed of the noise and of the positions")] = 0,
    variant: Annotated[Variant, typer.Option(help="variant of Mitsuba")] = Variant.scalar,
) -> None:
    """Photograph a simulated specimen by Mitsuba 3, with everything that is true of it beside."""
    require("simulated photographs", "simulate")
    from raden_torch.capture.photo.simulation.simulate import Options, simulate_photographs

    options = Options(
        material,
        shape.value,
        lamps=lamps,
        views=views,
        near=near,
        width=width,
        bits=bits,
        stack=stack,
        seed=seed,
        variant=variant.value,
    )
    with progress("rendering simulated photographs") as share_done:
        next_steps = simulate_photographs(output, options, progress=share_done)
    print(
        f"wrote {output}: simulated photographs and truth.json. What makes a measurement of them:"
    )
    print(f"cd {output}", *next_steps, sep="\n")
