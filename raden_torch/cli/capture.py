"""From photographs: calibrate, colour."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from raden_torch.cli.common import app, working
from raden_torch.errors import InputError

capture = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="From photographs: the camera, its colour, the light and the normals.",
)
app.add_typer(capture, name="capture")

Picture = Annotated[
    Path | None, typer.Option(help="of what was found; else beside the result, as .png")
]


class Coded(str, Enum):
    """What the stored values of a photograph mean."""

    auto = "auto"
    srgb = "srgb"
    linear = "linear"


@capture.callback()
def steps() -> None:
    """From photographs: the camera, its colour, the light and the normals."""


@capture.command(
    epilog="Example: raden capture calibrate board*.jpg --squares 5x7 --square 0.04 "
    "--marker 0.02 -o camera.json"
)
def calibrate(
    photos: Annotated[list[Path], typer.Argument(help="of a ChArUco board, three or more")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .json file to write")],
    squares: Annotated[str, typer.Option(help="of the board, columns x rows, as 5x7")],
    square: Annotated[float, typer.Option(help="side of a square on the print, metres")],
    marker: Annotated[float, typer.Option(help="side of a marker on the print, metres")],
    dictionary: Annotated[
        str, typer.Option(help="of the markers, by OpenCV's name")
    ] = "DICT_6X6_250",
    legacy: Annotated[
        bool | None,
        typer.Option("--legacy/--no-legacy", help="board as before OpenCV 4.6; else found out"),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="a known camera (.json, OpenCV's .yml): look for the poses only"),
    ] = None,
    picture: Picture = None,
) -> None:
    """Calibrate a camera on photographs of a ChArUco board; where does the board lie?"""
    from raden_torch.capture.photo.board import Board
    from raden_torch.capture.photo.steps import calibrate_photographs

    columns, rows = _squares(squares)
    board = Board(columns, rows, square, marker, dictionary, legacy)
    print(calibrate_photographs(photos, board, output, camera=camera, picture=picture))


@capture.command(epilog="Example: raden capture colour chart.tif --coded linear -o colour.json")
def colour(
    photos: Annotated[
        list[Path], typer.Argument(help="of a ColorChecker Classic; several: an exposure stack")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="the .json file to write")],
    edition: Annotated[
        str, typer.Option(help="of the chart: 2014 (after November 2014) or 2005")
    ] = "2014",
    corners: Annotated[
        str | None,
        typer.Option(help='of the chart, where it is not found: pixels as "x,y x,y x,y x,y"'),
    ] = None,
    coded: Annotated[
        Coded, typer.Option(help="what the stored values are; auto: sRGB, mosaics linear")
    ] = Coded.auto,
    pattern: Annotated[
        str | None, typer.Option(help="of a raw Bayer mosaic: RGGB, BGGR, GRBG, GBRG")
    ] = None,
    white_level: Annotated[
        float | None, typer.Option(help="stored value at which the sensor saturates, as 4095")
    ] = None,
    exposure: Annotated[
        list[float] | None, typer.Option(help="seconds, for each photograph; else from EXIF")
    ] = None,
    dark: Annotated[
        list[Path] | None, typer.Option(help="frame with the lens covered; may be repeated")
    ] = None,
    dark_exposure: Annotated[
        list[float] | None, typer.Option(help="seconds, for each dark frame; else from EXIF")
    ] = None,
    flat: Annotated[Path | None, typer.Option(help="photograph of an even white sheet")] = None,
    response: Annotated[
        bool, typer.Option("--response", help="recover the camera's curve from the stack (8-bit)")
    ] = False,
    picture: Picture = None,
) -> None:
    """Fit the map from a camera's RGB to XYZ on photographs of a colour chart."""
    import numpy as np

    from raden_torch.capture.photo.steps import Development, colour_of_photographs

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
    marked = None if corners is None else np.array(_points(corners))
    with working("looking for the chart"):
        text = colour_of_photographs(
            photos, output, development=how, edition=edition, corners=marked, picture=picture
        )
    print(text)


def _squares(text: str) -> tuple[int, int]:
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise InputError(f"--squares {text}: columns x rows, as 5x7, was wanted") from None
    return columns, rows


def _points(text: str) -> list[list[float]]:
    try:
        points = [[float(n) for n in part.split(",")] for part in text.split()]
    except ValueError:
        points = []
    if [len(point) for point in points] != [2, 2, 2, 2]:
        raise InputError(f'--corners {text}: four points as "x,y x,y x,y x,y" were wanted')
    return points
