"""The public face: its names are a contract, and importing it is cheap."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import raden_torch

NAMES = {
    "BrdfMeasurement",
    "DirectionalLight",
    "FrameDataset",
    "GBuffer",
    "PointLight",
    "RadenBrdf",
    "SpotLight",
    "export_onnx",
    "fit",
    "load_measurement",
    "load_model",
    "raden_angles",
    "save_model",
    "shade",
    "simulate_specimen",
    "vectors_from_angles",
}


def test_the_names_are_these() -> None:
    """A name taken away breaks users; one added is kept for ever: at most 16. Change both on
    purpose, with a line in CHANGELOG.md."""
    assert sorted(raden_torch.__all__) == sorted(NAMES)
    assert len(NAMES) <= 16


def test_every_name_is_there_and_documented() -> None:
    for name in raden_torch.__all__:
        assert getattr(raden_torch, name).__doc__
    assert set(dir(raden_torch)) >= NAMES
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = raden_torch.nonsense


@pytest.mark.parametrize(
    ("statement", "absent"),
    [
        (
            "import raden_torch",
            {"torch", "numpy", "scipy", "kornia", "colour", "cv2", "matplotlib"},
        ),
        ("from raden_torch import load_measurement", {"torch", "kornia", "colour", "cv2"}),
        ("import raden_torch as rt; rt.simulate_specimen", {"torch", "kornia", "cv2"}),
        ("import raden_torch as rt; rt.shade, rt.fit", {"kornia", "colour", "cv2", "matplotlib"}),
        ("import raden_torch as rt; rt.export_onnx", {"onnx", "onnxscript", "onnxruntime", "cv2"}),
    ],
)
def test_heavy_packages_are_imported_where_they_are_used(statement: str, absent: set[str]) -> None:
    script = f"import sys; {statement}; print(*(set({sorted(absent)}) & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_every_module_says_in_its_first_line_what_it_is_for() -> None:
    package = Path(raden_torch.__file__).parent
    silent = [
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if not (ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "").strip()
    ]
    assert not silent


def test_the_files_that_the_map_names_are_there() -> None:
    package = Path(raden_torch.__file__).parent
    names = {path.name for path in package.rglob("*.py")} | {
        path.name for path in (package.parent / "kernel").iterdir()
    }
    text = (package.parent / "docs/architecture.md").read_text("utf-8")
    named = re.findall(r"`(?:[\w/]*/)?(\w+\.(?:py|cpp|h))`", text)
    assert len(named) > 40
    assert set(named) <= names, set(named) - names
