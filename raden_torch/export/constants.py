"""A file whose parameters are constants: a runtime then packs the table once, not at every call."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import onnx


def fix_parameters(graph: onnx.ModelProto) -> onnx.ModelProto:
    """Take the model's parameters off the inputs, in place; their values stay.

    Does nothing to a file that has none. The mask, the exposure and the light stay inputs.
    """
    texts = {entry.key: entry for entry in graph.metadata_props}
    if not {"parameters", "optional_inputs"} <= set(texts):
        return graph
    parameters = set(json.loads(texts["parameters"].value))
    left = [port for port in graph.graph.input if port.name not in parameters]
    del graph.graph.input[:]
    graph.graph.input.extend(left)
    optional = texts["optional_inputs"].value.split(", ")
    texts["optional_inputs"].value = ", ".join(n for n in optional if n not in parameters)
    return graph


def is_fixed(graph: onnx.ModelProto) -> bool:
    """Whether the model's parameters are constants."""
    texts = {entry.key: entry.value for entry in graph.metadata_props}
    inputs = {port.name for port in graph.graph.input}
    return not inputs & set(json.loads(texts["parameters"]))
