"""What is in the file: operators, inputs, texts, and nothing of the machine that made it."""

from __future__ import annotations

import getpass
import json
import platform
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import raden_torch as rt
from raden_torch.export.forms import form_of
from raden_torch.export.onnx_file import form_inside, metadata

PROFILES = ("gbuffer", "scene")
# fmt: off
OPERATORS = {
    "Abs", "Add", "Cast", "Clip", "Concat", "Div", "Equal", "Floor", "Gather", "Greater", "Less",
    "LessOrEqual", "MatMul", "Max", "Min", "Mul", "ReduceSum", "Relu", "Reshape", "Slice",
    "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Transpose", "Unsqueeze", "Where",
}
# fmt: on
"""All of opset 18 and run by every runtime that we know; no loops, no GridSample, no GatherND, and
nothing that takes long: no Log, Exp, Atan or Pow."""
MOST_NODES = 130


@pytest.fixture(params=PROFILES)
def graph(request: pytest.FixtureRequest, exported: Callable, shell: rt.RadenBrdf):
    return onnx.load(exported(shell, profile=request.param).path)


def test_it_is_old_enough_for_old_runtimes(graph: onnx.ModelProto) -> None:
    assert graph.ir_version == 8
    assert [(o.domain, o.version) for o in graph.opset_import] == [("", 18)]
    assert not graph.functions
    onnx.checker.check_model(graph, full_check=True)


def test_operators_are_the_common_ones(graph: onnx.ModelProto) -> None:
    assert {node.op_type for node in graph.graph.node} <= OPERATORS
    assert {node.domain for node in graph.graph.node} == {""}


def test_it_is_short(exported: Callable, shell: rt.RadenBrdf) -> None:
    made = exported(shell, profile="gbuffer").report
    assert made.form == "runtime"
    assert made.nodes <= MOST_NODES


def test_all_is_gathered_with_int32(graph: onnx.ModelProto) -> None:
    """int64 indices give silently wrong pictures in some browsers."""
    inferred = onnx.shape_inference.infer_shapes(graph, strict_mode=True).graph
    types = {v.name: v.type.tensor_type.elem_type for v in inferred.value_info}
    types |= {constant.name: constant.data_type for constant in inferred.initializer}
    gathers = [node for node in graph.graph.node if node.op_type == "Gather"]
    assert len(gathers) == 4  # one of the table, three of components
    assert {types[node.input[1]] for node in gathers} == {onnx.TensorProto.INT32}


def test_all_is_in_one_file_with_a_default_for_what_is_optional(graph: onnx.ModelProto) -> None:
    tensors = {t.name: t for t in graph.graph.initializer}
    assert all(t.data_location == onnx.TensorProto.DEFAULT for t in tensors.values())
    names = [i.name for i in graph.graph.input]
    optional = metadata(graph)["optional_inputs"].split(", ")
    assert set(optional) <= set(tensors)
    assert set(names) - set(optional) == set(names) - set(tensors)
    assert names[-len(optional) :] == optional
    assert {"mask", "exposure", "table"} <= set(optional)
    assert not {"diffuse_scale", "diffuse_exponent", "diffuse_gain", "specular_gain"} & set(names)
    assert all(value.doc_string for value in (*graph.graph.input, *graph.graph.output))


def test_texts_explain_it(graph: onnx.ModelProto, shell: rt.RadenBrdf) -> None:
    texts = metadata(graph)
    assert texts["format"] == "raden_torch shader"
    assert texts["library"] == f"raden_torch {rt.__version__}"
    assert "radiance" in texts["quantity"]
    assert "sRGB" in texts["colour_space"]
    assert "mirror has r = a" in texts["angle_convention"]
    assert texts["valid_range"] == (
        "incidence 0 to 70 deg, receiving -70 to 70 deg, tilt -70 to 70 deg"
    )
    assert texts["simulated"] == "true"
    assert texts["measurement_sha256"] == shell.provenance.measurement_sha256
    assert "simulated" in graph.doc_string


def test_the_report_is_inside(exported: Callable, shell: rt.RadenBrdf) -> None:
    made = exported(shell, profile="gbuffer")
    stored = json.loads(metadata(onnx.load(made.path))["report"])
    assert stored == json.loads(json.dumps(made.report.as_dict() | {"bytes": 0}))
    assert stored["runtimes"][0]["status"] == "same picture"
    assert made.report.bytes == made.path.stat().st_size
    assert made.report.bytes < 60_000 + 12 * shell.layout.nodes


def test_nothing_of_the_machine_is_inside(graph: onnx.ModelProto) -> None:
    for tensor in graph.graph.initializer:
        tensor.ClearField("raw_data")  # numbers may spell anything
    data = graph.SerializeToString()
    machine = [str(Path.home()), str(Path.cwd()), "site-packages", ".py", "/tmp"]
    machine += [name for name in (getpass.getuser(), platform.node()) if len(name) > 4]
    for text in machine:
        assert text.encode() not in data, text
    assert not any(node.metadata_props or node.doc_string for node in graph.graph.node)
    assert not graph.graph.value_info


@pytest.mark.parametrize("form", ["runtime", "fit"])
def test_the_form_comes_back(exported: Callable, shell: rt.RadenBrdf, form: str) -> None:
    again = form_inside(onnx.load(exported(shell, output="brdf", form=form).path))
    wanted = form_of(shell, form)
    assert type(again) is type(wanted)
    assert again.state_dict().keys() == wanted.state_dict().keys()
    for name, tensor in wanted.state_dict().items():
        assert np.array_equal(again.state_dict()[name], tensor), name


def test_the_runtime_table_is_what_the_model_reads(
    exported: Callable, shell: rt.RadenBrdf, matt: rt.RadenBrdf
) -> None:
    """Also of a model without a table of its own, or without a diffuse part."""
    table_only = rt.RadenBrdf(None, shell.table, specular_gain=0.5)
    for model in (shell, matt, table_only):
        graph = onnx.load(exported(model, output="brdf").path)
        (table,) = (t for t in graph.graph.initializer if t.name == "table")
        with torch.no_grad():
            wanted = model.runtime_table().numpy()
        assert np.array_equal(onnx.numpy_helper.to_array(table), wanted)
        names = [port.name for port in graph.graph.input]
        assert names == ["normal", "light", "view", "mask", "table"]


def test_parts_that_are_not_there_cost_nothing_in_the_fit_form(
    exported: Callable, matt: rt.RadenBrdf
) -> None:
    made = exported(matt, output="brdf", form="fit")
    assert made.report.bytes < 40_000
    names = [port.name for port in onnx.load(made.path).graph.input]
    assert names[4:] == ["diffuse_gain", "diffuse_scale", "diffuse_exponent"]
