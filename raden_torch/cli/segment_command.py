"""raden capture segment: the map of an inlay's materials from photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from raden_torch.cli.capture_options import Coded
from raden_torch.cli.option_types import files, output
from raden_torch.cli.status import without_other_inputs, working
from raden_torch.files import check_output, check_outputs


def segment(
    *photos: Annotated[
        Path, files("photographs of the inlay from one place, best under several lamps")
    ],
    output: Annotated[Path, output("the map of indices to write, .png; 0 is the ground")],
    shells: Annotated[int, Parameter(help="how many different shells there are")] = 1,
    smallest_px: Annotated[int, Parameter(help="an area of fewer pixels is no piece")] = 16,
    picture: Annotated[
        Path | None,
        Parameter(help="image of what was found; by default beside the map, as .found.png"),
    ] = None,
    coded: Coded = "auto",
) -> None:
    from raden_torch.capture.photo.capture_segment import capture_segment
    from raden_torch.capture.photo.checking_picture import picture_path

    used = without_other_inputs(photos)
    check_output(output, (".png",))
    shown = picture_path(picture or output.with_suffix(".found.png"), output)
    check_outputs(output, shown, inputs=used)
    with working("looking for pieces"):
        text = capture_segment(used, output, shown, shells, smallest_px=smallest_px, coded=coded)
    print(f"{text}\nwrote {output}\nwrote {shown} (look at it)")
