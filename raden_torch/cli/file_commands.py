"""What files hold, and what is made of them without a fit: info, merge, plot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import argument, files, output
from raden_torch.cli.status import working
from raden_torch.errors import InputError
from raden_torch.files import check_output

if TYPE_CHECKING:
    from raden_torch.brdf.fitting.score import Score
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.measurement import BrdfMeasurement
    from raden_torch.measurement.compare import Comparison


def info(
    file: Annotated[Path | None, argument("any file that raden writes or reads")] = None,
    other: Annotated[Path | None, argument("a measurement to compare the first one with")] = None,
    /,
    *,
    against: Annotated[
        Path | None, Parameter(help="readings to score a model against, e.g. off its grid")
    ] = None,
    system: Annotated[
        bool, Parameter(help="show which form of the model runs on this machine instead")
    ] = False,
    as_json: AsJson = False,
) -> None:
    if system == (file is not None):
        raise InputError("info: give a FILE, or --system")
    if file is None:
        from raden_torch.brdf.model.simd import system_report

        said = system_report()
        if as_json:
            print_json(system=said.splitlines())
        else:
            print(said)
        return
    if other is not None and against is not None:
        raise InputError("info: two measurements are compared, --against scores a model; give one")
    with working(f"reading {file.name}"):
        report, text = _about(file, other, against)
    if as_json:
        print_json(file=file, **report)
    else:
        print(text)


def _about(file: Path, other: Path | None, against: Path | None) -> tuple[dict[str, Any], str]:
    """What is known of a file, for programs and for people."""
    from raden_torch.info import describe_file, kind_of

    if other is not None:
        compared = _compared(file, other)
        verdict = {"agrees": compared.agrees, "p": compared.p, "birge": compared.birge}
        return {"other": other, "comparison": compared, **verdict}, str(compared)
    text = describe_file(file)
    report = {"kind": kind_of(file).name, "facts": text.splitlines()}
    if against is None:
        return report, text
    found = _scored(file, against)
    return {
        **report,
        "against": against,
        "score": found,
    }, f"{text}\nagainst {against.name}: {found}"


def _measurement(path: Path) -> BrdfMeasurement:
    """The measurement in a file; another kind of file is named in the error."""
    from raden_torch.measurement import BrdfMeasurement

    loaded = load_either(path)
    if isinstance(loaded, BrdfMeasurement):
        return loaded
    raise InputError(f"{path}: expected a measurement, got a model")


def _compared(first: Path, second: Path) -> Comparison:
    from raden_torch.measurement.compare import compare

    return compare(_measurement(first), _measurement(second))


def _scored(model: Path, readings: Path) -> Score:
    from raden_torch.brdf.fitting.score import score
    from raden_torch.measurement import BrdfMeasurement

    loaded = load_either(model)
    if isinstance(loaded, BrdfMeasurement):
        raise InputError(f"--against: expected a model to score, got a measurement ({model})")
    return score(loaded, _measurement(readings))


def _weighed(path: Path) -> BrdfMeasurement:
    """A measurement that states standard deviations."""
    measurement = _measurement(path)
    if measurement.std is None:
        columns = ", ".join(f"std_{name}" for name in measurement.channels[:3])
        raise InputError(
            f"{path}: expected columns {columns}, by which its readings are weighed, got none"
        )
    return measurement


def merge(
    *files: Annotated[Path, files("measurements of one specimen")],
    output: Annotated[Path, output("the measurement to write, .csv")],
    robust: Annotated[
        bool,
        Parameter(
            help="if readings contradict each other, enlarge their uncertainty instead of refusing"
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    from raden_torch.measurement.merge import merge as merge_measurements

    check_output(output, (".csv",), inputs=files)
    with working("merging"):
        merged = merge_measurements([_weighed(path) for path in files], robust=robust)
        merged.measurement.save(output)
    if not as_json:
        print(f"{merged}\nwrote {output}")
        return
    report = {key: value for key, value in vars(merged).items() if key != "measurement"}
    print_json(measurements=files, output=output, readings=len(merged.measurement), **report)


@Parameter(name="*")
@dataclass(frozen=True)
class PlotOptions:
    """Which graphs, and at which angles."""

    figure: tuple[str, ...] = ()
    """5, 6, 7, 8, 9, path, map, colours, polar, ridge or std; may be repeated; by default all"""
    incidence_deg: float = 20.0
    """angle held in figs 5, 6 and 9, the maps and the polar curve, degrees"""
    tilt_deg: float = 10.0
    """angle held in fig. 5, degrees"""
    surface_tilt_deg: float = 55.0
    """angle held in figs 7 and 8, degrees"""


def plot(
    file: Annotated[Path, argument("a measurement or a model")],
    other: Annotated[Path | None, argument("a measurement to compare the first one with")] = None,
    /,
    *,
    output: Annotated[Path, output(".png, .svg or .pdf")],
    what: PlotOptions = PlotOptions(),
) -> None:
    from raden_torch.plots import check_plot_path, draw, draw_comparison, save_plot

    check_plot_path(output)
    check_output(output, inputs=(file, other))
    if other is not None:
        if what.figure:
            raise InputError("plot: --figure is of one file; two are compared on one sheet")
        save_plot(draw_comparison(*(_measurement(path) for path in (file, other))), output)
        print(f"wrote {output}")
        return
    with working(f"drawing {file.name}"):
        sheet = draw(
            load_either(file),
            what.figure or None,
            incidence_deg=what.incidence_deg,
            tilt_deg=what.tilt_deg,
            surface_tilt_deg=what.surface_tilt_deg,
        )
        save_plot(sheet, output)
    print(f"wrote {output}")


def load_either(path: Path) -> BrdfMeasurement | RadenBrdf:
    """A model or a measurement, whichever the file is."""
    from raden_torch.info import kind_of

    name = kind_of(path).name
    if name == "a model":
        from raden_torch.brdf.files.model_file import load_brdf

        return load_brdf(path)
    if name != "a measurement":
        raise InputError(f"{path}: expected a measurement or a model, got {name}")
    from raden_torch.capture.exchange import load_measurement

    return load_measurement(path)
