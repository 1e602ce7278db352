"""From a shader module to an ONNX graph, by torch's own exporter."""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import torch

from raden_torch.errors import InputError
from raden_torch.export.profiles import GraphInput
from raden_torch.export.shaders import Shader

if TYPE_CHECKING:
    import onnx

OLDEST_TORCH = (2, 11)
"""Whose exporter takes gathers of int32: 2.10 refuses them, 2.5 and earlier every dynamic size."""
PUBLIC = "public:"
"""Before the names of inputs and outputs: the exporter calls values inside `view`, too."""


def trace(shader: Shader, ports: list[GraphInput], output: str, opset: int) -> onnx.ModelProto:
    """The shader as a graph with one input a port; what the exporter adds is still in it.

    Raises:
        InputError: PyTorch is older than what the extra `export` asks for.
    """
    from onnxscript import opset18

    if _version(torch.__version__) < OLDEST_TORCH:
        oldest = ".".join(map(str, OLDEST_TORCH))
        raise InputError(
            f"exported shaders: expected PyTorch {oldest} or later, got {torch.__version__}; "
            "pip install 'raden_torch[export]' brings it"
        )

    def gather_rows(rows: Any, indices: Any) -> Any:
        """`rows[indices]` with the int32 indices as they are; the exporter's own takes int64."""
        return opset18.Gather(rows, indices[0], axis=0)

    def gather_along(values: Any, axis: int, indices: Any) -> Any:
        """`values.index_select(axis, indices)`, likewise."""
        return opset18.Gather(values, indices, axis=axis)

    with _silent_exporter(), torch.no_grad():
        program = torch.onnx.export(
            shader.eval(),
            tuple(port.example for port in ports),
            input_names=[PUBLIC + port.name for port in ports],
            output_names=[PUBLIC + output],
            opset_version=opset,
            dynamic_shapes={"tensors": tuple(_dynamic(port) for port in ports)},
            custom_translation_table={
                torch.ops.aten.index.Tensor: gather_rows,
                torch.ops.aten.index_select.default: gather_along,
            },
            dynamo=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None  # it is None for the exporter before dynamo only
    graph = program.model_proto
    _join(graph.graph, {"Add": "Sum", "Max": "Max"})
    return graph


def _version(text: str) -> tuple[int, int]:
    """Major and minor of a version such as 2.13.0+cpu."""
    major, minor, *_ = text.split(".")
    return int(major), int(minor)


def _join(graph: onnx.GraphProto, names: dict[str, str]) -> None:
    """(a + b) + c as one operator, and the like: torch has none of three operands.

    The maps must be of one size: OpenCV corrupts memory in a `Sum` of others.
    """
    uses = Counter(name for node in graph.node for name in node.input)
    made = {node.output[0]: node for node in graph.node}
    for node in list(graph.node):
        joined, first = names.get(node.op_type), made.get(node.input[0])
        if joined is None or first is None or uses[node.input[0]] > 1:
            continue
        if first.op_type == node.op_type:
            node.input[:] = [*first.input, *node.input[1:]]
            node.op_type = joined
            graph.node.remove(first)


def _dynamic(port: GraphInput) -> dict[int, Any]:
    """The sizes that stay free while tracing; those that are 1 in the example broadcast anyway."""
    free = ("batch", "height", "width", "lights")
    return {i: torch.export.Dim.DYNAMIC for i, n in enumerate(port.shape) if n in free}


@contextmanager
def _silent_exporter() -> Iterator[None]:
    """Keep back what the exporter says about itself, and nothing else.

    It logs that torchvision, which we do not use, is not installed; and torch warns about its own
    use of a pytree class.
    """
    logger = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*LeafSpec.*", category=FutureWarning)
            yield
    finally:
        logger.setLevel(level)
