"""Models: fit, bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

from cyclopts import Parameter

from raden_torch.cli.engine_options import ON_THIS_MACHINE, EngineOptions
from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import Names, Triple, files, output, switch
from raden_torch.cli.status import working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs

if TYPE_CHECKING:
    from raden_torch.brdf.fitting.by_azimuth import AzimuthFit
    from raden_torch.brdf.fitting.fit import FitResult
    from raden_torch.brdf.fitting.settings import FitSettings
    from raden_torch.brdf.fitting.spectral_fit import SpectralFit
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.measurement import BrdfMeasurement


@Parameter(name="*")
@dataclass(frozen=True)
class FitOptions:
    """How a model is fitted."""

    diffuse: Literal["floor", "surface"] = "floor"
    """what the diffuse formula follows off the highlight: the low values, or the surface of all
    values"""
    diffuse_scale: Triple | None = None
    """S per channel in 1/sr, set by hand, as 0.1,0.1,0.1"""
    diffuse_exponent: Triple | None = None
    """n per channel, set by hand, as 1,1,1"""
    interpolation: str = "auto"
    """interpolation between nodes: auto, trilinear (the paper), cubic, lobes; kriging for scattered
    readings"""
    validation: Path | None = None
    """readings off the grid, used to choose the interpolation"""
    assume: Literal["isotropic", "isotropic+reciprocal"] | None = None
    """what is declared of the sample: isotropic, one plane, one view or one side is then enough;
    isotropic+reciprocal, a hundred photographs of a flat piece"""
    by_azimuth: Annotated[bool, switch("a model that turns: one for each sample azimuth")] = False
    spectral: Annotated[
        bool, switch("keep the bands of the measurement, for other illuminants than its own")
    ] = False
    outside: Literal["continued", "diffuse"] = "continued"
    """beyond the measured angles: continue what was measured, or the diffuse formula alone (the
    paper)"""
    std: Annotated[
        bool, switch("keep what the measurement's stated errors do, for `raden render --std`")
    ] = False

    def __post_init__(self) -> None:
        if (self.diffuse_scale is None) != (self.diffuse_exponent is None):
            raise InputError(
                "--diffuse-scale and --diffuse-exponent go together; give both or neither"
            )
        rgb_only = (
            *(self.diffuse != "floor", self.diffuse_scale is not None),
            *(self.outside != "continued", self.by_azimuth),
        )
        if self.spectral and any(rgb_only):
            raise InputError(
                "--spectral: expected without --diffuse, --diffuse-scale, --outside and "
                "--by-azimuth, which are of a model in RGB"
            )
        if self.std and (self.spectral or self.by_azimuth):
            raise InputError("--std: expected without --spectral and --by-azimuth")
        if self.diffuse == "surface" and self.diffuse_scale is not None:
            raise InputError(
                "--diffuse surface fits what --diffuse-scale sets by hand; give one of them"
            )

    @property
    def settings(self) -> FitSettings:
        """The same for the library, in which the diffuse part may be set by hand."""
        from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
        from raden_torch.brdf.fitting.settings import FitSettings

        by_hand = self.diffuse_scale, self.diffuse_exponent
        return FitSettings(
            self.diffuse if None in by_hand else DiffuseParameters(*by_hand),  # type: ignore[arg-type]
            self.interpolation,
            self.assume,
            self.by_azimuth,
            self.spectral,
            self.outside,
            self.std,
        )


@Parameter(name="*")
@dataclass(frozen=True)
class ManyFitsOptions:
    """For a folder of models alone."""

    force: bool = False
    """replace models that are in the folder; they are kept unless stated"""
    where: EngineOptions = ON_THIS_MACHINE


def fit(
    *measurements: Annotated[
        Path,
        files("a measurement file; its format is detected. Several points of a shell: a palette"),
    ],
    output: Annotated[
        Path, output("the model file to write; or a folder, for a model of each measurement")
    ],
    names: Annotated[
        Names, Parameter(help="names of a palette's members; by default those of the files")
    ] = (),
    how: FitOptions = FitOptions(),
    as_json: AsJson = False,
    many: ManyFitsOptions = ManyFitsOptions(),
) -> None:
    if output.is_dir() or not output.suffix:
        _fit_each(measurements, output, names, how, many, as_json=as_json)
        return
    if many != ManyFitsOptions():
        raise InputError(
            f"{output}: expected a folder for models, one a measurement, with --engine or --force; "
            "got a file"
        )
    from raden_torch.capture.exchange import load_measurement

    check_output(output, (".safetensors",), inputs=(*measurements, how.validation))
    members = _member_names(measurements, names, how)
    loaded = []
    for path in measurements:
        with working(f"reading {path.name}"):
            loaded.append(load_measurement(path))
    off_grid = None if how.validation is None else load_measurement(how.validation)
    results = []
    for path, measurement in zip(measurements, loaded, strict=True):
        with working(f"fitting {path.name}"):
            results.append(_fitted(path, measurement, off_grid, how, is_one=not members))
    from raden_torch.brdf.files.model_file import save_model
    from raden_torch.brdf.materials.palette import Palette

    if members:
        models = cast("list[RadenBrdf]", [result.model for result in results])
        save_model(Palette(models, members), output)
    else:
        save_model(results[0].model, output)
    if as_json:
        reports = [result.report for result in results]
        print_json(measurements=measurements, output=output, names=members, reports=reports)
        return
    if not members:
        print(f"{loaded[0]!r}\n{results[0].report}\nwrote {output}")
        return
    for name, measurement, result in zip(members, loaded, results, strict=True):
        print(f"{name}: {measurement!r}\n{result.report}\n")
    print(f"a palette of {len(members)}: {', '.join(members)}\nwrote {output}")


def _fit_each(
    measurements: Sequence[Path],
    folder: Path,
    names: tuple[str, ...],
    how: FitOptions,
    many: ManyFitsOptions,
    *,
    as_json: bool,
) -> None:
    """A model of each measurement, on this machine or on a cluster."""
    from raden_torch.cli.sequence_run import run_items
    from raden_torch.sequences.fit_job import FitJob
    from raden_torch.sequences.local import LocalEngine
    from raden_torch.sequences.report import Report

    if names:
        raise InputError(f"--names: expected a palette in one file, got the folder {folder}")
    job = FitJob(folder, how.settings, how.validation, many.force)
    job.check(measurements)
    engine = many.where.among(LocalEngine(readers=1, writers=1))
    report = Report(measurements, named=lambda failed: ", ".join(path.name for path in failed))
    run_items(
        job, measurements, engine, folder, report, as_json=as_json, noun="measurement", called=str
    )


def _member_names(
    measurements: Sequence[Path], names: tuple[str, ...], how: FitOptions
) -> tuple[str, ...]:
    """One for each measurement, or none where there is one of these."""
    if len(measurements) == 1:
        if names:
            raise InputError("--names: expected with several measurements, got one")
        return ()
    if how.spectral:
        raise InputError("--spectral: expected with one measurement, of which it keeps the bands")
    if how.validation is not None:
        raise InputError("--validation: expected with one measurement, whose readings it has")
    found = names or tuple(path.name.partition(".")[0] for path in measurements)
    if len(found) != len(measurements):
        raise InputError(f"--names: expected {len(measurements)} names, got {len(found)}")
    twice = [name for name in found if found.count(name) > 1]
    if twice:
        raise InputError(
            f"--names: expected a different name for each measurement, got {twice[0]!r} twice"
        )
    return found


def _fitted(
    path: Path,
    measurement: BrdfMeasurement,
    off_grid: BrdfMeasurement | None,
    how: FitOptions,
    *,
    is_one: bool,
) -> FitResult | AzimuthFit | SpectralFit:
    try:
        return how.settings.fitted(measurement, off_grid)
    except InputError as error:  # of which of several?
        raise error if is_one else InputError(f"{path}: {error}") from None


@Parameter(name="*")
@dataclass(frozen=True)
class BenchOptions:
    """What is timed."""

    measurement: Path | None = None
    """a measurement on a grid, by default the simulated shell; with --readings"""
    readings: Path | None = None
    """readings off that grid"""
    height: int = 720
    """height of the timed frame, which is 16:9"""
    runs: int = 7
    """how often each form is timed; times are medians"""
    compiled: bool = False
    """also run under torch.compile; needs a C++ compiler"""

    def __post_init__(self) -> None:
        if (self.measurement is None) != (self.readings is None):
            raise InputError("--measurement and --readings go together; give both or neither")
        if not 16 <= self.height <= 8192:
            raise InputError(f"--height: expected 16…8192, got {self.height}")
        if not 1 <= self.runs <= 1000:
            raise InputError(f"--runs: expected 1…1000, got {self.runs}")


def bench(
    *,
    out: Annotated[Path, Parameter(help="the folder for bench.json and the plot")] = Path("bench"),
    what: BenchOptions = BenchOptions(),
    as_json: AsJson = False,
) -> None:
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder, got a file")
    from raden_torch.bench import OUTPUTS, run_bench
    from raden_torch.capture.exchange import load_measurement

    if out.is_dir():
        results = (out / name for name in OUTPUTS)
        check_outputs(*results, inputs=(what.measurement, what.readings))
    grid = None if what.measurement is None else load_measurement(what.measurement)
    off_grid = None if what.readings is None else load_measurement(what.readings)
    frame = (what.height, what.height * 16 // 9)
    plot_path = run_bench(
        out,
        grid,
        off_grid,
        say=_unsaid if as_json else print,
        frame=frame,
        runs=what.runs,
        compiled=what.compiled,
    )
    figures = plot_path.with_name("bench.json")
    if as_json:
        print(figures.read_text("utf-8"), end="")
    else:
        print(f"wrote {figures}\nwrote {plot_path}")


def _unsaid(_: str) -> None:
    """Rows are in bench.json, too."""
