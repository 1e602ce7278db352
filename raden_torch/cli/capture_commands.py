"""From photographs: capture calibrate, colour, lights, normals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from raden_torch.cli.capture_options import Coded, DevelopmentOptions, LightsFile, Picture
from raden_torch.cli.option_types import CornersPx, Squares, files, output, switch
from raden_torch.cli.status import progress, without_other_inputs, working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs

if TYPE_CHECKING:
    from raden_torch.capture.photo.board import Board
    from raden_torch.capture.photo.capture_normals import FoundNormals
    from raden_torch.capture.photo.reference_photos import Reference


@Parameter(name="*")
@dataclass(frozen=True)
class BoardOptions:
    """A ChArUco board."""

    squares: Squares
    """squares of the board, columns x rows, as 5x7"""
    square: float
    """side of a square on the print, metres"""
    marker: float
    """side of a marker on the print, metres"""
    dictionary: str = "DICT_6X6_250"
    """dictionary of the markers, by OpenCV's name"""
    legacy: Annotated[
        bool | None, switch("board as printed before OpenCV 4.6; by default detected")
    ] = None

    @property
    def board(self) -> Board:
        from raden_torch.capture.photo.board import Board

        return Board(*self.squares, self.square, self.marker, self.dictionary, self.legacy)


def calibrate(
    *photos: Annotated[Path, files("three or more photographs of a ChArUco board")],
    output: Annotated[Path, output("the .json file to write")],
    board: BoardOptions,
    camera: Annotated[
        Path | None,
        Parameter(help="a known camera (.json, OpenCV's .yml): look for the poses only"),
    ] = None,
    picture: Picture = None,
) -> None:
    from raden_torch.capture.photo.capture_camera import capture_camera
    from raden_torch.capture.photo.checking_picture import picture_path

    check_output(output, (".json",))
    check_outputs(output, picture_path(picture, output), inputs=(*photos, camera))
    print(capture_camera(photos, board.board, output, camera=camera, picture=picture))


def colour(
    *photos: Annotated[
        Path, files("photograph of a ColorChecker Classic; several: an exposure stack")
    ],
    output: Annotated[Path, output("the .json file to write")],
    edition: Annotated[
        str, Parameter(help="edition of the chart: 2014 (after November 2014) or 2005")
    ] = "2014",
    corners: Annotated[
        CornersPx | None,
        Parameter(help='corners of the chart, if it is not found: pixels as "x,y x,y x,y x,y"'),
    ] = None,
    response: Annotated[
        bool, Parameter(help="recover the camera's response curve from the stack (8-bit)")
    ] = False,
    picture: Picture = None,
    reading: DevelopmentOptions = DevelopmentOptions(),
) -> None:
    import numpy as np

    from raden_torch.capture.photo.capture_colour import capture_colour
    from raden_torch.capture.photo.checking_picture import picture_path

    used = without_other_inputs(photos, *reading.files)
    check_output(output, (".json",))
    shown = picture_path(picture, output)
    check_outputs(output, shown, inputs=(*used, *reading.files))
    with working("looking for the chart"):
        text = capture_colour(
            used,
            output,
            development=reading.development(response=response),
            edition=edition,
            corners=None if corners is None else np.array(corners),
            picture=shown,
        )
    print(text)


@Parameter(name="*", group=Group("The lamps' brightness", sort_key=2))
@dataclass(frozen=True)
class MattOptions:
    """A matt reference, which shows how bright the lamps are."""

    reference: str | None = None
    """photographs of a matt grey reference, as 'grey.*.png' (in quotes)"""
    reference_mask: Path | None = None
    """mask, white on the reference"""
    reference_shape: Literal["sphere", "card"] = "sphere"
    """shape of the reference: a sphere, or a card that faces the camera"""
    fit_response: Annotated[
        bool, switch("also fit the camera's response, on a reference sphere")
    ] = False

    def __post_init__(self) -> None:
        if (self.reference is None) != (self.reference_mask is None):
            raise InputError("--reference and --reference-mask go together; give both or neither")
        if self.reference is None and self.fit_response:
            raise InputError("--fit-response: a reference sphere is needed; give --reference")

    @property
    def files(self) -> tuple[Path, ...]:
        mask = () if self.reference_mask is None else (self.reference_mask,)
        photos = () if self.reference is None else glob(self.reference)
        return (*mask, *map(Path, photos))

    @property
    def matt(self) -> Reference | None:
        from raden_torch.capture.photo.reference_photos import Reference

        if self.reference is None or self.reference_mask is None:
            return None
        return Reference(
            self.reference, self.reference_mask, self.reference_shape, self.fit_response
        )


