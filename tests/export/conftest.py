"""Exports that several tests look at: tracing one takes seconds, so each is made once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.export.check import ExportReport


@dataclass(frozen=True)
class Export:
    model: rt.RadenBrdf
    path: Path
    report: ExportReport


@pytest.fixture(scope="session")
def shell() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai"), interpolation="trilinear").model


@pytest.fixture(scope="session")
def matt() -> rt.RadenBrdf:
    """Diffuse only."""
    return rt.RadenBrdf(
        CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0])), None
    )


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Export]:
    """A model exported with some options, kept for the next one who asks."""
    folder, made = tmp_path_factory.mktemp("export"), {}

    def make(model: rt.RadenBrdf, **options: str) -> Export:
        key = (id(model), *sorted(options.items()))
        if key not in made:
            path = folder / f"{len(made)}.onnx"
            made[key] = Export(model, path, rt.export_onnx(model, path, **options))
        return made[key]

    return make
