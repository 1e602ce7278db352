"""From photographs: capture calibrate, colour, lights, normals."""

from __future__ import annotations

from enum import Enum
from glob import glob
from pathlib import Path
from typing import Annotated

import typer

from raden_torch.cli.common import app, progress, without_other_inputs, working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs

capture = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="From photographs: the camera, its colour, the light and the normals.",
)
app.add_typer(capture, name="capture")

Picture = Annotated[
    Path | None,
    typer.Option(
        help="image of what was found, for checking; by default beside the result, as .png"
    ),
]


class Coded(str, Enum):
    """What the stored values of a photograph mean."""

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


CodedOption = Annotated[
    Coded,
    typer.Option(
        help="what stored values mean; auto: whole numbers are sRGB, floats and raw are linear"
    ),
]


PatternOption = Annotated[
    str | None,
    typer.Option("--pattern", help="Bayer pattern of a raw mosaic: RGGB, BGGR, GRBG, GBRG"),
]
WhiteLevelOption = Annotated[
    float | None,
    typer.Option("--white-level", help="stored value at which the sensor saturates, as 4095"),
]
DarkOption = Annotated[
    list[Path] | None,
    typer.Option("--dark", help="frame with the lens covered; may be repeated"),
]
DarkExposureOption = Annotated[
    list[float] | None,
    typer.Option(
        "--dark-exposure", help="exposure time in seconds of each dark frame; by default from EXIF"
    ),
]
FlatOption = Annotated[
    Path | None, typer.Option("--flat", help="flat field: photograph of an evenly lit white sheet")
]


@capture.callback()
def steps() -> None:
    """From photographs: the camera, its colour, the light and the normals."""


