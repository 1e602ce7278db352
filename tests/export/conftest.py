"""Exports that several tests look at: tracing one takes seconds, so each is made once."""

from __future__ import annotations

import copy
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from pathlib import Path

import onnx
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.export import export as export_module
from raden_torch.export.check import ExportReport, StressSet
from raden_torch.export.forms import Form, PaletteForm


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


def everything_in(form: Form) -> Hashable:
    """All that a form's pictures depend on."""
    tensors = form.state_dict().items()
    table = getattr(form, "table", None)
    if isinstance(form, PaletteForm):
        layout = (form.by, [member.layout for member in form.each])
    else:
        layout = getattr(form, "warp", None) or (
            table and (table.first_deg, table.step_deg, table.pieces)
        )
    return (
        type(form),
        tuple((name, *v.shape, v.double().numpy().tobytes()) for name, v in tensors),
        repr(layout),
    )


@pytest.fixture(scope="package", autouse=True)
def _each_model_once() -> Iterator[None]:
    """A model is traced, and its pictures for the check are computed in torch, once a profile."""
    traced: dict[Hashable, onnx.ModelProto] = {}
    made: dict[Hashable, StressSet] = {}

    def graph(model: rt.RadenBrdf, form: Form, *options: str | int) -> onnx.ModelProto:
        key = (everything_in(form), repr(getattr(model, "provenance", model)), *options)
        if key not in traced:
            traced[key] = trace(model, form, *options)
        return copy.deepcopy(traced[key])

    def stress_set(form: Form, *options: str, fixed: bool = False) -> StressSet:
        key = (everything_in(form), *options, fixed)
        if key not in made:
            made[key] = StressSet(form, *options, fixed=fixed)
        return made[key]

    trace = export_module._graph
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(export_module, "_graph", graph)
        patched.setattr(export_module, "StressSet", stress_set)
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
