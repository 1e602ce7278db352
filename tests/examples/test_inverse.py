"""The two examples of inverse rendering find what was photographed, small and on the CPU."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import pytest

import raden_torch as rt

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("inverse") / "shell.safetensors"
    measured = rt.simulate_specimen("yakogai", step_deg=10)
    rt.save_model(rt.fit(measured, interpolation="trilinear").model, path)
    return path


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """An example as a module, beside which its own imports lie."""
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module


def test_normals_converge_to_the_truth(example, shell: Path, tmp_path: Path, capsys) -> None:
    picture = tmp_path / "normals.png"
    options = ["--shell", shell, "--size", 24, "--lamps", 12, "--steps", 80, "--out", picture]
    found = example("recover_normals").main([str(o) for o in options])
    assert found["start mean"] > 8
    assert found["found mean"] < 1.0
    assert found["found 95 %"] < 3.0
    assert "found: mean" in capsys.readouterr().out
    assert cv2.imread(str(picture)).std() > 30


def test_normals_under_lamps_that_are_a_degree_off(example, shell: Path) -> None:
    options = ["--shell", shell, "--size", 24, "--lamps", 12, "--steps", 80, "--lamps-off", 1]
    found = example("recover_normals").main([str(o) for o in options])
    assert found["found mean"] < 1.5


def test_a_shell_converges_to_the_truth(example, shell: Path, tmp_path: Path) -> None:
    picture = tmp_path / "shell.png"
    options = ["--shell", shell, "--size", 56, "--lamps", 24, "--steps", 40, "--out", picture]
    found = example("recover_shell").main([str(o) for o in options])
    assert found["start median"] > 0.3
    assert found["found median"] < 0.05
    assert found["found mean"] < 0.1
    assert found["found under other lamps"] < 0.05 < found["start under other lamps"]
    assert found["gains"] < 0.08  # from 0.67 and 0.29
    assert cv2.imread(str(picture)).std() > 10
