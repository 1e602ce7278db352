"""The examples in the public names' docstrings run, and say what comes out."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

import raden_torch as rt

SLOW = {"export_onnx"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in rt.__all__]
)
def test_the_example_of_a_public_name_is_true(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files that it writes are in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    found = doctest.DocTestFinder(recurse=False).find(getattr(rt, name), name, globs={})
    examples = [test for test in found if test.examples]
    assert examples, f"{name}: expected an example in its docstring, got none"
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.FAIL_FAST)
    for test in examples:
        runner.run(test, out=said.append)
    assert not runner.failures, "".join(said)
