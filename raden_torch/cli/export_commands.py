"""A model for other programs: export, verify."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import ModelFile, argument, output
from raden_torch.cli.status import working
from raden_torch.errors import InputError
from raden_torch.files import check_output


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


@Parameter(name="*")
@dataclass(frozen=True)
class MeasuredOptions:
    """What a .bsdf file holds."""

    spectra: bool = False
    """spectra, for pbrt-v4 and Mitsuba's spectral variants, in place of RGB"""
    average: bool = False
    """the mean of an anisotropic sample, and what the format holds no better than to 3 %"""


def export(
    model: ModelFile,
    /,
    *,
    output: Annotated[
        Path,
        output(
            "the file to write: .onnx; .glsl or .wgsl, with the table beside it; .html, a viewer; "
            ".gltf, .osl or .mtlx, the nearest material that these can say; .xml, for Mitsuba 3, "
            "with the table beside it; or .bsdf, for the material `measured` of Mitsuba and pbrt-v4"
        ),
    ],
    compare: Annotated[
        ModelFile | None, Parameter(help="a second model that the viewer shows beside the first")
    ] = None,
    how: ExportOptions = ExportOptions(),
    measured: MeasuredOptions = MeasuredOptions(),
) -> None:
    check_output(output, tuple(_WRITERS), inputs=(model, compare))
    if compare is not None and output.suffix != ".html":
        raise InputError(f"--compare: expected with an .html file, got {output.suffix}")
    if output.suffix != ".onnx":
        _refuse(how, "an .onnx file", output.suffix)
    if output.suffix != ".bsdf":
        _refuse(measured, "a .bsdf file", output.suffix)
    with working("exporting"):
        said = _WRITERS[output.suffix](_Export(model, output, compare, how, measured))
    print(said)


def _refuse(options: ExportOptions | MeasuredOptions, wanted: str, suffix: str) -> None:
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise InputError(f"--{field.name}: expected with {wanted}, got {suffix}")


@dataclass(frozen=True)
class _Export:
    """What is exported, and where to."""

    model: Path
    output: Path
    compare: Path | None
    how: ExportOptions
    measured: MeasuredOptions


def _onnx(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_rgb
    from raden_torch.export.export import export_onnx

    how = what.how
    report = export_onnx(
        load_rgb(what.model, ".onnx file"),
        what.output,
        profile=how.profile,
        output=how.quantity,
        form=how.form,
        material=how.material,
        opset=how.opset,
        fixed=how.fixed,
    )
    return f"{report}\nwrote {what.output}"


def _shader(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_brdf
    from raden_torch.export.shading_language import export_shader

    written = export_shader(load_brdf(what.model, f"{what.output.suffix} file"), what.output)
    return f"{written}\nwrote {', '.join(str(file) for file in written.files)}"


def _viewer(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_brdf
    from raden_torch.export.viewer_file import export_viewer

    beside = None if what.compare is None else load_brdf(what.compare, "viewer")
    size = export_viewer(load_brdf(what.model, "viewer"), what.output, compare=beside)
    return f"a viewer of {size} bytes, which opens from disk\nwrote {what.output}"


def _gltf(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_brdf
    from raden_torch.export.gltf_file import export_gltf

    return f"{export_gltf(load_brdf(what.model, '.gltf file'), what.output)}\nwrote {what.output}"


def _osl(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_brdf
    from raden_torch.export.osl_file import export_osl

    return f"{export_osl(load_brdf(what.model, '.osl file'), what.output)}\nwrote {what.output}"


def _plugin(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_rgb
    from raden_torch.export.mitsuba.plugin_file import export_plugin

    written = export_plugin(load_rgb(what.model, ".xml file"), what.output)
    return f"{written}\nwrote {', '.join(str(file) for file in written.files)}"


def _measured(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_rgb
    from raden_torch.export.measured.measured_file import export_measured

    how = what.measured
    model = load_rgb(what.model, ".bsdf file")
    report = export_measured(model, what.output, spectra=how.spectra, average=how.average)
    return f"{report}\nwrote {what.output}"


def _materialx(what: _Export) -> str:
    from raden_torch.brdf.files.model_file import load_brdf
    from raden_torch.export.materialx_file import export_materialx

    report = export_materialx(load_brdf(what.model, ".mtlx file"), what.output)
    return f"{report}\nwrote {what.output}"


_WRITERS: dict[str, Callable[[_Export], str]] = {
    ".onnx": _onnx,
    ".glsl": _shader,
    ".wgsl": _shader,
    ".html": _viewer,
    ".gltf": _gltf,
    ".osl": _osl,
    ".xml": _plugin,
    ".bsdf": _measured,
    ".mtlx": _materialx,
}


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
    as_json: AsJson = False,
) -> None:
    with working(f"verifying {file.name}"):
        found = _verified(file, node_modules, python)
    if as_json:
        print_json(file=file, report=found)
    else:
        print(found)


def _verified(file: Path, node_modules: Path, pythons: tuple[Path, ...]) -> object:
    if file.suffix == ".xml":
        from raden_torch.export.mitsuba.check import verify_plugin

        return verify_plugin(file)
    if file.suffix == ".bsdf":
        from raden_torch.export.measured.check import verify_measured

        return verify_measured(file)
    from raden_torch.export.export import verify_onnx
    from raden_torch.export.shading_language import LANGUAGES
    from raden_torch.export.shading_language_check import verify_shader

    if file.suffix in LANGUAGES:
        return verify_shader(file, node_modules=node_modules)
    if file.suffix != ".onnx":
        raise InputError(
            f"{file}: expected a file that `raden export` wrote, .onnx, .glsl, .wgsl, .xml or "
            f".bsdf, got {file.suffix or 'no suffix'}"
        )
    return verify_onnx(file, node_modules=node_modules, pythons=pythons)
