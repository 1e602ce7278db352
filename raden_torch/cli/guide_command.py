"""capture guide: where lamp and camera should stand for the next photographs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import ReachMm, SizeMm, output
from raden_torch.cli.status import progress
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.capture.photo.guide.piece import Piece
    from raden_torch.capture.photo.guide.plan import Plan
    from raden_torch.capture.photo.guide.set_up import SetUp
    from raden_torch.capture.photo.guide.view import View

_SUFFIXES = (".json", ".csv", ".png")


@Parameter(name="*", group=Group("The piece", sort_key=2))
@dataclass(frozen=True)
class PieceOptions:
    """What is photographed."""

    shape: Literal["plane", "cylinder", "sphere"] = "plane"
    """flat, bent round a rod, or convex"""
    size: SizeMm = (100.0, 80.0)
    """width and height of a flat piece in mm; of a bent one the first is its length, the other does
    not count"""
    radius_mm: float | None = None
    """radius of a cylinder or sphere in mm"""
    tilt: tuple[float, ...] = ()
    """degrees that a flat piece leans by on its wedge; once for each of several equal pieces"""
    name: str = ""
    """name of the sample"""

    @property
    def piece(self) -> Piece:
        from raden_torch.capture.photo.guide.piece import Piece

        if self.shape == "plane":
            if self.radius_mm is not None:
                raise InputError(
                    "--radius: expected without --shape plane; a bent card is a cylinder"
                )
            return Piece.flat(*self.size, self.tilt or (0.0,))
        if self.radius_mm is None:
            raise InputError(f"--shape {self.shape}: expected --radius in mm, got none")
        if self.tilt:
            raise InputError(f"--tilt: expected with --shape plane, got {self.shape}")
        if self.shape == "sphere":
            return Piece.button(self.radius_mm)
        return Piece.rod(self.size[0], self.radius_mm)


@Parameter(name="*", group=Group("Camera and lamp", sort_key=3))
@dataclass(frozen=True)
class SetUpOptions:
    """What can be placed where."""

    set_up: Literal["hand", "turntable", "still"] | None = None
    """hand: camera and lamp are moved; turntable: the piece is turned, and tilted by wedges, and
    the lamp moved; still: the lamp alone; by default hand for a flat piece, still for others"""
    camera: Path | None = None
    """camera file, as of `raden capture calibrate` or `handheld`: the distance is planned for it"""
    camera_distance_mm: Annotated[float | None, Parameter(name="--camera-distance")] = None
    """mm from the middle of the piece; by default 400, or with --camera the least from which the
    piece and half as much around it are seen, 200 or more"""
    camera_angle_deg: Annotated[float, Parameter(name="--camera-angle")] = 40.0
    """degrees from the vertical, of a camera that stands still"""
    camera_to_deg: Annotated[float, Parameter(name="--camera-to")] = 60.0
    """degrees from the normal of the piece, at most: farther, the board is not found"""
    lamp_distance_mm: Annotated[ReachMm, Parameter(name="--lamp-distance")] = (300.0, 600.0)
    """mm from the middle of the piece, the least and the greatest"""
    lamp_to_deg: Annotated[float, Parameter(name="--lamp-to")] = 70.0
    """degrees from the normal of the piece, at most: farther, the white is too dark"""

    def set_up_for(self, piece: Piece, view: View | None) -> SetUp:
        from raden_torch.capture.photo.guide.set_up import HAND, STILL, SetUp

        said = self.camera_distance_mm
        usual = HAND if piece.shape == "plane" else STILL
        return SetUp(
            self.set_up or usual,
            view.camera_mm if view is not None else 400.0 if said is None else said,
            self.camera_angle_deg,
            self.lamp_distance_mm,
            self.camera_to_deg,
            self.lamp_to_deg,
        )

    def view_of(self, piece: Piece) -> View | None:
        from raden_torch.capture.photo.camera import read_camera
        from raden_torch.capture.photo.guide.view import view_of

        if self.camera is None:
            return None
        return view_of(piece, read_camera(self.camera), self.camera_distance_mm)


def guide(
    *,
    count: Annotated[int, Parameter(help="photographs to plan")] = 20,
    measured: Annotated[
        Path | None, Parameter(help="the measurement so far, as of `raden capture brdf`")
    ] = None,
    assume: Annotated[
        Literal["isotropic", "isotropic+reciprocal"] | None,
        Parameter(help="what is declared of the sample, as for `raden fit`"),
    ] = None,
    output: Annotated[
        tuple[Path, ...], output("the plan: .json, .csv or .png (a picture); may be repeated")
    ] = (),
    piece: PieceOptions = PieceOptions(),
    set_up: SetUpOptions = SetUpOptions(),
    as_json: AsJson = False,
) -> None:
    from raden_torch.capture.exchange import load_measurement
    from raden_torch.capture.photo.guide.plan import plan_photographs

    inputs = tuple(path for path in (measured, set_up.camera) if path is not None)
    _check_outputs(output, inputs)
    what = piece.piece
    view = set_up.view_of(what)
    known = None if measured is None else load_measurement(measured)
    with progress("choosing where lamp and camera stand") as share_done:
        plan = plan_photographs(
            what,
            set_up.set_up_for(what, view),
            count,
            assume=assume,
            measured=known,
            name=piece.name,
            progress=share_done,
        )
    for path in output:
        _write(plan, path, inputs)
    if as_json:
        print_json(
            sample=plan.name,
            piece=plan.piece.described(),
            set_up=plan.set_up,
            view=view,
            assume=plan.assume,
            photographs=plan.stances,
            instructions=plan.instructions(),
            expected_error=plan.expected.tolist(),
        )
        return
    print(plan)
    if view is not None:
        print(view)
    for path in output:
        print(f"wrote {path}" + (" (look at it)" if path.suffix.lower() == ".png" else ""))


def _check_outputs(paths: tuple[Path, ...], inputs: tuple[Path, ...]) -> None:
    from raden_torch.files import check_output, check_outputs

    for path in paths:
        check_output(path, _SUFFIXES)
    check_outputs(*paths, inputs=inputs)


def _write(plan: Plan, path: Path, made_from: tuple[Path, ...]) -> None:
    if path.suffix.lower() == ".png":
        from raden_torch.plots.guide_figure import draw_plan
        from raden_torch.plots.sheet import save_plot

        save_plot(draw_plan(plan), path)
        return
    from raden_torch.capture.photo.guide.plan_file import write_plan, write_table

    if path.suffix.lower() == ".csv":
        write_table(plan, path)
    else:
        write_plan(plan, path, made_from=made_from)
