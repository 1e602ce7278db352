"""Exports that several tests look at: tracing one takes seconds, so each is made once."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.export.check import ExportReport, StressSet


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


def everything_in(model: rt.RadenBrdf) -> Hashable:
    """All that a model's pictures depend on."""
    tensors = model.state_dict().items()
    table = model.table and (model.table.first_deg, model.table.step_deg, model.table.pieces)
    return (
        tuple((name, str(v.dtype), *v.shape, v.double().numpy().tobytes()) for name, v in tensors),
        repr((model.diffuse_gain, model.specular_gain, table)),
    )


@pytest.fixture(scope="package", autouse=True)
def _each_stress_set_once() -> Iterator[None]:
    """Torch's own pictures of one model are computed once, however many files are checked."""
    made: dict[Hashable, StressSet] = {}

    def once(model: rt.RadenBrdf, *options: str, fixed: bool = False) -> StressSet:
        key = (everything_in(model), *options, fixed)
        if key not in made:
            made[key] = StressSet(model, *options, fixed=fixed)
        return made[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("raden_torch.export.export.StressSet", once)
        yield


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
