"""From photographs of a sample of known shape: capture brdf."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raden_torch.cli.capture_commands import (
    Coded,
    CodedOption,
    DarkExposureOption,
    DarkOption,
    FlatOption,
    PatternOption,
    Picture,
    WhiteLevelOption,
    capture,
)
from raden_torch.cli.common import progress, triple, without_other_inputs
from raden_torch.errors import InputError
from raden_torch.files import check_outputs

if TYPE_CHECKING:
    from raden_torch.arrays import Floats


class SampleShape(str, Enum):
    """Of the sample."""

    sphere = "sphere"
    plane = "plane"
    cylinder = "cylinder"


class LampFrame(str, Enum):
    """The frame in which the lamps are fixed."""

    camera = "camera"
    board = "board"


@capture.command(
    epilog="Example: raden capture brdf lamp*.tif --shape sphere --mask sample.png "
    "--lights lights.json --white-mask white.png --white-factor 98.5 -o shell.csv"
)
def brdf(
    photos: Annotated[
        list[Path],
        typer.Argument(help="photographs of the sample, one under each lamp, in the lamps' order"),
    ],
    lights: Annotated[Path, typer.Option(help="lights file that `raden capture lights` wrote")],
    shape: Annotated[
        SampleShape, typer.Option(help="shape of the sample; a plane lies on the board")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .csv file to write")],
    mask: Annotated[
        Path | None,
        typer.Option(help="mask, white on the sample; by default a sphere is searched for"),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(help='a plane\'s corners on the board, metres, as "x,y x,y x,y"'),
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(help="radius of a sphere or cylinder in mm; needed with --camera"),
    ] = None,
    axis: Annotated[
        str | None,
        typer.Option(help='axis of a cylinder that lies on the board: "x,y x,y" below it, metres'),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="camera file of `raden capture calibrate`, with the board's poses; by default the "
            "camera is far away"
        ),
    ] = None,
    colour: Annotated[
        Path | None,
        typer.Option(
            help="colour file of `raden capture colour`; by default the camera's own RGB is used"
        ),
    ] = None,
    white_mask: Annotated[
        Path | None, typer.Option(help="mask, white on the white reference in the photographs")
    ] = None,
    white_region: Annotated[
        str | None, typer.Option(help="the white reference's corners on the board, as for --region")
    ] = None,
    white_chart: Annotated[
        bool,
        typer.Option(
            "--white-chart", help="use the white patch of the chart that --colour was made with"
        ),
    ] = False,
    white_factor: Annotated[
        str | None,
        typer.Option(
            help="reflectance factor of the white, 100 for a perfect diffuser: Y, or X,Y,Z"
        ),
    ] = None,
    white_file: Annotated[
        Path | None,
        typer.Option(help="a measurement of the white (.csv), instead of --white-factor"),
    ] = None,
    white_std: Annotated[
        float, typer.Option(help="standard uncertainty of the white's factor, per cent (k = 1)")
    ] = 0.0,
    white_name: Annotated[
        str,
        typer.Option(help="name of the reference: measurements that name the same share its error"),
    ] = "",
    white_normal: Annotated[
        str | None,
        typer.Option(
            help="the white's normal x,y,z in the camera's frame; by default the board's, or "
            "towards the camera"
        ),
    ] = None,
    white_at: Annotated[
        str | None,
        typer.Option(help="x,y,z of a point on the white; by default the middle of the sample"),
    ] = None,
    lamp: Annotated[
        list[int] | None,
        typer.Option(help="number of each photograph's lamp, from 1; by default in their order"),
    ] = None,
    lamps_stand: Annotated[
        LampFrame,
        typer.Option(
            help="what the lamps are fixed to: the camera, or the board while the camera moves"
        ),
    ] = LampFrame.camera,
    lights_seen_in: Annotated[
        str | None,
        typer.Option(help="photograph whose camera frame --lights is in; with --lamps-stand board"),
    ] = None,
    lamp_std: Annotated[
        float | None, typer.Option(help="standard deviation of the lamps' directions, degrees")
    ] = None,
    stack: Annotated[
        int, typer.Option(help="number of files per photograph, in sequence: an exposure stack")
    ] = 1,
    exposure: Annotated[
        list[float] | None,
        typer.Option(
            help="exposure time in seconds, for each file or each of a stack; by default from EXIF"
        ),
    ] = None,
    coded: CodedOption = Coded.auto,
    pattern: PatternOption = None,
    white_level: WhiteLevelOption = None,
    dark: DarkOption = None,
    dark_exposure: DarkExposureOption = None,
    flat: FlatOption = None,
    step: Annotated[float, typer.Option(help="step of the grid, degrees")] = 5.0,
    name: Annotated[str, typer.Option(help="name of the sample")] = "",
    simulated: Annotated[
        bool,
        typer.Option(
            "--simulated", help="label the measurement as simulated: the photographs were computed"
        ),
    ] = False,
    go_on: Annotated[
        bool,
        typer.Option("--go-on", help="only warn where photographs contradict each other or moved"),
    ] = False,
    picture: Picture = None,
) -> None:
    """Measure a BRDF: every lit pixel of a sphere, plane or cylinder is a reading."""
    from raden_torch.capture.photo.brdf.capture_settings import (
        CaptureSetup,
        SampleSpec,
        WhiteFactorSpec,
        WhiteSpec,
    )
    from raden_torch.capture.photo.brdf.chart_white import chart_white
    from raden_torch.capture.photo.brdf.photo_brdf_file import output_paths, write_brdf
    from raden_torch.capture.photo.brdf.photo_cells import CellGrid
    from raden_torch.capture.photo.capture_brdf import capture_brdf
    from raden_torch.capture.photo.development import Development
    from raden_torch.measurement import Metadata
    from raden_torch.plots.coverage_figure import draw_captured
    from raden_torch.plots.sheet import save_plot

    report, shown = output_paths(output, picture)
    beside = (mask, white_mask, flat, *(dark or ()))
    photos = without_other_inputs(photos, *beside)
    inputs = (*photos, *beside, lights, camera, colour, white_file)
    check_outputs(output, report, shown, inputs=inputs)
    if (lamps_stand is LampFrame.board) != (lights_seen_in is not None):
        raise InputError("--lamps-stand board and --lights-seen-in go together; give both")
    how = Development(
        coded.value,
        pattern,
        white_level,
        tuple(exposure or ()),
        tuple(dark or ()),
        tuple(dark_exposure or ()),
        flat,
    )
    setup = CaptureSetup(
        lights, camera, colour, tuple(lamp or ()), stack, lights_seen_in, lamp_std, how
    )
    sample = SampleSpec(
        shape.value, mask, _corners("--region", region), radius, _corners("--axis", axis, 2)
    )
    patch, factor = chart_white(
        colour if white_chart else None,
        WhiteFactorSpec(white_factor, white_file, white_std, white_name),
    )
    white = WhiteSpec(
        white_mask,
        _corners("--white-region", white_region),
        patch,
        None if white_normal is None else _vector("--white-normal", white_normal),
        None if white_at is None else _vector("--white-at", white_at),
    )
    with progress("reading the photographs") as share_done:
        found = capture_brdf(
            photos,
            setup,
            sample,
            white,
            factor,
            grid=CellGrid(step),
            metadata=Metadata(name or output.stem, simulated=simulated),
            go_on=go_on,
            progress=share_done,
        )
    found.measurement.save(output)
    write_brdf(found, report)
    save_plot(draw_captured(found), shown)
    print(found)
    print(f"wrote {output}\nwrote {report}\nwrote {shown} (look at it)")


def _corners(option: str, text: str | None, exactly: int | None = None) -> Floats | None:
    """Points on the board in metres."""
    import numpy as np

    if text is None:
        return None
    try:
        points = [[float(n) for n in part.split(",")] for part in text.split()]
    except ValueError:
        points = []
    fits = len(points) == exactly if exactly else len(points) >= 3
    if not fits or any(len(point) != 2 for point in points) or not np.isfinite(points).all():
        wanted = "two" if exactly else "three or more"
        raise InputError(
            f'{option}: expected {wanted} points in metres, as "0.05,0.05 0.1,0.05", got {text}'
        )
    return np.array(points)


def _vector(option: str, text: str) -> Floats:
    import numpy as np

    return np.array(triple(option, text))
