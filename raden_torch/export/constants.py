"""A file whose parameters are constants: a runtime then packs the table once, not at every call."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

from raden_torch.arrays import Floats32
from raden_torch.errors import InputError

if TYPE_CHECKING:
    import onnx


def fix_parameters(
    graph: onnx.ModelProto, values: Mapping[str, Floats32] | None = None
) -> onnx.ModelProto:
    """Take the form's parameters off the inputs, in place; their values stay, or become these.

    Does nothing to a file that has none. The mask, the exposure and the light stay inputs.

    Args:
        values: other parameters by the names of their inputs, as another shell's `table`.

    Raises:
        InputError: no such parameter, or a value of another shape.
    """
    texts = {entry.key: entry for entry in graph.metadata_props}
    parameters = json.loads(texts["parameters"].value) if "parameters" in texts else {}
    for name, value in (values or {}).items():
        _replace(graph, name, value, list(parameters))
    if not parameters or "optional_inputs" not in texts:
        return graph
    left = [port for port in graph.graph.input if port.name not in parameters]
    del graph.graph.input[:]
    graph.graph.input.extend(left)
    optional = texts["optional_inputs"].value.split(", ")
    texts["optional_inputs"].value = ", ".join(n for n in optional if n not in parameters)
    return graph


def _replace(graph: onnx.ModelProto, name: str, value: Floats32, known: list[str]) -> None:
    import onnx

    if name not in known:
        raise InputError(f"parameters: expected {' or '.join(known) or 'none'}, got {name!r}")
    tensor = next(t for t in graph.graph.initializer if t.name == name)
    if list(value.shape) != list(tensor.dims):
        raise InputError(f"{name}: expected shape {list(tensor.dims)}, got {list(value.shape)}")
    tensor.CopyFrom(onnx.numpy_helper.from_array(value, name))


def is_fixed(graph: onnx.ModelProto) -> bool:
    """Whether the form's parameters are constants."""
    texts = {entry.key: entry.value for entry in graph.metadata_props}
    inputs = {port.name for port in graph.graph.input}
    return not inputs & set(json.loads(texts["parameters"]))
