"""Measurements and models: fit, info, plot, bench, export, verify."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raden_torch.cli.common import ModelFile, app, triple, working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs

if TYPE_CHECKING:
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.measurement import BrdfMeasurement


class Outside(str, Enum):
    """What stands beyond the measured angles."""

    continued = "continued"
    diffuse = "diffuse"


class Symmetry(str, Enum):
    """What may be assumed of a sample."""

    isotropic = "isotropic"


@app.command(epilog="Example: raden fit shell.csv -o shell.safetensors")
def fit(
    measurement: Annotated[Path, typer.Argument(help="a measurement file; its format is detected")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the model file to write")],
    diffuse_scale: Annotated[
        str | None, typer.Option(help="S per channel in 1/sr, set by hand, as 0.1,0.1,0.1")
    ] = None,
    diffuse_exponent: Annotated[
        str | None, typer.Option(help="n per channel, set by hand, as 1,1,1")
    ] = None,
    interpolation: Annotated[
        str,
        typer.Option(
            help="interpolation between nodes: auto, trilinear (the paper), cubic, lobes; kriging "
            "for scattered readings"
        ),
    ] = "auto",
    validation: Annotated[
        Path | None, typer.Option(help="readings off the grid, used to choose the interpolation")
    ] = None,
    assume: Annotated[
        Symmetry | None,
        typer.Option(
            help="assumed symmetry of the sample: one plane, one view or one side is then enough"
        ),
    ] = None,
    outside: Annotated[
        Outside,
        typer.Option(
            help="beyond the measured angles: continue what was measured, or the diffuse formula "
            "alone (the paper)"
        ),
    ] = Outside.continued,
) -> None:
    """Fit a model to a measurement and report how well."""
    from raden_torch.capture.importers import load_measurement

    check_output(output, (".safetensors",), inputs=(measurement, validation))
    if (diffuse_scale is None) != (diffuse_exponent is None):
        raise InputError("--diffuse-scale and --diffuse-exponent go together; give both or neither")
    with working(f"reading {measurement.name}"):
        loaded = load_measurement(measurement)
        off_grid = None if validation is None else load_measurement(validation)
    with working("fitting"):
        from raden_torch.brdf.files.model_file import save_model
        from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
        from raden_torch.brdf.fitting.fit import fit as fit_model

        by_hand = None
        if diffuse_scale is not None and diffuse_exponent is not None:
            by_hand = DiffuseParameters(
                triple("--diffuse-scale", diffuse_scale),
                triple("--diffuse-exponent", diffuse_exponent),
            )
        result = fit_model(
            loaded,
            diffuse=by_hand,
            interpolation=interpolation,
            validation=off_grid,
            assume=None if assume is None else assume.value,
            outside=outside.value,
        )
        save_model(result.model, output)
    print(f"{loaded!r}\n{result.report}\nwrote {output}")


@app.command(epilog="Example: raden info scan.csv photographs.csv")
def info(
    file: Annotated[Path | None, typer.Argument(help="any file that raden writes or reads")] = None,
    other: Annotated[
        Path | None, typer.Argument(help="a measurement to compare the first one with")
    ] = None,
    against: Annotated[
        Path | None, typer.Option(help="readings to score a model against, e.g. off its grid")
    ] = None,
    system: Annotated[
        bool,
        typer.Option("--system", help="show which form of the model runs on this machine instead"),
    ] = False,
) -> None:
    """Say what a file holds; compare two measurements; score a model on other readings."""
    if system == (file is not None):
        raise InputError("info: give a FILE, or --system")
    if file is None:
        from raden_torch.brdf.model.simd import system_report

        print(system_report())
        return

    from raden_torch.info import describe_file

    if other is not None and against is not None:
        raise InputError("info: two measurements are compared, --against scores a model; give one")
    with working(f"reading {file.name}"):
        if other is not None:
            text = _compared(file, other)
        else:
            text = describe_file(file)
            if against is not None:
                text += f"\nagainst {against.name}: {_scored(file, against)}"
    print(text)


def _measurement(path: Path) -> BrdfMeasurement:
    """The measurement in a file; another kind of file is named in the error."""
    from raden_torch.measurement import BrdfMeasurement

    loaded = load(path)
    if isinstance(loaded, BrdfMeasurement):
        return loaded
    raise InputError(f"{path}: expected a measurement, got a model")


def _compared(first: Path, second: Path) -> str:
    from raden_torch.measurement.compare import compare

    return str(compare(_measurement(first), _measurement(second)))


def _scored(model: Path, readings: Path) -> str:
    from raden_torch.brdf.fitting.score import score
    from raden_torch.measurement import BrdfMeasurement

    loaded = load(model)
    if isinstance(loaded, BrdfMeasurement):
        raise InputError(f"--against: expected a model to score, got a measurement ({model})")
    return str(score(loaded, _measurement(readings)))


@app.command(epilog="Example: raden merge scan.csv photographs.csv -o shell.csv")
def merge(
    files: Annotated[list[Path], typer.Argument(help="measurements of one specimen")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the measurement to write, .csv")],
    robust: Annotated[
        bool,
        typer.Option(
            "--robust",
            help="if readings contradict each other, enlarge their uncertainty instead of refusing",
        ),
    ] = False,
) -> None:
    """Make one measurement of several, each reading weighed by its uncertainty."""
    from raden_torch.measurement.merge import merge as merge_measurements

    check_output(output, (".csv",), inputs=files)
    with working("merging"):
        merged = merge_measurements([_measurement(path) for path in files], robust=robust)
        merged.measurement.save(output)
    print(f"{merged}\nwrote {output}")


@app.command(epilog="Example: raden plot shell.csv -o graphs.png --figure 5 --figure 9")
def plot(
    file: Annotated[Path, typer.Argument(help="a measurement or a model")],
    other: Annotated[
        Path | None, typer.Argument(help="a measurement to compare the first one with")
    ] = None,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", help=".png, .svg or .pdf")],
    figure: Annotated[
        list[str] | None,
        typer.Option(help="5, 6, 7, 8, 9 or path; may be repeated; by default all"),
    ] = None,
    incidence: Annotated[float, typer.Option(help="angle held in figs 5, 6 and 9, degrees")] = 20.0,
    tilt: Annotated[float, typer.Option(help="angle held in fig. 5, degrees")] = 10.0,
    surface_tilt: Annotated[float, typer.Option(help="angle held in figs 7 and 8, degrees")] = 55.0,
) -> None:
    """Draw the paper's graphs of a measurement or a model; or where two measurements differ."""
    from raden_torch.plots import FIGURES, check_plot_path, draw, draw_comparison, save_plot

    check_plot_path(output)
    check_output(output, inputs=(file, other))
    if other is not None:
        if figure:
            raise InputError("plot: --figure is of one file; two are compared on one sheet")
        save_plot(draw_comparison(*(_measurement(path) for path in (file, other))), output)
        print(f"wrote {output}")
        return
    with working(f"drawing {file.name}"):
        sheet = draw(
            load(file),
            figure or FIGURES,
            incidence_deg=incidence,
            tilt_deg=tilt,
            surface_tilt_deg=surface_tilt,
        )
        save_plot(sheet, output)
    print(f"wrote {output}")


