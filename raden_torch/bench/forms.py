"""Every form of a model that is timed, in every way of this machine to evaluate it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import cast

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.bench.naive_form import naive
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.layout_choice import NODES, choose_layout
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.export.forms import FitForm, form_of

PAPER, FIT, RUNTIME = "paper", "fit form", "runtime form"
FORMS = (PAPER, FIT, RUNTIME)
"""The paper's table, read trilinearly, with its formula outside; the default fit by eq. (2); the
default fit as users get it."""

NODE_COUNTS = (20_000, 40_000, 75_000, NODES, 300_000, 600_000)
"""Of runtime tables: the most that a layout may have."""

NAIVE, EAGER, COMPILED = "naive", "eager", "compiled"

PRECISIONS = {
    "float32": torch.float32,
    "float64": torch.float64,
    "float16": torch.float16,
    "bfloat16": torch.bfloat16,
}
"""Of the maps; half precision is computed in float32."""

Shader = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Normal, light and view, unit vectors `[1, 3, H, W]`, to f_r in 1/sr."""


@dataclass(frozen=True)
class Form:
    """One form in one backend.

    Attributes:
        form: one of `FORMS`.
        nodes: of the table that is read.
        default: whether this is what users get: the default fit's own runtime table.
        backend: an instruction set of the kernel, "eager", "compiled" or "naive".
        precision: of the maps, a key of `PRECISIONS`.
        shader: what is timed; without gradients.
    """

    form: str
    nodes: int
    default: bool
    backend: str
    precision: str
    shader: Shader


def forms(paper: RadenBrdf, default: RadenBrdf, compiled: bool = False) -> Iterator[Form]:
    """Everything that is timed; the naive form comes first.

    Args:
        paper: a trilinear fit that ends at its box.
        default: what `fit` gives by default.
        compiled: also the default under torch.compile, which needs a compiler and its time.
    """
    nodes = _table_nodes(paper)
    yield Form(PAPER, nodes, False, NAIVE, "float32", torch.no_grad()(partial(naive, paper)))
    for form, model in ((PAPER, paper), (FIT, default)):
        yield Form(form, _table_nodes(model), False, EAGER, "float32", by_fit_form(model))
    for model in runtime_models(default):
        nodes, is_default = model.layout.nodes, model is default
        for level in reversed(simd.LEVELS):
            yield Form(
                RUNTIME, nodes, is_default, level, "float32", without_gradients(model, level)
            )
        for precision in PRECISIONS if is_default else ("float32",):
            shader = without_gradients(model, simd.OFF)
            yield Form(RUNTIME, nodes, is_default, EAGER, precision, shader)
    nodes = default.layout.nodes
    if compiled:
        shader = without_gradients(torch.compile(default), simd.OFF)
        yield Form(RUNTIME, nodes, True, COMPILED, "float32", shader)
    if simd.LEVELS:
        level = simd.LEVELS[-1]
        yield Form(RUNTIME, nodes, True, level, "float16", without_gradients(default, level))


def runtime_models(default: RadenBrdf) -> Iterator[RadenBrdf]:
    """The default fit with a runtime table of each size, its own among them."""
    for nodes in NODE_COUNTS:
        yield default if nodes == NODES else with_nodes(default, nodes)


def with_nodes(model: RadenBrdf, nodes: int) -> RadenBrdf:
    """A model of the same parts, with a runtime table of at most so many nodes."""
    return RadenBrdf(
        model.diffuse,
        model.table,
        diffuse_gain=model.diffuse_gain,
        specular_gain=model.specular_gain,
        layout=choose_layout(model, nodes),
        provenance=model.provenance,
    )


def by_fit_form(model: RadenBrdf) -> Shader:
    """The model by eq. (2) itself, 0 below the horizon."""
    form = cast(FitForm, form_of(model, "fit"))

    @torch.no_grad()
    def shader(normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
        return form.of_unit_vectors(*(geometry.normalised(m) for m in (normal, light, view)))

    return shader


def without_gradients(model: Shader, level: str | None = None) -> Shader:
    """The model without gradients, by the kernel's instruction set; by what it takes where None."""

    def shader(normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
        with torch.no_grad(), simd.using(level or simd.level()):
            return model(normal, light, view)

    return shader


def _table_nodes(model: RadenBrdf) -> int:
    return 0 if model.table is None else model.table.values.shape[:3].numel()
