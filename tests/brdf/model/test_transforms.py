"""torch.func's transforms, forward mode, copies, pickles, devices and precisions of a model."""

from __future__ import annotations

import copy
import io
import pickle
from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad

import raden_torch as rt
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.urushi import VERMILION, Coated, Lambertian
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError

# what torch says of its own forward-mode rules
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")


def small_model(seed: int = 0) -> rt.RadenBrdf:
    generator = torch.Generator().manual_seed(seed)
    values = torch.rand(4, 6, 6, 3, generator=generator, dtype=torch.float64) + 0.1
    part = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0])).double()
    table = ReflectanceTable(values, (0.0, -70.0, -70.0), (23.0, 28.0, 28.0))
    layout = RuntimeLayout((6, 9, 9), (0.4, 0.4))
    return rt.RadenBrdf(part, table, layout=layout).requires_grad_(seed > 0)


@pytest.fixture(params=[0, 1], ids=["frozen", "with gradients"])
def model(request: pytest.FixtureRequest) -> rt.RadenBrdf:
    return small_model(request.param)


@pytest.fixture
def maps() -> tuple[Tensor, Tensor, Tensor]:
    v = torch.randn(3, 1, 3, 2, 4, dtype=torch.float64) + torch.tensor([0, 0, 2.5]).view(3, 1, 1)
    n, l, view = torch.nn.functional.normalize(v, dim=2)  # noqa: E741
    return n, l, view


def parameters(model: rt.RadenBrdf) -> dict[str, Tensor]:
    return {name: p.detach().clone() for name, p in model.named_parameters()}


def test_vmap_is_a_loop(model, maps) -> None:
    many = [torch.stack([m, m.roll(1, 3), m.flip(3)]) for m in maps]
    one_by_one = torch.stack([model(*three) for three in zip(*many, strict=True)])
    assert torch.equal(torch.func.vmap(model)(*many), one_by_one)
    lamps = torch.func.vmap(model, in_dims=(None, 0, None))(maps[0], many[1], maps[2])
    assert torch.equal(lamps[1], model(maps[0], many[1][1], maps[2]))


def test_an_ensemble_of_models_is_a_loop(model, maps) -> None:
    """As torch's tutorial on ensembles has it: the parameters stacked, `functional_call` mapped."""
    others = [parameters(small_model(seed)) for seed in (1, 2, 3)]
    stacked = {name: torch.stack([p[name] for p in others]) for name in others[0]}

    def evaluated(given: dict[str, Tensor]) -> Tensor:
        return torch.func.functional_call(model, given, maps)

    one_by_one = torch.stack([evaluated(p) for p in others])
    assert (one_by_one[0] != one_by_one[1]).any()
    torch.testing.assert_close(torch.func.vmap(evaluated)(stacked), one_by_one)


def test_grad_and_functional_call_are_autograd(model, maps) -> None:
    given = parameters(model)

    def loss(p: dict[str, Tensor], n: Tensor) -> Tensor:
        return torch.func.functional_call(model, p, (n, *maps[1:])).square().sum()

    found, by_n = torch.func.grad(loss, (0, 1))(given, maps[0])
    own, n = copy.deepcopy(model).requires_grad_(), maps[0].clone().requires_grad_()
    own(n, *maps[1:]).square().sum().backward()
    torch.testing.assert_close(by_n, n.grad)
    for name, p in own.named_parameters():
        torch.testing.assert_close(found[name], p.grad)


@torch.no_grad()
def test_a_table_that_takes_the_place_of_another_is_another(maps) -> None:
    """Rationale: memory is given again to what comes next, and a kept table is known by its
    tensors. Expected: twice the values, twice the reflection, however often."""
    model = small_model().float()
    vectors = tuple(m.float() for m in maps)
    first = model(*vectors)
    only_table = rt.RadenBrdf(None, model.table, layout=model.layout)
    one = only_table(*vectors)
    for k in range(2, 12):
        f = torch.func.functional_call(
            only_table, {"table.values": k * model.table.values}, vectors
        )
        torch.testing.assert_close(f, k * one)
    assert torch.equal(model(*vectors), first)


def finite_difference(f: Callable[[float], Tensor], step: float = 1e-6) -> Tensor:
    return (f(step) - f(-step)) / (2 * step)


def test_forward_mode_is_the_finite_difference(model, maps) -> None:
    given = parameters(model)
    along = {name: torch.randn_like(p) for name, p in given.items()}
    way = torch.randn_like(maps[0])

    def f(p: dict[str, Tensor], n: Tensor) -> Tensor:
        return torch.func.functional_call(model, p, (n, *maps[1:]))

    def moved(s: float) -> Tensor:
        return f({name: p + s * along[name] for name, p in given.items()}, maps[0] + s * way)

    value, slope = torch.func.jvp(f, (given, maps[0]), (along, way))
    torch.testing.assert_close(value, f(given, maps[0]))
    torch.testing.assert_close(slope, finite_difference(moved), rtol=1e-6, atol=1e-7)