@app.command(epilog="Example: raden export shell.safetensors -o shell.onnx --profile scene")
def export(
    model: ModelFile,
    output: Annotated[Path, typer.Option("--output", "-o", help="the .onnx file to write")],
    profile: Annotated[
        str, typer.Option(help="gbuffer (normal, light, view) or scene (with camera and lights)")
    ] = "gbuffer",
    quantity: Annotated[
        str, typer.Option("--quantity", help="radiance, or brdf (f_r in 1/sr, gbuffer only)")
    ] = "radiance",
    form: Annotated[
        str, typer.Option(help="runtime, or fit (the paper's formula and table: slower, editable)")
    ] = "runtime",
    opset: Annotated[int, typer.Option(help="version of the ONNX operator set")] = 18,
    fixed: Annotated[
        bool,
        typer.Option(
            "--fixed", help="make the parameters constants: faster, but for this shell alone"
        ),
    ] = False,
) -> None:
    """Write a model as an ONNX shader for other programs, checked in ONNX Runtime."""
    from raden_torch.brdf.files.model_file import load_model
    from raden_torch.export.export import export_onnx

    check_output(output, (".onnx",), inputs=(model,))
    with working("exporting"):
        report = export_onnx(
            load_model(model),
            output,
            profile=profile,
            output=quantity,
            form=form,
            opset=opset,
            fixed=fixed,
        )
    print(f"{report}\nwrote {output}")


@app.command(epilog="Example: raden verify shell.onnx")
def verify(
    file: Annotated[Path, typer.Argument(help="a file that `raden export` wrote")],
    node_modules: Annotated[
        Path,
        typer.Option(help="folder with onnxruntime-node, or onnxruntime-web and playwright-core"),
    ] = Path("node_modules"),
    python: Annotated[
        list[Path] | None,
        typer.Option(help="Python of another environment with onnxruntime; may be repeated"),
    ] = None,
) -> None:
    """Check an exported shader in every runtime on this machine."""
    from raden_torch.export.export import verify_onnx

    with working(f"verifying {file.name}"):
        report = verify_onnx(file, node_modules=node_modules, pythons=python or ())
    print(report)


@app.command(epilog="Example: raden bench --out bench")
def bench(
    out: Annotated[Path, typer.Option(help="the folder for bench.json and the plot")] = Path(
        "bench"
    ),
    measurement: Annotated[
        Path | None,
        typer.Option(
            help="a measurement on a grid, by default the simulated shell; with --readings"
        ),
    ] = None,
    readings: Annotated[Path | None, typer.Option(help="readings off that grid")] = None,
    height: Annotated[int, typer.Option(help="height of the timed frame, which is 16:9")] = 720,
    compiled: Annotated[
        bool, typer.Option("--compiled", help="also run under torch.compile; needs a C++ compiler")
    ] = False,
) -> None:
    """Run time against error, of every interpolator and backend."""
    from raden_torch.bench import OUTPUTS, run_bench
    from raden_torch.capture.importers import load_measurement

    if (measurement is None) != (readings is None):
        raise InputError("--measurement and --readings go together; give both or neither")
    if not 16 <= height <= 8192:
        raise InputError(f"--height: expected 16…8192, got {height}")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder, got a file")
    if out.is_dir():
        results = (out / name for name in OUTPUTS)
        check_outputs(*results, inputs=(measurement, readings))
    grid = None if measurement is None else load_measurement(measurement)
    off_grid = None if readings is None else load_measurement(readings)
    plot_path = run_bench(out, grid, off_grid, frame=(height, height * 16 // 9), compiled=compiled)
    print(f"wrote {plot_path.with_name('bench.json')}\nwrote {plot_path}")


def load(path: Path) -> BrdfMeasurement | RadenBrdf:
    """A model or a measurement, whichever the file is."""
    from raden_torch.info import kind_of

    name = kind_of(path).name
    if name == "a model":
        from raden_torch.brdf.files.model_file import load_model

        return load_model(path)
    if name != "a measurement":
        raise InputError(f"{path}: expected a measurement or a model, got {name}")
    from raden_torch.capture.importers import load_measurement

    return load_measurement(path)
