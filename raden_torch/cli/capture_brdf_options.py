"""Options of `raden capture brdf`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import Group, Parameter

from raden_torch.cli.capture_options import DevelopmentOptions, LightsFile
from raden_torch.cli.option_types import Axis, Points, RaisedRegions, Region, Triple
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.arrays import Floats
    from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup, SampleSpec, WhiteSpec
    from raden_torch.capture.photo.brdf.photo_cells import CellGrid
    from raden_torch.capture.photo.brdf.photo_white import WhiteFactor


def _array(points: Points | tuple[float, float, float] | None) -> Floats | None:
    import numpy as np

    return None if points is None else np.array(points)


@Parameter(name="*", group=Group("The sample", sort_key=2))
@dataclass(frozen=True)
class SampleOptions:
    """Where the sample is, and its shape."""

    shape: Literal["sphere", "plane", "cylinder"]
    """shape of the sample; a plane lies on the board"""
    mask: Path | None = None
    """mask, white on the sample; by default a sphere is searched for"""
    region: RaisedRegions = ()
    """a plane's corners on the board, as "x,y x,y x,y" in metres, or "x,y,height …" of one that
    leans; once for each of several pieces"""
    radius_mm: float | None = None
    """radius of a sphere or cylinder in mm; needed with --camera"""
    axis: Axis | None = None
    """axis of a cylinder that lies on the board: "x,y x,y" below it, metres"""
    axis_std: float | None = None
    """standard deviation of these two points across the axis, mm; by default 0.2"""
    radius_std: float | None = None
    """standard deviation of --radius, mm; by default 0.05"""

    @property
    def sample(self) -> SampleSpec:
        import numpy as np

        from raden_torch.capture.photo.brdf.capture_settings import (
            AXIS_STD_MM,
            RADIUS_STD_MM,
            SampleSpec,
        )

        regions, axis = tuple(np.array(region) for region in self.region), _array(self.axis)
        return SampleSpec(
            self.shape,
            self.mask,
            regions or None,
            self.radius_mm,
            axis,
            AXIS_STD_MM if self.axis_std is None else self.axis_std,
            RADIUS_STD_MM if self.radius_std is None else self.radius_std,
        )


@Parameter(name="*", group=Group("The white reference", sort_key=3))
@dataclass(frozen=True)
class WhiteOptions:
    """Where the white reference is, and how much it reflects."""

    white_mask: Path | None = None
    """mask, white on the white reference in the photographs"""
    white_region: Region | None = None
    """the white reference's corners on the board, as for --region"""
    white_chart: bool = False
    """use the white patch of the chart that --colour was made with"""
    white_factor: str | None = None
    """reflectance factor of the white, 100 for a perfect diffuser: Y, or X,Y,Z"""
    white_file: Path | None = None
    """a measurement of the white (.csv), instead of --white-factor"""
    white_std: float = 0.0
    """standard uncertainty of the white's factor, per cent (k = 1)"""
    white_name: str = ""
    """name of the reference: measurements that name the same share its error"""
    white_normal: Triple | None = None
    """the white's normal x,y,z in the camera's frame; by default the board's, or towards the
    camera"""
    white_at: Triple | None = None
    """x,y,z of a point on the white; by default the middle of the sample"""

    def white(self, colour: Path | None) -> tuple[WhiteSpec, WhiteFactor]:
        """Its place, and its factor; `colour` is the colour file that --white-chart speaks of."""
        from raden_torch.capture.photo.brdf.capture_settings import WhiteFactorSpec, WhiteSpec
        from raden_torch.capture.photo.brdf.chart_white import chart_white

        patch, factor = chart_white(
            colour if self.white_chart else None,
            WhiteFactorSpec(self.white_factor, self.white_file, self.white_std, self.white_name),
        )
        return WhiteSpec(
            self.white_mask,
            _array(self.white_region),
            patch,
            _array(self.white_normal),
            _array(self.white_at),
        ), factor


@Parameter(name="*", group=Group("Camera and lamps", sort_key=4))
@dataclass(frozen=True)
class SetupOptions:
    """The files of the earlier steps, and how the photographs were taken."""

    lights: LightsFile
    camera: Path | None = None
    """camera file of `raden capture calibrate`, with the board's poses; by default the camera is
    far away"""
    colour: Path | None = None
    """colour file of `raden capture colour`; by default the camera's own RGB is used"""
    lamp: tuple[int, ...] = ()
    """number of each photograph's lamp, from 1; by default in their order"""
    lamps_stand: Literal["camera", "board"] = "camera"
    """what the lamps are fixed to: the camera, or the board while the camera moves"""
    lights_seen_in: str | None = None
    """photograph whose camera frame --lights is in; with --lamps-stand board"""
    lamp_std: float | None = None
    """standard deviation of the lamps' directions, degrees; by default as the lights file has it,
    else 0.5"""
    outline_std: float | None = None
    """standard deviation of the outline of a sphere or cylinder, pixels; by default what its mask
    tells"""
    stack: int = 1
    """number of files per photograph, in sequence: an exposure stack"""
    plan: Path | None = None
    """plan of `raden capture guide` by which they were taken: is their order right?"""

    def __post_init__(self) -> None:
        if (self.lamps_stand == "board") != (self.lights_seen_in is not None):
            raise InputError("--lamps-stand board and --lights-seen-in go together; give both")

    def setup(self, reading: DevelopmentOptions) -> CaptureSetup:
        from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup

        return CaptureSetup(
            self.lights,
            self.camera,
            self.colour,
            self.lamp,
            self.stack,
            self.lights_seen_in,
            self.lamp_std,
            self.outline_std,
            reading.development(),
        )


@Parameter(name="*")
@dataclass(frozen=True)
class ResultOptions:
    """What the measurement is called, and when it is refused."""

    step_deg: float = 5.0
    """step of the grid, degrees"""
    scattered: bool = False
    """each cell's value at its samples' own angles, and no empty cells: of a flat piece, which
    shows little of each cell; `raden fit --assume isotropic+reciprocal` fits these"""
    name: str = ""
    """name of the sample"""
    simulated: bool = False
    """label the measurement as simulated: the photographs were computed"""
    go_on: bool = False
    """only warn where photographs contradict each other or moved"""

    def grid(self) -> CellGrid:
        from raden_torch.capture.photo.brdf.photo_cells import CellGrid

        return CellGrid.reaching(self.step_deg, scattered=self.scattered)
