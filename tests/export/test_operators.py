"""The operators of exported files are those that `operators.json` and docs/export.md name."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest

import raden_torch as rt

NAMED = json.loads(Path(__file__).with_name("operators.json").read_text("utf-8"))
PAGE = Path(__file__).resolve().parents[2] / "docs/export.md"


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
