"""Models: fit, export, verify, bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from raden_torch.cli.option_types import ModelFile, Names, Triple, argument, files, output
from raden_torch.cli.status import working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs

if TYPE_CHECKING:
    from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
    from raden_torch.brdf.fitting.fit import FitResult
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
    assume: Literal["isotropic"] | None = None
    """assumed symmetry of the sample: one plane, one view or one side is then enough"""
    outside: Literal["continued", "diffuse"] = "continued"
    """beyond the measured angles: continue what was measured, or the diffuse formula alone (the
    paper)"""

    def __post_init__(self) -> None:
        if (self.diffuse_scale is None) != (self.diffuse_exponent is None):
            raise InputError(
                "--diffuse-scale and --diffuse-exponent go together; give both or neither"
            )
        if self.diffuse == "surface" and self.diffuse_scale is not None:
            raise InputError(
                "--diffuse surface fits what --diffuse-scale sets by hand; give one of them"
            )

    @property
    def diffuse_part(self) -> DiffuseParameters | Literal["floor", "surface"]:
        """The diffuse part set by hand, or what it is fitted to."""
        from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters

        if self.diffuse_scale is None or self.diffuse_exponent is None:
            return self.diffuse
        return DiffuseParameters(self.diffuse_scale, self.diffuse_exponent)


def fit(
    *measurements: Annotated[
        Path,
        files("a measurement file; its format is detected. Several points of a shell: a palette"),
    ],
    output: Annotated[Path, output("the model file to write")],
    names: Annotated[
        Names, Parameter(help="names of a palette's members; by default those of the files")
    ] = (),
    how: FitOptions = FitOptions(),
) -> None:
    from raden_torch.capture.importers import load_measurement

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

    if not members:
        save_model(results[0].model, output)
        print(f"{loaded[0]!r}\n{results[0].report}\nwrote {output}")
        return
    save_model(Palette([result.model for result in results], members), output)
    for name, measurement, result in zip(members, loaded, results, strict=True):
        print(f"{name}: {measurement!r}\n{result.report}\n")
    print(f"a palette of {len(members)}: {', '.join(members)}\nwrote {output}")


def _member_names(
    measurements: Sequence[Path], names: tuple[str, ...], how: FitOptions
) -> tuple[str, ...]:
    """One for each measurement, or none where there is one of these."""
    if len(measurements) == 1:
        if names:
            raise InputError("--names: expected with several measurements, got one")
        return ()
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
) -> FitResult:
    from raden_torch.brdf.fitting.fit import fit as fit_model

    try:
        return fit_model(
            measurement,
            diffuse=how.diffuse_part,
            interpolation=how.interpolation,
            validation=off_grid,
            assume=how.assume,
            outside=how.outside,
        )
    except InputError as error:  # of which of several?
        raise error if is_one else InputError(f"{path}: {error}") from None


@Parameter(name="*")
@dataclass(frozen=True)
class ExportOptions:
    """Which shader is made of a model."""

    profile: str = "gbuffer"
    """gbuffer (normal, light, view) or scene (with camera and lights)"""
    quantity: str = "radiance"
    """radiance, or brdf (f_r in 1/sr, gbuffer only)"""
    form: Literal["runtime", "fit"] = "runtime"
    """runtime, or fit (the paper's formula and table: slower, editable)"""
    material: Literal["index", "weights"] = "index"
    """what chooses of a palette: an index, or a weight of each material, a pixel"""
    opset: int = 18
    """version of the ONNX operator set"""
    fixed: bool = False
    """make the parameters constants: faster, but for this shell alone"""


def export(
    model: ModelFile,
    /,
    *,
    output: Annotated[
        Path,
        output(
            "the file to write: .onnx; .glsl or .wgsl, with the table beside it; .html, a viewer; "
            "or .gltf or .osl, the nearest material that these can say"
        ),
    ],
    compare: Annotated[
        ModelFile | None, Parameter(help="a second model that the viewer shows beside the first")
    ] = None,
    how: ExportOptions = ExportOptions(),
) -> None:
    from raden_torch.brdf.files.model_file import load_brdf, load_model
    from raden_torch.export.export import export_onnx
    from raden_torch.export.shading_language import LANGUAGES, export_shader

    check_output(output, (".onnx", *LANGUAGES, ".html", ".gltf", ".osl"), inputs=(model, compare))
    if compare is not None and output.suffix != ".html":
        raise InputError(f"--compare: expected with an .html file, got {output.suffix}")
    if output.suffix == ".html":
        from raden_torch.export.viewer_file import export_viewer

        _refuse_onnx_options(how, output.suffix)
        beside = None if compare is None else load_brdf(compare, "viewer")
        size = export_viewer(load_brdf(model, "viewer"), output, compare=beside)
        print(f"a viewer of {size} bytes, which opens from disk\nwrote {output}")
        return
    if output.suffix == ".gltf":
        from raden_torch.export.gltf_file import export_gltf

        _refuse_onnx_options(how, output.suffix)
        with working("fitting a glTF material"):
            nearest = export_gltf(load_model(model), output)
        print(f"{nearest}\nwrote {output}")
        return
    if output.suffix == ".osl":
        from raden_torch.export.osl_file import export_osl

        _refuse_onnx_options(how, output.suffix)
        with working("fitting closures"):
            closures = export_osl(load_brdf(model, ".osl file"), output)
        print(f"{closures}\nwrote {output}")
        return
    if output.suffix in LANGUAGES:
        _refuse_onnx_options(how, output.suffix)
        written = export_shader(load_brdf(model, f"{output.suffix} file"), output)
        print(f"{written}\nwrote {', '.join(str(file) for file in written.files)}")
        return
    with working("exporting"):
        report = export_onnx(
            load_model(model),
            output,
            profile=how.profile,
            output=how.quantity,
            form=how.form,
            material=how.material,
            opset=how.opset,
            fixed=how.fixed,
        )
    print(f"{report}\nwrote {output}")


def _refuse_onnx_options(how: ExportOptions, suffix: str) -> None:
    for field in fields(how):
        if getattr(how, field.name) != field.default:
            raise InputError(f"--{field.name}: expected with an .onnx file, got {suffix}")


def verify(
    file: Annotated[Path, argument("a file that `raden export` wrote")],
    /,
    *,
    node_modules: Annotated[
        Path,
        Parameter(help="folder with onnxruntime-node, or onnxruntime-web and playwright-core"),
    ] = Path("node_modules"),
    python: Annotated[
        tuple[Path, ...],
        Parameter(help="Python of another environment with onnxruntime; may be repeated"),
    ] = (),
) -> None:
    from raden_torch.export.export import verify_onnx
    from raden_torch.export.shading_language import LANGUAGES
    from raden_torch.export.shading_language_check import verify_shader

    if file.suffix in LANGUAGES:
        with working(f"verifying {file.name}"):
            check = verify_shader(file, node_modules=node_modules)
        print(check)
        return
    with working(f"verifying {file.name}"):
        report = verify_onnx(file, node_modules=node_modules, pythons=python)
    print(report)


@Parameter(name="*")
@dataclass(frozen=True)
class BenchOptions:
    """What is timed."""

    out: Path = Path("bench")
    """the folder for bench.json and the plot"""
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
        if self.out.exists() and not self.out.is_dir():
            raise InputError(f"{self.out}: expected a folder, got a file")


def bench(*, what: BenchOptions = BenchOptions()) -> None:
    from raden_torch.bench import OUTPUTS, run_bench
    from raden_torch.capture.importers import load_measurement

    if what.out.is_dir():
        results = (what.out / name for name in OUTPUTS)
        check_outputs(*results, inputs=(what.measurement, what.readings))
    grid = None if what.measurement is None else load_measurement(what.measurement)
    off_grid = None if what.readings is None else load_measurement(what.readings)
    frame = (what.height, what.height * 16 // 9)
    plot_path = run_bench(
        what.out, grid, off_grid, frame=frame, runs=what.runs, compiled=what.compiled
    )
    print(f"wrote {plot_path.with_name('bench.json')}\nwrote {plot_path}")
