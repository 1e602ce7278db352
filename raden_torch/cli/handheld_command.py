"""capture handheld: videos and stills by hand → photographs whose camera and lamp are known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from raden_torch.cli.capture_commands import BoardOptions
from raden_torch.cli.option_types import Five, Region, Regions, Triple, Triples, files, output
from raden_torch.cli.status import progress
from raden_torch.files import check_outputs

if TYPE_CHECKING:
    from raden_torch.arrays import Floats32
    from raden_torch.capture.photo.handheld.handheld_setup import HandheldSetup


@Parameter(name="*", group=Group("What lies on the board", sort_key=2))
@dataclass(frozen=True)
class CardOptions:
    """Places on the board: x along its rows, y down its columns, metres from its upper left
    corner."""

    region: Region
    """corners of the piece, as "x,y x,y x,y x,y\""""
    white_region: Region
    """corners of the white reference; each picture's exposure is read from it"""
    white_factor: str | None = None
    """its reflectance factor, 100 for a perfect diffuser, for the command that goes on"""
    ball: Triples = ()
    """a chrome ball that shows the lamp: x,y where it touches the board (to some mm), and its
    radius in mm; may be repeated"""
    mirror: Regions = ()
    """corners of a flat mirror, as black glass, that shows the lamp; may be repeated"""
    mirror_height: float = 0.0
    """height of the mirrors' upper faces over the board, mm"""
    shadow: Five = ()
    """a pin that stands upright, and its shadow: x,y of its foot, its height in mm, x,y of its
    shadow's tip; may be repeated"""
    grey: Triples = ()
    """a matt grey patch of 6 mm or more that shows the tone curve: x,y of its middle, and its
    reflectance factor, 100 for a perfect diffuser; may be repeated"""


@Parameter(name="*", group=Group("Camera and lamp", sort_key=3))
@dataclass(frozen=True)
class HandOptions:
    """How it was taken."""

    lamps_stand: Literal["camera", "board"] = "board"
    """what the lamp is fixed to: the camera, as a phone's flash, or the board, beside which it
    stands elsewhere in each video and folder"""
    flash_mm: Triple | None = None
    """with --lamps-stand camera: the lamp seen from the lens in mm: x to the right in the picture,
    y up, z towards the photographer"""
    camera: Path | None = None
    """camera file of `raden capture calibrate`; by default the pictures calibrate it"""
    response: Path | None = None
    """response file of an earlier run with the same camera"""
    exposure_locked: bool = False
    """the exposure and white balance were the same in all pictures"""
    photographs: int = 60
    """most photographs to choose"""
    blur: float = 1.5
    """blur beyond which a picture is left out: standard deviation in pixels"""
    every: int | None = None
    """frames of a video of which the sharpest is looked at; by default so many that 300 are"""


def handheld(
    *footage: Annotated[Path, files("videos, folders of stills, or stills")],
    output: Annotated[Path, output("the folder for what was found")],
    board: BoardOptions,
    card: CardOptions,
    how: HandOptions = HandOptions(),
) -> None:
    from raden_torch.capture.photo.capture_handheld import capture_handheld
    from raden_torch.capture.photo.handheld.handheld_file import (
        HandheldPaths,
        check_folder,
        next_command,
        write_handheld,
    )
    from raden_torch.plots.handheld_figure import draw_handheld
    from raden_torch.plots.sheet import save_plot

    check_folder(output, footage)
    paths = HandheldPaths(output)
    if output.is_dir():
        check_outputs(*paths.all, inputs=(*footage, how.camera, how.response))
    setup = _setup(board, card, how)
    with progress("looking at the pictures") as share_done:
        found = capture_handheld(footage, setup, progress=share_done)
    photographs = write_handheld(found, output)
    save_plot(draw_handheld(found), paths.picture)
    print(found)
    print(f"wrote {output}\nwrote {paths.picture} (look at it)\nNext:")
    print(next_command(found, paths, photographs, how.response, card.white_factor))


def _setup(board: BoardOptions, card: CardOptions, how: HandOptions) -> HandheldSetup:
    import numpy as np

    from raden_torch.capture.photo.handheld.handheld_setup import GreyPatch, HandheldSetup
    from raden_torch.capture.photo.handheld.lamp_sights import ChromeBall, FlatMirror, Shadow

    height = card.mirror_height / 1000
    return HandheldSetup(
        board=board.board,
        region_m=np.array(card.region),
        white_m=np.array(card.white_region),
        lamp_on_camera=how.lamps_stand == "camera",
        flash_m=None if how.flash_mm is None else np.array(how.flash_mm) / 1000,
        balls=tuple(ChromeBall(x, y, radius / 1000) for x, y, radius in card.ball),
        mirrors=tuple(FlatMirror(np.array(corners), height) for corners in card.mirror),
        shadows=tuple(Shadow(x, y, h / 1000, u, v) for x, y, h, u, v in card.shadow),
        greys=tuple(GreyPatch(x, y, factor / 100) for x, y, factor in card.grey),
        response=_response(how.response),
        locked=how.exposure_locked,
        camera=how.camera,
        photographs=how.photographs,
        most_blur_px=how.blur,
        every=how.every,
    )


def _response(path: Path | None) -> Floats32 | None:
    from raden_torch.capture.photo.handheld.response_fit import read_response

    return None if path is None else read_response(path)