def test_forward_mode_through_parameters_in_place(maps) -> None:
    """Rationale: a baked table that is kept knows nothing of a tangent. Expected: that of jvp."""
    model = small_model()
    way = torch.randn_like(model.table.values)
    before = model(*maps)

    def moved(s: float) -> Tensor:
        values = {"table.values": model.table.values + s * way}
        return torch.func.functional_call(model, values, maps)

    with forward_ad.dual_level():
        dual = forward_ad.make_dual(model.table.values.detach(), way)
        found = torch.func.functional_call(model, {"table.values": dual}, maps)
        value, slope = forward_ad.unpack_dual(found)
    assert torch.equal(value, before)
    torch.testing.assert_close(slope, finite_difference(moved), rtol=1e-6, atol=1e-7)


def test_jacobians_and_the_hessian(model, maps) -> None:
    one = [m[..., :1, :1] for m in maps]
    by_normal = [make(lambda n: model(n, *one[1:]))(one[0]) for make in
                 (torch.func.jacfwd, torch.func.jacrev)]  # fmt: skip
    torch.testing.assert_close(*by_normal)
    hessian = torch.func.hessian(lambda n: model(n, *one[1:]).square().sum())(one[0])
    flat = hessian.reshape(3, 3)
    torch.testing.assert_close(flat, flat.T)
    assert (flat != 0).any()


def test_shading_within_transforms(model, maps) -> None:
    lamps = [rt.DirectionalLight((0.3, 0.2, 1.0)), rt.DirectionalLight((-0.5, 0.1, 1.0))]

    def picture(n: Tensor) -> Tensor:
        return rt.shade(model, rt.GBuffer(n, view=(0.0, 0.0, 1.0)), lamps)

    many = torch.stack([maps[0], maps[0].flip(3)])
    torch.testing.assert_close(
        torch.func.vmap(picture)(many), torch.stack([picture(n) for n in many])
    )
    n = maps[0].clone().requires_grad_()
    (expected,) = torch.autograd.grad(picture(n).sum(), n)
    torch.testing.assert_close(torch.func.grad(lambda n: picture(n).sum())(maps[0]), expected)

    def under(direction: Tensor) -> Tensor:
        lamp = rt.DirectionalLight(direction)
        return rt.shade(model, rt.GBuffer(maps[0], view=(0.0, 0.0, 1.0)), lamp)

    direction = torch.tensor([0.3, 0.2, 1.0], dtype=torch.float64)
    by_lamp = torch.func.jacrev(under)(direction)
    assert by_lamp.shape == (1, 3, 2, 4, 3)
    # a lamp's numbers are checked, which vmap does not allow
    with pytest.raises(InputError, match=r"^DirectionalLight: direction: [^\n]*vmap; give all"):
        torch.func.vmap(under)(direction.expand(2, 3))


def materials() -> dict[str, torch.nn.Module]:
    shell = small_model().float()
    coated = Coated(shell, absorption=0.5, thickness=0.1)
    gold = Powder(Foil("gold", 0.2), density=0.5, ground=Lambertian(VERMILION))
    return {
        "model": shell,
        "palette": Palette([shell, coated, gold, Lambertian((0.1, 0.2, 0.3))]),
        "coat": coated,
        "powder": gold,
    }


COPIES: dict[str, Callable[[object], object]] = {
    "pickle": lambda x: pickle.loads(pickle.dumps(x)),
    "deepcopy": copy.deepcopy,
}


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("name", ["model", "palette", "coat", "powder"])
@torch.no_grad()
def test_copies_reflect_the_same(name, copied, maps) -> None:
    vectors = [m.float() for m in maps]
    material = materials()[name]
    if name == "model":
        material.specular_gain = 0.5
    again = copied(material)
    pairs = zip(material, again, strict=True) if name == "palette" else [(material, again)]
    for a, b in pairs:
        assert a is not b
        assert torch.equal(a.of_unit_vectors(*vectors), b.of_unit_vectors(*vectors))
    if name == "palette":  # one shell, as before
        assert again[1].base is again[0]
        assert again.parts[0] is again[0]


@torch.no_grad()
def test_a_state_dict_brings_the_table_and_not_the_gains(maps) -> None:
    """As the docs say: gains, layout and provenance are attributes, which `save_model` keeps."""
    model, other = small_model(), small_model(1)
    model.specular_gain = 0.5
    file = io.BytesIO()
    torch.save(model.state_dict(), file)
    file.seek(0)
    before = other(*maps)  # bakes a table that must not be kept
    other.load_state_dict(torch.load(file, weights_only=True))
    assert other.specular_gain == 1.0
    other.specular_gain = 0.5
    assert torch.equal(other(*maps), model(*maps))
    assert not torch.equal(other(*maps), before)


@torch.no_grad()
@pytest.mark.parametrize("to", [torch.float16, torch.bfloat16, torch.float32])
def test_precisions(to, maps) -> None:
    exact, model = small_model()(*maps), small_model().to(to)
    assert {p.dtype for p in model.parameters()} == {to}
    for given in (to, torch.float32):
        f = model(*(m.to(given) for m in maps))
        assert f.dtype == torch.float32  # half is computed and given in single precision
        error = (f - exact).abs().max() / exact.max()
        assert error < 8 * torch.finfo(to).eps
    assert model.double()(*maps).dtype == torch.float64


def test_moving_a_palette_moves_what_is_under_its_coats() -> None:
    palette = materials()["palette"].to("meta")
    assert {p.device.type for p in palette.parameters()} == {"meta"}
    assert palette[1].base.table.values.is_meta
