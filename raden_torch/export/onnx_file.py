"""The finished file: a graph that explains itself, with a default for all that may be left out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

import raden_torch
from raden_torch.brdf.files.model_file import COLOUR, QUANTITY
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.runtime import models_of
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.export.forms import (
    FitForm,
    Form,
    PaletteForm,
    RuntimeForm,
    description,
    form_from,
)
from raden_torch.export.profiles import GraphInput, output_doc, ports
from raden_torch.export.runtimes import one_line
from raden_torch.export.trace import PUBLIC
from raden_torch.packages import require

if TYPE_CHECKING:
    import onnx

FORMAT = "raden_torch shader"
FORMAT_VERSION = 2
OPSET, IR_VERSION = 18, 8
"""The oldest pair that the exporter writes: ONNX Runtime 1.16 and everything newer reads it."""

_VECTORS = (
    "maps are [batch, 3, height, width], x, y, z in dimension 1, all in one right-handed frame; "
    "directions point away from the surface and may have a length of 1e-18 to 1e18"
)
_ANGLES = (
    "with p = LxV/|LxV| and N' = N - (N.p)p: incidence a = angle(N', L) >= 0; receiving r = signed "
    "angle from N' to V, positive away from L, so that a mirror has r = a; tilt t = asin(N.p); "
    "where a would be negative, p is flipped: (a, r, t) -> (-a, -r, -t); L parallel to V: "
    "t = 0, a = theta, r = -theta"
)
_INVALID = (
    "0 where a vector is zero or not finite, and where the light or the viewer is below the horizon"
)


def finished(
    graph: onnx.ModelProto, model: Reflection, form: Form, profile: str, output: str
) -> onnx.ModelProto:
    """The traced graph with names, texts and defaults, and nothing of the machine that made it."""
    import onnx

    inputs = ports(form, profile, output)
    _strip(graph)
    _rename(graph.graph)
    graph.ir_version = max(IR_VERSION, onnx.helper.find_min_ir_version_for(graph.opset_import))
    graph.producer_name, graph.producer_version = "raden_torch", raden_torch.__version__
    graph.domain, graph.model_version = "raden_torch", FORMAT_VERSION
    graph.doc_string = f"{_about_in_words(model)}: {output_doc(output)}"
    graph.graph.name = f"raden_{profile}"
    graph.graph.doc_string = graph.doc_string
    del graph.graph.input[:], graph.graph.output[:]
    for port in inputs:
        graph.graph.input.append(_value_info(port.name, port.shape, port.doc))
        if port.default is not None:
            values = port.default.numpy()
            graph.graph.initializer.append(onnx.numpy_helper.from_array(values, port.name))
    shape = ("batch", 3, "height", "width")
    graph.graph.output.append(_value_info(output, shape, output_doc(output)))
    onnx.helper.set_model_props(graph, _metadata(model, form, inputs, profile, output))
    return graph


def read_graph(data: bytes) -> onnx.ModelProto:
    """The graph in the bytes of a file.

    Raises:
        InputError: onnx is missing, or its checker refuses the file.
    """
    require("ONNX files", "export")
    import onnx

    try:
        graph = onnx.load_from_string(data)
        onnx.checker.check_model(data, full_check=True)
    except Exception as error:  # protobuf's and onnx's errors share no base class but this one
        raise InputError(f"not a valid ONNX file: {one_line(error)}") from None
    return graph


def metadata(graph: onnx.ModelProto) -> dict[str, str]:
    """The texts of a file, by key."""
    return {entry.key: entry.value for entry in graph.metadata_props}


def form_inside(graph: onnx.ModelProto) -> Form:
    """The form inside a file, from its defaults and its texts alone.

    Raises:
        InputError: a tensor is missing, or is not the one that was exported.
    """
    import onnx

    texts = metadata(graph)
    try:
        about, names = json.loads(texts["model"]), json.loads(texts["parameters"])
        defaults = {i.name: i for i in graph.graph.initializer}
        tensors = {
            parameter: torch.from_numpy(onnx.numpy_helper.to_array(defaults[name]).copy())
            for name, parameter in names.items()
        }
        if _digest(tensors) != texts["parameters_sha256"]:
            raise InputError("its tensors are not the ones that were exported (sha256 differs)")
        return form_from(texts["form"], about, tensors)
    except InputError:
        raise
    except (
        *(KeyError, TypeError, ValueError, AttributeError),
        *(OverflowError, RecursionError),
    ) as error:
        raise InputError(f"the model inside is damaged: {_first_line(error)}") from None


def _metadata(
    model: Reflection, form: Form, inputs: list[GraphInput], profile: str, output: str
) -> dict[str, str]:
    """All texts but the report of the check, which comes last."""
    models = models_of(model)
    sources = [own.provenance for own in models]
    names = {p.name: p.parameter for p in inputs if p.parameter is not None}
    tensors = {p.parameter: p.default for p in inputs if p.parameter and p.default is not None}
    return {
        "format": FORMAT,
        "format_version": str(FORMAT_VERSION),
        "library": f"raden_torch {raden_torch.__version__}",
        "form": _FORMS[type(form)],
        "profile": profile,
        "output": output,
        "quantity": QUANTITY if output == "brdf" else "radiance, sum of f_r E cos(theta_i)",
        "units": "1/sr" if output == "brdf" else "irradiance / sr; white diffuser under pi = 1",
        "colour_space": COLOUR,
        "vector_convention": _VECTORS,
        "angle_convention": _ANGLES,
        "table_address": _address(form),
        "valid_range": _each(_valid_range(own) for own in models) or "all angles (a formula)",
        "outside_valid_range": f"{_each(_beyond(own) for own in models) or 'none'}; {_INVALID}",
        "optional_inputs": ", ".join(p.name for p in inputs if p.default is not None),
        "sample": _each(about.sample for about in sources),
        "instrument": _each(about.instrument for about in sources),
        "simulated": "true" if any(about.simulated for about in sources) else "false",
        "measurement_sha256": _each(about.measurement_sha256 for about in sources),
        **({"materials": json.dumps(model.names)} if isinstance(model, Palette) else {}),
        "parameters": json.dumps(names),
        "parameters_sha256": _digest(tensors),
        "model": json.dumps(description(model, form), default=float),
    }


_FORMS = {FitForm: "fit", RuntimeForm: "runtime", PaletteForm: "palette"}


def _each(texts: Iterable[str]) -> str:
    """One text for several models; what they share, once."""
    return "; ".join(dict.fromkeys(texts))


def _address(form: Form) -> str:
    """Where a geometry lies in the table."""
    if isinstance(form, PaletteForm):
        own = (f"table_{place}: {_address(member)}" for place, member in enumerate(form.each))
        return "; ".join(own)
    if not isinstance(form, RuntimeForm):
        return "incidence, receiving and tilt, as the model text says"
    c, k = form.warp
    return (
        "with d = V - L, m = N.L + N.V: u = |d| / (2 + sqrt(4 - d.d)), from 0 to 1; "
        f"v = N.d / (|N.d| + {c:g} |d| min(N.L, N.V)), from -1 to 1; with z = N.(Lxd): "
        f"w = z / (|z| + {k / 2:g} |d| m), from -1 to 1; L parallel to V: u = w = 0, "
        f"v = s / (s + {c:g} N.L) with s = |NxL|; nodes are evenly spaced, trilinear between"
    )


def _about_in_words(model: Reflection) -> str:
    if isinstance(model, Palette):
        return f"Reflection of a palette of {len(model)}: {', '.join(model.names)}"
    if not isinstance(model, RadenBrdf):
        return f"Reflection of a {type(model).__name__}, a simulated material"
    kind = "simulated specimen" if model.provenance.simulated else "measured specimen"
    return f"Reflection of {model.provenance.sample or 'an unnamed sample'} ({kind})"


def _beyond(model: RadenBrdf) -> str:
    """What stands beyond the measured angles."""
    if model.provenance.fit.get("outside") == "continued":
        return "what was measured is continued to the horizon"
    return "the specular part fades to 0 over one step of the table"


def _valid_range(model: RadenBrdf) -> str:
    if not model.measured_box_deg:
        return "all angles (diffuse formula, no table)"
    axes = zip(("incidence", "receiving", "tilt"), model.measured_box_deg, strict=True)
    box = ", ".join(f"{name} {first:g} to {last:g} deg" for name, (first, last) in axes)
    derived = model.provenance.fit.get("assumption")
    return f"{box}; partly derived, the sample assumed isotropic" if derived else box


def _value_info(name: str, shape: tuple[int | str, ...], doc: str) -> onnx.ValueInfoProto:
    import onnx

    return onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape, doc)


def _strip(graph: onnx.ModelProto) -> None:
    """Take out what tracing left: source paths, stack traces, the example's sizes."""
    del graph.graph.value_info[:], graph.graph.metadata_props[:], graph.metadata_props[:]
    for number, node in enumerate(graph.graph.node):
        del node.metadata_props[:]
        node.doc_string = ""
        node.name = f"{node.op_type}_{number}"
    for tensor in graph.graph.initializer:
        del tensor.metadata_props[:]
        tensor.doc_string = ""


def _rename(graph: onnx.GraphProto) -> None:
    """Plain names inside; inputs and outputs get theirs without the mark that tracing put there."""
    names = {name: name.removeprefix(PUBLIC) for name in _value_names(graph) if PUBLIC in name}
    inside = (name for name in _value_names(graph) if name and name not in names)
    names |= {name: f"v{number}" for number, name in enumerate(dict.fromkeys(inside))}
    for node in graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]
        node.output[:] = [names.get(name, name) for name in node.output]
    for tensor in graph.initializer:
        tensor.name = names[tensor.name]


def _value_names(graph: onnx.GraphProto) -> Iterator[str]:
    yield from (tensor.name for tensor in graph.initializer)
    for node in graph.node:
        yield from node.input
        yield from node.output


def _digest(tensors: Mapping[str, Tensor]) -> str:
    """A hash of names, shapes and values, in the order of the names."""
    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {list(tensor.shape)} ".encode())
        digest.update(np.ascontiguousarray(tensor.numpy()).tobytes())
    return digest.hexdigest()


def _first_line(error: Exception) -> Any:
    return (str(error).splitlines() or [""])[0] or type(error).__name__
