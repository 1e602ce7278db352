"""`export_onnx`: a model becomes a file that other programs run; `verify_onnx` checks one again."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from raden_torch.brdf.materials.runtime import models_of
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError, check_type, why
from raden_torch.export import onnx_file
from raden_torch.export.check import ExportReport, RuntimeResult, StressSet
from raden_torch.export.constants import fix_parameters, is_fixed
from raden_torch.export.forms import Form, form_of
from raden_torch.export.profiles import check_profile, ports
from raden_torch.export.runtimes import load_onnxruntime, load_others, one_line
from raden_torch.files import check_output, written_beside
from raden_torch.packages import require

if TYPE_CHECKING:
    import onnx

OPSETS = range(18, 22)
"""What torch's exporter writes and ONNX Runtime reads."""


def export_onnx(
    model: Reflection,
    path: str | os.PathLike[str],
    *,
    profile: str = "gbuffer",
    output: str = "radiance",
    form: str = "runtime",
    material: str = "index",
    opset: int = onnx_file.OPSET,
    fixed: bool = False,
) -> ExportReport:
    """Write a model as an ONNX shader, once ONNX Runtime has given torch's picture with it.

    Args:
        model: float32 or float64, on the CPU; the file computes in float32. A `RadenBrdf`, or
            another material of the three angles (`Coated`, …) as one table; or a `Palette`, of
            which a further input chooses for each pixel.
        path: the `.onnx` file to write.
        profile: "gbuffer": normal, light and view maps; "scene": normals, positions, a camera and
            any number of lights. See docs/export.md.
        output: "radiance" (scene-linear RGB) or "brdf" (f_r in 1/sr; gbuffer only).
        form: "runtime": the table over the whole hemisphere that the model itself is read through;
            "fit": the paper's eq. (2), whose diffuse parameters and gains are inputs, and slower.
        material: of a palette: "index", the input `material` `[B, 1, H, W]`, whole numbers; or
            "weights", the input `weights` `[B, K, H, W]`, which evaluates every material for every
            pixel (gbuffer only).
        opset: of the ONNX operators; the oldest, 18, runs in most programs.
        fixed: the form's parameters are constants. Runtimes then pack the table once, not at every
            call, which pays in small pictures and tiles; no other shell can be shown by the file.

    Returns:
        How far ONNX Runtime is from torch, by region; also stored in the file.

    Raises:
        InputError: no such profile, output, form or opset; a model in half precision, not finite or
            not on the CPU; `path` cannot be written; a package is missing; or the pictures differ,
            in which case there is no file.

    Examples:
        >>> import raden_torch as rt
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> report = rt.export_onnx(model, "shell.onnx")
        >>> report.profile, report.opset, [runtime.name for runtime in report.runtimes]
        ('gbuffer', 18, ['onnxruntime'])
    """
    if not callable(getattr(model, "of_unit_vectors", None)):
        hint = "load_model reads one from a file; fit(…).model is one"
        check_type("model", model, RadenBrdf, hint)
    check_profile(profile, output)
    if opset not in OPSETS:
        raise InputError(f"opset: expected {OPSETS[0]} to {OPSETS[-1]}, got {opset}")
    target = check_output(path, (".onnx",))
    for own in models_of(model):
        _check_exportable(own)
    made = form_of(model, form, material)
    require("exported shaders", "export")
    graph = _graph(model, made, profile, output, opset)
    if fixed:
        fix_parameters(graph)
    stress = StressSet(made, profile, output, fixed=fixed)
    report = _report(graph, stress, [_in_onnxruntime(stress, graph.SerializeToString())])
    if report.failures:
        raise InputError(f"{target}: not written: {report.failures[0]}")
    entry = graph.metadata_props.add()
    entry.key, entry.value = "report", json.dumps(replace(report, bytes=0).as_dict())
    data = graph.SerializeToString()
    onnx_file.read_graph(data)  # the checker has the last word
    with written_beside(target) as temporary:
        temporary.write_bytes(data)
    return replace(report, bytes=len(data))


