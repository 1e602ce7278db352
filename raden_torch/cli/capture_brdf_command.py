"""From photographs of a sample of known shape: capture brdf."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from raden_torch.cli.capture_brdf_options import (
    ResultOptions,
    SampleOptions,
    SetupOptions,
    WhiteOptions,
)
from raden_torch.cli.capture_options import DevelopmentOptions, Picture
from raden_torch.cli.option_types import files, output
from raden_torch.cli.status import progress, without_other_inputs
from raden_torch.files import check_outputs


def brdf(
    *photos: Annotated[
        Path,
        files("photographs of the sample, one under each lamp, in the lamps' order"),
    ],
    output: Annotated[Path, output("the .csv file to write")],
    picture: Picture = None,
    sample: SampleOptions,
    white: WhiteOptions = WhiteOptions(),
    setup: SetupOptions,
    reading: DevelopmentOptions = DevelopmentOptions(),
    result: ResultOptions = ResultOptions(),
) -> None:
    from raden_torch.capture.photo.brdf.photo_brdf_file import output_paths, write_brdf
    from raden_torch.capture.photo.capture_brdf import capture_brdf
    from raden_torch.measurement import Metadata
    from raden_torch.plots.coverage_figure import draw_captured
    from raden_torch.plots.sheet import save_plot

    report, shown = output_paths(output, picture)
    beside = (sample.mask, white.white_mask, *reading.files)
    used = without_other_inputs(photos, *beside)
    files = (setup.lights, setup.camera, setup.colour, setup.plan, white.white_file)
    check_outputs(output, report, shown, inputs=(*used, *beside, *files))
    place, factor = white.white(setup.colour)
    with progress("reading the photographs") as share_done:
        found = capture_brdf(
            used,
            setup.setup(reading),
            sample.sample,
            place,
            factor,
            grid=result.grid(),
            scattered=result.scattered,
            metadata=Metadata(result.name or output.stem, simulated=result.simulated),
            plan=setup.plan,
            go_on=result.go_on,
            progress=share_done,
        )
    (found.read if result.scattered else found.measurement).save(output)
    write_brdf(found, report)
    save_plot(draw_captured(found), shown)
    print(found)
    print(f"wrote {output}\nwrote {report}\nwrote {shown} (look at it)")
