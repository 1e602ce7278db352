"""A shell, exported, and Mitsuba's variants with the plugin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.capture.photo.simulation.variants import LLVM, SCALAR, why_no_llvm
from raden_torch.export.mitsuba.plugin import register
from raden_torch.export.mitsuba.plugin_file import export_plugin
from tests.export.mitsuba.shells import simulated_shell


@pytest.fixture(scope="package")
def shell() -> RuntimeBrdf:
    """A shell that opposite tilts, and light and viewer in each other's places, tell apart."""
    even = simulated_shell("yakogai")
    _, v, w = (torch.linspace(-1, 1, n) for n in even.layout.shape)
    return RuntimeBrdf(even.values * (1 + 0.3 * w + 0.1 * v[:, None])[..., None], even.layout)


@pytest.fixture(scope="package")
def exported(shell: RuntimeBrdf, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mitsuba") / "shell.xml"
    export_plugin(shell, path)
    return path


@pytest.fixture
def scalar() -> Any:
    """Mitsuba in its scalar RGB variant, with the plugin."""
    return _variant(SCALAR)


@pytest.fixture
def llvm() -> Any:
    """Mitsuba on Dr.Jit's arrays, with the plugin."""
    pytest.importorskip("mitsuba", reason="needs the extra simulate")
    if (reason := why_no_llvm()) is not None:
        pytest.skip(reason)
    return _variant(LLVM)


def _variant(name: str) -> Any:
    mi = pytest.importorskip("mitsuba", reason="needs the extra simulate")
    mi.set_variant(name)
    return register()