def lights(
    *photos: Annotated[Path, files("photographs of a chrome ball, one under each lamp, in order")],
    output: Annotated[Path, output("the .json file to write")],
    mask: Annotated[
        tuple[Path, ...],
        Parameter(
            help="mask, white on the ball; one mask per ball (two or more balls locate near lamps)"
        ),
    ] = (),
    camera: Annotated[
        Path | None,
        Parameter(
            help="camera file of `raden capture calibrate`; by default the camera is far away"
        ),
    ] = None,
    ball_radius: Annotated[
        float | None, Parameter(help="radius of the balls in mm, for positions; with --camera")
    ] = None,
    coded: Coded = "auto",
    picture: Picture = None,
    reference: MattOptions = MattOptions(),
) -> None:
    from raden_torch.capture.photo.capture_lights import capture_lights
    from raden_torch.capture.photo.checking_picture import picture_path
    from raden_torch.capture.photo.lamps import write_lamps
    from raden_torch.capture.photo.result_file import check_result_path
    from raden_torch.plots.capture_figures import draw_lamps
    from raden_torch.plots.sheet import save_plot

    check_result_path(output)
    shown = picture_path(picture, output)
    used = without_other_inputs(photos, reference.reference_mask, *mask)
    check_outputs(output, shown, inputs=(*used, camera, *reference.files, *mask))
    with progress("finding the lamps") as share_done:
        found = capture_lights(
            used,
            mask,
            camera=camera,
            ball_radius_mm=ball_radius,
            reference=reference.matt,
            coded=coded,
            progress=share_done,
        )
    write_lamps(found.lamps, output, balls=found.balls, made_from=used)
    save_plot(draw_lamps(found.photos, found.balls, found.highlights, found.lamps), shown)
    print(found.lamps)
    print(f"wrote {output}\nwrote {shown} (look at it)")


@Parameter(name="*")
@dataclass(frozen=True)
class NormalsOptions:
    """How normals are solved."""

    method: Literal["robust", "least-squares", "selection", "alternating"] | None = None
    """robust (usual), least-squares or selection: of a matt object; alternating: find the material,
    one that is not matt, with the normals"""
    model: Path | None = None
    """model (.safetensors) of the material, or a palette, of which each pixel takes the member that
    fits: of what is not matt"""
    colour: Path | None = None
    """with --model: colour file of `raden capture colour`; by default the channels' balance is
    fitted"""
    refine_intensity: Annotated[
        bool, switch("also fit the lamps' brightness, known to about 10 %")
    ] = False
    exponent: float | None = None
    """exponent of the response; by default the one in the lights file"""
    shadow: float = 0.1
    """a pixel darker than this share of its third brightest value is in shadow"""
    plane_z: float = 0.0
    """near lamps: the object's plane, in the lights file's unit"""
    keep_order: Annotated[bool, switch("do not stop if another order of the lamps fits better")] = (
        False
    )
    coded: Coded = "auto"

    def __post_init__(self) -> None:
        if self.model is not None and self.method is not None:
            raise InputError("--model and --method are two ways to solve normals; give one")
        if self.colour is not None and self.model is None:
            raise InputError("--colour: expected with --model, whose colours it is compared by")
        if self.compares and self.refine_intensity:
            raise InputError(
                "--refine-intensity: expected with the methods of a matt object; a reference in "
                "`raden capture lights` measures the lamps' brightness"
            )

    @property
    def compares(self) -> bool:
        """Whether photographs are compared with a material, given or found."""
        return self.model is not None or self.method == "alternating"

    @property
    def said(self) -> str:
        """What the result's file calls it."""
        return "model" if self.model is not None else self.method or "robust"

    def found(
        self,
        photographs: Sequence[Path],
        lights: Path,
        mask: Path | None,
        progress: Callable[[float], None],
    ) -> FoundNormals:
        """Read and solve."""
        own = asdict(self)
        model, colour = own.pop("model"), own.pop("colour")
        if not self.compares:
            from raden_torch.capture.photo.capture_normals import capture_normals

            own["method"] = self.said
            return capture_normals(photographs, lights, mask, progress=progress, **own)
        from raden_torch.stereo.capture_model_normals import ModelOptions, capture_model_normals

        for name in ("method", "refine_intensity", "shadow"):
            own.pop(name)
        options = ModelOptions(model=model, colour=colour, **own)
        return capture_model_normals(photographs, lights, mask, options, progress=progress)


def normals(
    *photos: Annotated[Path, files("photographs of the object, one under each lamp, in order")],
    lights: LightsFile,
    output: Annotated[Path, output("the folder for the maps")],
    mask: Annotated[
        Path | None, Parameter(help="mask, white on the object; by default everything")
    ] = None,
    how: NormalsOptions = NormalsOptions(),
) -> None:
    from raden_torch.brdf.files.model_file import save_model
    from raden_torch.capture.photo.normals_file import paths_in, write_normals
    from raden_torch.plots.capture_figures import draw_normals
    from raden_torch.plots.sheet import save_plot
    from raden_torch.stereo.capture_model_normals import FoundByModel

    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder, got a file")
    used = without_other_inputs(photos, mask)
    picture, material = output / "found.png", output / "material.safetensors"
    if output.is_dir():
        inputs = (*used, lights, mask, how.model, how.colour)
        check_outputs(*paths_in(output), picture, material, inputs=inputs)
    with progress("solving normals") as share_done:
        found = how.found(used, lights, mask, share_done)
    output.mkdir(parents=True, exist_ok=True)
    made_by = "" if how.model is None else how.model.name
    written = []
    if isinstance(found, FoundByModel) and found.material is not None:
        save_model(found.material, material)
        written, made_by = [material], material.name
    else:
        material.unlink(missing_ok=True)  # of an earlier run
    written += write_normals(
        found.surface,
        output,
        found.lamps,
        used,
        method=how.said,
        made_by=made_by,
        exponent=found.exponent,
        order=found.order,
        notes=found.notes,
    )
    sheet = draw_normals(found.surface, found.lamps, used, found.mask, by_material=how.compares)
    save_plot(sheet, picture)
    for path in written:
        print(f"wrote {path}")
    print(f"wrote {picture} (look at it)")
