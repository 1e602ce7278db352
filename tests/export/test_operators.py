"""The operators of exported files, and those that engines lack, are as the pages say."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest

import raden_torch as rt

HERE = Path(__file__).resolve()
NAMED = json.loads(HERE.with_name("operators.json").read_text("utf-8"))
ENGINES = json.loads(HERE.with_name("engines.json").read_text("utf-8"))
PAGE = HERE.parents[2] / "docs/export.md"
APPS = HERE.parents[2] / "docs/apps.md"
WEB = HERE.parents[2] / "runtimes/node_modules/onnxruntime-web/docs/webgpu-operators.md"


@pytest.mark.parametrize("profile", ["gbuffer", "scene"])
def test_a_file_has_the_operators_that_are_named(
    exported: Callable, shell: rt.RadenBrdf, profile: str
) -> None:
    graph = onnx.load(exported(shell, profile=profile).path)
    assert sorted({node.op_type for node in graph.graph.node}) == NAMED[profile]
    assert [(o.domain, o.version) for o in graph.opset_import] == [("", NAMED["opset"])]
    assert graph.ir_version == NAMED["ir_version"]
    section = PAGE.read_text("utf-8").split("## Operators", 1)[1].split("\n## ", 1)[0]
    assert set(NAMED[profile]) <= set(re.findall(r"[A-Z][A-Za-z]+", section))


def test_engines_were_asked_for_every_operator() -> None:
    assert ENGINES["checked"] == sorted({*NAMED["gbuffer"], *NAMED["scene"]})


@pytest.mark.parametrize("engine", ENGINES["engines"])
def test_the_page_names_what_an_engine_lacks(engine: str) -> None:
    lacking = ENGINES["engines"][engine]["without"]
    assert set(lacking) <= set(ENGINES["checked"])
    row = next(
        line for line in APPS.read_text("utf-8").split("\n") if line.startswith(f"| {engine} |")
    )
    cell = row.split("|")[3]
    assert re.findall(r"[A-Z][A-Za-z]+", cell.replace("TensorRT", "")) == lacking


def test_webgpu_lacks_what_is_written() -> None:
    if not WEB.exists():
        pytest.skip("onnxruntime-web is not installed (`make runtimes`)")
    listed = set(re.findall(r"^\| (\w+) \|", WEB.read_text("utf-8"), flags=re.MULTILINE))
    lacking = ENGINES["engines"]["onnxruntime-web, WebGPU"]["without"]
    assert sorted(set(ENGINES["checked"]) - listed) == lacking