def verify_onnx(
    path: str | os.PathLike[str],
    *,
    node_modules: Path | None = None,
    pythons: Sequence[Path] = (),
) -> ExportReport:
    """Check a file that `export_onnx` wrote in every runtime on this machine.

    The form is rebuilt from the file alone; torch's picture of it is compared with each runtime's.

    Args:
        node_modules: a folder with onnxruntime-node, or onnxruntime-web and playwright-core, to run
            it in Node.js and in Chromium, too.
        pythons: the programs of other Python environments, to run it in their onnxruntime.

    Raises:
        InputError: not an ONNX file of ours, damaged, or a runtime gives another picture.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: expected an exported .onnx file, got {why(error)}") from None
    try:
        report = _verified(data, node_modules, pythons)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if report.failures:
        raise InputError(f"{path}: {report.failures[0]}")
    return report


def _graph(model: Reflection, form: Form, profile: str, output: str, opset: int) -> onnx.ModelProto:
    from raden_torch.export.shaders import Shader
    from raden_torch.export.trace import trace

    inputs = ports(form, profile, output)
    traced = trace(Shader(form, profile, output, inputs), inputs, output, opset)
    return onnx_file.finished(traced, model, form, profile, output)


def _report(
    graph: onnx.ModelProto, stress: StressSet, runtimes: list[RuntimeResult]
) -> ExportReport:
    texts = onnx_file.metadata(graph)
    return ExportReport(
        form=texts["form"],
        profile=texts["profile"],
        output=texts["output"],
        opset=next(o.version for o in graph.opset_import if o.domain in ("", "ai.onnx")),
        ir_version=graph.ir_version,
        nodes=len(graph.graph.node),
        bytes=graph.ByteSize(),
        torch=torch.__version__.split("+")[0],
        peak=stress.peak,
        runtimes=tuple(runtimes),
    )


def _verified(data: bytes, node_modules: Path | None, pythons: Sequence[Path]) -> ExportReport:
    graph = onnx_file.read_graph(data)
    texts = onnx_file.metadata(graph)
    if texts.get("format") != onnx_file.FORMAT:
        raise InputError(
            "expected a shader of raden_torch (`raden export` writes one), got another model"
        )
    version = texts.get("format_version", "")
    if version != str(onnx_file.FORMAT_VERSION):
        raise InputError(
            f"shader format: expected {onnx_file.FORMAT_VERSION}, got {version!r}; export it again"
        )
    profile, output = texts.get("profile", ""), texts.get("output", "")
    stress = StressSet(onnx_file.form_inside(graph), profile, output, fixed=is_fixed(graph))
    others = load_others(data, node_modules=node_modules, pythons=pythons)
    runtimes = [_in_onnxruntime(stress, data), *(stress.run(r) for r in others)]
    return _report(graph, stress, runtimes)


def _in_onnxruntime(stress: StressSet, data: bytes) -> RuntimeResult:
    """Every file must run here; what ONNX Runtime raises is the input's fault."""
    runtime = load_onnxruntime(data)
    try:
        return stress.run(runtime)
    except Exception as error:  # its errors share no base class but this one
        raise InputError(
            f"onnxruntime {runtime.version} cannot run it: {one_line(error)}"
        ) from None


def _check_exportable(model: RadenBrdf) -> None:
    """Raise InputError unless it is in single or double precision, on the CPU, and finite."""
    for name, tensor in model.state_dict().items():
        if tensor.device.type != "cpu":
            raise InputError(
                f"{name}: expected device cpu, got {tensor.device}; move the model first: "
                "model.cpu()"
            )
        if tensor.is_floating_point() and tensor.dtype not in (torch.float32, torch.float64):
            raise InputError(f"{name}: expected float32, got {tensor.dtype}: call model.float()")
        if not torch.isfinite(tensor).all():
            raise InputError(f"{name}: expected finite values, got some that are not")
