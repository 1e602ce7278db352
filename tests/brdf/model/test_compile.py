"""The model and `shade` under torch.compile and torch.export, and on devices but the CPU."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.model import simd
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable

FORMS = [simd.level(), simd.OFF] if simd.LEVELS else [simd.OFF]
WARM, SIZES = ((6, 5), (7, 9)), ((16, 18), (20, 8), (11, 40))
LIGHTS = [
    rt.DirectionalLight((0.3, 0.2, 1.0)),
    rt.PointLight((0.0, 0.0, 3.0)),
    rt.SpotLight((0.0, 1.0, 3.0), (0.0, 0.0, 0.0)),
]

pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning:torch"
)


@pytest.fixture(params=FORMS)
def form(request: pytest.FixtureRequest) -> Iterator[str]:
    """With the fused operator in the graph, or the eager form's own operations."""
    torch.compiler.reset()
    with simd.using(request.param), torch.no_grad():
        yield request.param


def model_of(kind: str) -> rt.RadenBrdf:
    """As `fit` makes them: the paper's plain table, or a baked one."""
    generator = torch.Generator().manual_seed(0)
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
    if kind == "plain":
        values = torch.rand(8, 15, 15, 3, generator=generator)
        return rt.RadenBrdf(
            diffuse, ReflectanceTable(values, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0))
        )
    values = torch.rand(7, 10, 13, 3, generator=generator)
    pieces = ((2, 1, 3), (1,) * 9, (2,) * 6)
    return rt.RadenBrdf(
        diffuse, ReflectanceTable(values, (0.0, -30.0, -30.0), (10.0, 10.0, 10.0), pieces)
    )


def maps(height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    v = torch.randn(3, 1, 3, height, width, generator=torch.Generator().manual_seed(height))
    v[:, :, 2] += 2
    n, l, view = torch.nn.functional.normalize(v, dim=2)  # noqa: E741
    return n, l, view


class Frame(torch.nn.Module):
    """`shade` with everything in the G-buffer, and all kinds of lights."""

    def __init__(self, model: rt.RadenBrdf) -> None:
        super().__init__()
        self.model = model

    def forward(self, normal: Tensor, view: Tensor, position: Tensor) -> Tensor:
        mask = (position[:, :1] > 0).to(normal.dtype)
        return rt.shade(self.model, rt.GBuffer(normal, view, position, mask=mask), LIGHTS)


def forms_of(kind: str) -> tuple[torch.nn.Module, torch.nn.Module]:
    model = model_of(kind)
    return model, Frame(model)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "which"),
    [("plain", 0), ("baked", 0), ("baked", 1)],
    ids=["plain model", "baked model", "shade"],
)
def test_one_graph_for_frames_of_every_size(form, kind, which) -> None:
    module = forms_of(kind)[which]
    compiled = torch.compile(module, backend="eager", fullgraph=True)
    for size in WARM:  # the second size tells torch that sizes vary
        compiled(*maps(*size))
    with torch._dynamo.config.patch(error_on_recompile=True):
        for size in SIZES:
            assert torch.equal(compiled(*maps(*size)), module(*maps(*size)))


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1], ids=["model", "shade"])
def test_export_with_free_sizes(form, which) -> None:
    module = forms_of("baked")[which]
    height, width = torch.export.Dim("height", min=2), torch.export.Dim("width", min=2)
    program = torch.export.export(
        module, maps(6, 5), dynamic_shapes=({2: height, 3: width},) * 3, strict=False
    )
    operators = [n.target for n in program.graph.nodes if "raden_torch" in str(n.target)]
    assert len(operators) == 1 + (form != simd.OFF)  # `bake`, and the kernel's
    for size in ((7, 9), (16, 18)):
        assert torch.equal(program.module()(*maps(*size)), module(*maps(*size)))


@pytest.mark.parametrize("kind", ["plain", "baked"])
@pytest.mark.parametrize("which", [0, 1], ids=["model", "shade"])
def test_nothing_is_tied_to_the_cpu(kind, which, dtype) -> None:
    module = forms_of(kind)[which].to("meta")
    image = module(*(m.to("meta", dtype) for m in maps(6, 5)))
    assert (image.device.type, image.dtype, image.shape) == ("meta", dtype, (1, 3, 6, 5))
    assert image.requires_grad
    image.sum().backward()
    assert {p.grad.device.type for p in module.parameters()} == {"meta"}


@pytest.mark.slow
@pytest.mark.skipif(
    not any(map(shutil.which, ("c++", "g++", "clang++"))),
    reason="torch.compile's CPU backend needs a C++ compiler: none is here",
)
def test_compiled_code_agrees_with_the_eager_form() -> None:
    torch.compiler.reset()
    model = model_of("plain")
    in_process = torch._inductor.config.patch(compile_threads=1)  # no pool of compilers to start
    with simd.using(simd.OFF), torch.no_grad(), in_process:
        compiled = torch.compile(model, fullgraph=True)
        torch.testing.assert_close(
            compiled(*maps(16, 18)), model(*maps(16, 18)), rtol=1e-4, atol=1e-5
        )
