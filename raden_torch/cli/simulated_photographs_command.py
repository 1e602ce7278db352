"""capture simulate: simulated photographs for the other steps of `raden capture`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from raden_torch.cli.option_types import output
from raden_torch.cli.status import progress
from raden_torch.packages import require


@Parameter(name="*")
@dataclass(frozen=True)
class SimulationOptions:
    """What is photographed, and how: the fields of the library's `Options`."""

    material: str = "yakogai"
    """yakogai, abalone, akoya, awabi, mexican, rough-plastic, rough-conductor, clear-coat, white,
    or a measurement (.csv)"""
    shape: Literal["sphere", "plane"] = "sphere"
    """shape of the specimen"""
    lamps: int = 29
    """number of lamps, one per photograph"""
    views: int = 6
    """number of camera positions, for a plane"""
    near: bool = False
    """place the lamps at about 1 m instead of far away"""
    width: int = 1200
    """width of a photograph, pixels; its height is 2/3 of that"""
    bits: int = 14
    """bits of the camera; 8 makes 8-bit files"""
    stack: int = 1
    """exposures per photograph, each 4 times longer than the last"""
    seed: int = 0
    """seed of the noise and of the positions"""
    variant: Literal["scalar_rgb", "llvm_ad_rgb"] = "scalar_rgb"
    """variant of Mitsuba"""
    plan: Path | None = None
    """plan of `raden capture guide` for a flat piece: where camera and lamp stand; with
    --shape plane"""


def simulate(
    *,
    output: Annotated[Path, output("the folder to make")],
    what: SimulationOptions = SimulationOptions(),
) -> None:
    require("simulated photographs", "simulate")
    from raden_torch.capture.photo.simulation.simulate import Options, simulate_photographs

    with progress("rendering simulated photographs") as share_done:
        next_steps = simulate_photographs(output, Options(**asdict(what)), progress=share_done)
    print(
        f"wrote {output}: simulated photographs and truth.json. What makes a measurement of them:"
    )
    print(f"cd {output}", *next_steps, sep="\n")
