"""An ONNX file in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from raden_torch.errors import InputError

if TYPE_CHECKING:
    import onnx

_NEXT_FIELDS = b"\x12\x1a\x22\x28\x32\x3a\x42"
"""How the fields 2 to 8 of a ModelProto begin (onnx.proto)."""
_MAX_BYTES = 2_000_000_000


def recognises(head: bytes) -> bool:
    """A ModelProto begins with its IR version, a small number, and another field."""
    return len(head) > 2 and head[0] == 0x08 and 0 < head[1] < 64 and head[2] in _NEXT_FIELDS


def describe(path: Path) -> str:
    """Profile, specimen, inputs, outputs, operators; or those of another program's file."""
    from raden_torch.export.onnx_file import FORMAT, metadata, read_graph

    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise InputError(f"{path}: expected an ONNX file of at most 2 GB, got {size / 1e9:.1f} GB")
    graph = read_graph(path.read_bytes())
    texts = metadata(graph)
    ours = texts.get("format") == FORMAT
    lines = _of_ours(texts) if ours else ["ONNX file of another program than `raden export`"]
    defaults = {tensor.name for tensor in graph.graph.initializer}
    for port in graph.graph.input:
        optional = ", optional" if port.name in defaults else ""
        lines.append(f"input {port.name}: {_shape(port)}{optional}")
    lines += [f"output {port.name}: {_shape(port)}" for port in graph.graph.output]
    opset = next((o.version for o in graph.opset_import if o.domain in ("", "ai.onnx")), 0)
    lines.append(
        f"opset {opset}, IR {graph.ir_version}, {len(graph.graph.node)} nodes, {size} bytes"
    )
    return "\n".join(lines)


def _of_ours(texts: dict[str, str]) -> list[str]:
    kind = "simulated specimen" if texts.get("simulated") == "true" else "measured specimen"
    names = json.loads(texts.get("materials", "[]"))
    members = [f"{place}: {name}" for place, name in enumerate(names)]
    return [
        f"shader of {texts.get('sample') or 'an unnamed sample'} ({kind}), "
        f"written by `raden export`, {texts.get('library', '')}",
        f"{texts.get('form', 'fit')} form, profile {texts.get('profile')}, "
        f"output {texts.get('output')}: {texts.get('quantity')}; units: {texts.get('units')}",
        *([f"materials: {', '.join(members)}"] if members else []),
        f"instrument: {texts.get('instrument') or 'not named'}",
        f"measured angles: {texts.get('valid_range')}",
        f"measurement sha256: {texts.get('measurement_sha256') or 'not known'}",
    ]


def _shape(port: onnx.ValueInfoProto) -> str:
    import onnx

    tensor = port.type.tensor_type
    sizes = (
        d.dim_param or (d.dim_value if d.HasField("dim_value") else "?") for d in tensor.shape.dim
    )
    name = onnx.TensorProto.DataType.Name(tensor.elem_type).lower()
    return f"{name} [{', '.join(map(str, sizes))}]"