@capture.command(
    epilog="Example: raden capture calibrate board*.jpg --squares 5x7 --square 0.04 "
    "--marker 0.02 -o camera.json"
)
def calibrate(
    photos: Annotated[
        list[Path], typer.Argument(help="three or more photographs of a ChArUco board")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .json file to write")],
    squares: Annotated[str, typer.Option(help="squares of the board, columns x rows, as 5x7")],
    square: Annotated[float, typer.Option(help="side of a square on the print, metres")],
    marker: Annotated[float, typer.Option(help="side of a marker on the print, metres")],
    dictionary: Annotated[
        str, typer.Option(help="dictionary of the markers, by OpenCV's name")
    ] = "DICT_6X6_250",
    legacy: Annotated[
        bool | None,
        typer.Option(
            "--legacy/--no-legacy", help="board as printed before OpenCV 4.6; by default detected"
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="a known camera (.json, OpenCV's .yml): look for the poses only"),
    ] = None,
    picture: Picture = None,
) -> None:
    """Calibrate a camera on photographs of a ChArUco board; where does the board lie?"""
    from raden_torch.capture.photo.board import Board
    from raden_torch.capture.photo.capture_camera import capture_camera
    from raden_torch.capture.photo.checking_picture import picture_path

    columns, rows = _squares(squares)
    check_output(output, (".json",))
    check_outputs(output, picture_path(picture, output), inputs=(*photos, camera))
    board = Board(columns, rows, square, marker, dictionary, legacy)
    print(capture_camera(photos, board, output, camera=camera, picture=picture))


@capture.command(epilog="Example: raden capture colour chart.tif --coded linear -o colour.json")
def colour(
    photos: Annotated[
        list[Path],
        typer.Argument(help="photograph of a ColorChecker Classic; several: an exposure stack"),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .json file to write")],
    edition: Annotated[
        str, typer.Option(help="edition of the chart: 2014 (after November 2014) or 2005")
    ] = "2014",
    corners: Annotated[
        str | None,
        typer.Option(help='corners of the chart, if it is not found: pixels as "x,y x,y x,y x,y"'),
    ] = None,
    coded: CodedOption = Coded.auto,
    pattern: PatternOption = None,
    white_level: WhiteLevelOption = None,
    exposure: Annotated[
        list[float] | None,
        typer.Option(help="exposure time in seconds of each photograph; by default from EXIF"),
    ] = None,
    dark: DarkOption = None,
    dark_exposure: DarkExposureOption = None,
    flat: FlatOption = None,
    response: Annotated[
        bool,
        typer.Option(
            "--response", help="recover the camera's response curve from the stack (8-bit)"
        ),
    ] = False,
    picture: Picture = None,
) -> None:
    """Fit the map from a camera's RGB to XYZ on photographs of a colour chart."""
    import numpy as np

    from raden_torch.capture.photo.capture_colour import capture_colour
    from raden_torch.capture.photo.checking_picture import picture_path
    from raden_torch.capture.photo.development import Development

    how = Development(
        coded.value,
        pattern,
        white_level,
        tuple(exposure or ()),
        tuple(dark or ()),
        tuple(dark_exposure or ()),
        flat,
        response,
    )
    photos = without_other_inputs(photos, flat, *(dark or ()))
    check_output(output, (".json",))
    shown = picture_path(picture, output)
    check_outputs(output, shown, inputs=(*photos, flat, *(dark or ())))
    marked = None if corners is None else np.array(_points(corners))
    with working("looking for the chart"):
        text = capture_colour(
            photos, output, development=how, edition=edition, corners=marked, picture=shown
        )
    print(text)


@capture.command(
    epilog="Example: raden capture lights chrome1.png chrome2.png chrome3.png --mask ball.png "
    "-o lights.json"
)
def lights(
    photos: Annotated[
        list[Path],
        typer.Argument(help="photographs of a chrome ball, one under each lamp, in order"),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .json file to write")],
    mask: Annotated[
        list[Path] | None,
        typer.Option(
            help="mask, white on the ball; one mask per ball (two or more balls locate near lamps)"
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="camera file of `raden capture calibrate`; by default the camera is far away"
        ),
    ] = None,
    ball_radius: Annotated[
        float | None, typer.Option(help="radius of the balls in mm, for positions; with --camera")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(help="photographs of a matt grey reference, as 'grey.*.png' (in quotes)"),
    ] = None,
    reference_mask: Annotated[
        Path | None, typer.Option(help="mask, white on the reference")
    ] = None,
    reference_shape: Annotated[
        Shape,
        typer.Option(help="shape of the reference: a sphere, or a card that faces the camera"),
    ] = Shape.sphere,
    fit_response: Annotated[
        bool, typer.Option(help="also fit the camera's response, on a reference sphere")
    ] = False,
    coded: CodedOption = Coded.auto,
    picture: Picture = None,
) -> None:
    """Find the directions to the lamps (or their places) in photographs of a chrome ball."""
    from raden_torch.capture.photo.capture_lights import capture_lights
    from raden_torch.capture.photo.checking_picture import picture_path
    from raden_torch.capture.photo.lamps import write_lamps
    from raden_torch.capture.photo.reference_photos import Reference
    from raden_torch.capture.photo.result_file import check_result_path
    from raden_torch.plots.capture_figures import draw_lamps
    from raden_torch.plots.sheet import save_plot

    check_result_path(output)
    shown = picture_path(picture, output)
    photos = without_other_inputs(photos, reference_mask, *(mask or ()))
    matte = [] if reference is None else glob(reference)
    inputs = (*photos, *matte, camera, reference_mask, *(mask or ()))
    check_outputs(output, shown, inputs=inputs)
    if (reference is None) != (reference_mask is None):
        raise InputError("--reference and --reference-mask go together; give both or neither")
    matt = None
    if reference is not None and reference_mask is not None:
        matt = Reference(reference, reference_mask, reference_shape.value, fit_response)
    elif fit_response:
        raise InputError("--fit-response: a reference sphere is needed; give --reference")
    with progress("finding the lamps") as share_done:
        found = capture_lights(
            photos,
            mask or [],
            camera=camera,
            ball_radius_mm=ball_radius,
            reference=matt,
            coded=coded.value,
            progress=share_done,
        )
    write_lamps(found.lamps, output, balls=found.balls, made_from=photos)
    save_plot(draw_lamps(found.photos, found.balls, found.highlights, found.lamps), shown)
    print(found.lamps)
    print(f"wrote {output}\nwrote {shown} (look at it)")


@capture.command(
    epilog="Example: raden capture normals box1.png box2.png box3.png box4.png "
    "--lights lights.json --mask box.png -o box"
)
def normals(
    photos: Annotated[
        list[Path], typer.Argument(help="photographs of the object, one under each lamp, in order")
    ],
    lights: Annotated[Path, typer.Option(help="lights file that `raden capture lights` wrote")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the folder for the maps")],
    mask: Annotated[
        Path | None, typer.Option(help="mask, white on the object; by default everything")
    ] = None,
    method: Annotated[
        Solver, typer.Option(help="method that is robust against shadows and highlights")
    ] = Solver.robust,
    refine_intensity: Annotated[
        bool, typer.Option(help="also fit the lamps' brightness, known to about 10 %")
    ] = False,
    exponent: Annotated[
        float | None,
        typer.Option(help="exponent of the response; by default the one in the lights file"),
    ] = None,
    shadow: Annotated[
        float,
        typer.Option(
            help="a pixel darker than this share of its third brightest value is in shadow"
        ),
    ] = 0.1,
    plane_z: Annotated[
        float, typer.Option(help="near lamps: the object's plane, in the lights file's unit")
    ] = 0.0,
    keep_order: Annotated[
        bool, typer.Option(help="do not stop if another order of the lamps fits better")
    ] = False,
    coded: CodedOption = Coded.auto,
) -> None:
    """Solve normals, albedo and confidence from photographs under known lamps."""
    from raden_torch.capture.photo.capture_normals import capture_normals
    from raden_torch.capture.photo.normals_file import paths_in, write_normals
    from raden_torch.plots.capture_figures import draw_normals
    from raden_torch.plots.sheet import save_plot

    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder, got a file")
    photos = without_other_inputs(photos, mask)
    picture = output / "found.png"
    if output.is_dir():
        check_outputs(*paths_in(output), picture, inputs=(*photos, lights, mask))
    with progress("solving normals") as share_done:
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
            progress=share_done,
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
    save_plot(draw_normals(found.surface, found.lamps, photos, found.mask), picture)
    for path in written:
        print(f"wrote {path}")
    print(f"wrote {picture} (look at it)")


def _squares(text: str) -> tuple[int, int]:
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise InputError(f"--squares: expected columns x rows, as 5x7, got {text}") from None
    return columns, rows


def _points(text: str) -> list[list[float]]:
    try:
        points = [[float(n) for n in part.split(",")] for part in text.split()]
    except ValueError:
        points = []
    if [len(point) for point in points] != [2, 2, 2, 2]:
        raise InputError(f'--corners: expected four points as "x,y x,y x,y x,y", got {text}')
    return points
