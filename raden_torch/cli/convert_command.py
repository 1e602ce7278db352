"""raden convert: measurements and models in other programs' formats."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from raden_torch.cli.file_commands import load_either
from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import argument
from raden_torch.cli.status import working
from raden_torch.files import check_output


def convert(
    file: Annotated[Path, argument("a measurement of any format that raden reads, or a model")],
    output: Annotated[
        Path,
        argument(
            "the file to write: .csv, .astm, .binary (MERL), .anisotropicbsdf (SPEOS); .bsdf and "
            ".txt with --to"
        ),
    ],
    /,
    *,
    to: Annotated[
        str | None,
        Parameter(help="format: csv, astm, merl, zemax, lighttools, fred or speos"),
    ] = None,
    channel: Annotated[
        str | None,
        Parameter(help="the one channel to keep, as Y, R or 550nm; by default Y, if one must be"),
    ] = None,
    average: Annotated[
        bool, Parameter(help="take readings at several azimuths of the sample for one")
    ] = False,
    assume: Annotated[
        Literal["isotropic"] | None,
        Parameter(help="assumed symmetry: one plane, one view or one side is then enough"),
    ] = None,
    holes: Annotated[
        bool, Parameter(help="leave what lies beyond the measured angles empty")
    ] = False,
    step_deg: Annotated[
        float | None,
        Parameter(help="step of a grid that is made, degrees; 5 where the readings have none"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    from raden_torch.capture.exchange.formats import FORMATS, format_of
    from raden_torch.conversion.convert import convert as convert_to
    from raden_torch.conversion.options import Options

    name = format_of(output, to)
    check_output(output, FORMATS[name].suffixes, inputs=(file,))
    options = Options(name, channel, average, assume, holes, step_deg)
    with working(f"reading {file.name}"):
        source = load_either(file)
    with working(f"converting {file.name}"):
        done = convert_to(source, output, options)
    if as_json:
        print_json(input=file, output=output, **asdict(done))
    else:
        print(f"{done}\nwrote {output}")
