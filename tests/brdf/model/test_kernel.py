"""The fused kernel against the eager form: accuracy by region, layouts, threads, and torch."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model import kernel, simd
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.errors import InputError

needs_kernel = pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
pytestmark = needs_kernel

Maps = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    """A small random model: every branch is reached, nothing is smooth."""
    generator = torch.Generator().manual_seed(0)
    table = torch.rand(8, 15, 15, 3, generator=generator)
    table[0] = (table[0] + table[0].flip(0, 1)) / 2  # (0, r, t) and (0, -r, -t) are one geometry
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
    return rt.RadenBrdf(diffuse, ReflectanceTable(table, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0)))


@pytest.fixture(params=simd.LEVELS)
def level(request: pytest.FixtureRequest) -> str:
    return request.param


def evaluate(model: rt.RadenBrdf, maps: Maps, level: str) -> torch.Tensor:
    with torch.no_grad(), simd.using(level):
        return model(*maps)


def directions(n: int, seed: int, spread: float = 1.0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    v = torch.randn(1, 3, n, 1, generator=generator, dtype=torch.float64) * spread
    v[:, 2] = v[:, 2].abs() + 0.05
    return torch.nn.functional.normalize(v, dim=1)


def unit(v: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(v, dim=1)


COUNT = 20_000


def almost_parallel(distance: float) -> Callable[[], Maps]:
    def make() -> Maps:
        n, l = directions(COUNT, 1), directions(COUNT, 2)  # noqa: E741
        return n, l, unit(l + distance * (directions(COUNT, 3) - directions(COUNT, 4)))

    return make


def in_the_plane() -> Maps:
    l, v = directions(COUNT, 2), directions(COUNT, 3)  # noqa: E741
    generator = torch.Generator().manual_seed(6)
    share = torch.rand(1, 1, COUNT, 1, dtype=torch.float64, generator=generator)
    return unit(share * l + (1 - share) * v), l, v


def almost_across_the_plane() -> Maps:
    l, v = directions(COUNT, 2), directions(COUNT, 3)  # noqa: E741
    n = torch.linalg.cross(l, v, dim=1)
    return unit(unit(n) + 0.05 * (l + v)), l, v


def grazing() -> Maps:
    n, l, v = (directions(COUNT, seed) for seed in (1, 2, 3))  # noqa: E741
    along = unit(l - (n * l).sum(1, keepdim=True) * n)
    return n, unit(along + 1e-3 * n), v


def at_nodes() -> Maps:
    generator = torch.Generator().manual_seed(5)
    a, r, t = (
        torch.deg2rad(10.0 * torch.randint(low, 8, (1, 1, COUNT, 1), generator=generator).double())
        for low in (0, -7, -7)
    )
    return rt.vectors_from_angles(a.clamp(min=0.01), r, t)


REGIONS: dict[str, Callable[[], Maps]] = {
    "random": lambda: (directions(COUNT, 1), directions(COUNT, 2), directions(COUNT, 3)),
    "near the normal": lambda: tuple(directions(COUNT, seed, 0.05) for seed in (1, 2, 3)),
    "grazing": grazing,
    "N in the plane": in_the_plane,
    "N almost across the plane": almost_across_the_plane,
    "at nodes": at_nodes,
    **{f"|L - V| = {d:g}": almost_parallel(d) for d in (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 0.1)},
}


@pytest.fixture(scope="module")
def eager_errors(model) -> Callable[[str, float], tuple[Maps, torch.Tensor, torch.Tensor]]:
    """By region and length: the maps, the exact values, and the errors of the eager form. All
    instruction sets are compared with the same, so that it is computed once."""

    @cache
    def make(region: str, length: float) -> tuple[Maps, torch.Tensor, torch.Tensor]:
        maps = tuple((length * m).float() for m in REGIONS[region]())
        exact = model(*(m.double() for m in maps)).detach()
        return maps, exact, (evaluate(model, maps, simd.OFF) - exact).abs().flatten()

    return make


@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("length", [1.0, 3.7])
def test_error_is_at_most_twice_that_of_the_eager_form(
    model, eager_errors, level, region, length
) -> None:
    """Both against float64 on the same single-precision inputs."""
    maps, exact, eagers = eager_errors(region, length)
    kernels = (evaluate(model, maps, level) - exact).abs().flatten()
    rounding = 3e-7  # of values up to 1, and of their sum
    assert kernels.mean() <= 2 * eagers.mean() + rounding
    for share in (0.9, 0.999):
        assert kernels.quantile(share) <= 2 * eagers.quantile(share) + rounding


def test_special_vectors_are_as_in_the_eager_form(model, level) -> None:
    inf, nan = float("inf"), float("nan")
    special = torch.tensor(
        [
            *([0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0, 0.8], [1e-8, 0, 1], [1, 0, 1e-8]),
            *([0, 0, 0], [nan, 0, 1], [0, 0, inf], [-inf, inf, nan], [0, -0.0, -inf]),
            *(
                [1e-40, 0, 1e-40],
                [0, 1e-45, 0],
                [3e38, 0, 3e38],
                [0, 1e20, 1e20],
                [1e-25, 0, 1e-24],
            ),
        ]
    ).T
    n = special.shape[1]
    maps = tuple(
        special.view(3, *shape).expand(3, n, n, n).reshape(1, 3, -1, n)
        for shape in ((n, 1, 1), (1, n, 1), (1, 1, n))
    )
    found, expected = (evaluate(model, maps, which) for which in (level, simd.OFF))
    assert torch.isfinite(found).all()
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)
    invalid = ~torch.isfinite(special).all(0) | (special == 0).all(0)
    some = invalid.view(-1, 1, 1) | invalid.view(1, -1, 1) | invalid.view(1, 1, -1)
    assert (found[:, :, some.reshape(-1, n)] == 0).all()


def test_nothing_is_seen_or_lit_below_the_horizon(model, level) -> None:
    up, above = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1), directions(500, 1).float()
    assert (evaluate(model, (up, above, above.flip(2)), level) != 0).any()
    for light, view in ((-above, above), (above, -above), (-above, -above)):
        assert (evaluate(model, (up, light, view), level) == 0).all()


@pytest.fixture(scope="module")
def eager_part(model) -> Callable[..., tuple[rt.RadenBrdf, Maps, torch.Tensor]]:
    """The model with some gains and parts, maps, and what the eager form makes of them, once."""

    @cache
    def make(gains: tuple[float, float], parts: str) -> tuple[rt.RadenBrdf, Maps, torch.Tensor]:
        diffuse = model.diffuse if parts in ("both", "diffuse") else None
        table = model.table if parts in ("both", "table") else None
        part = rt.RadenBrdf(diffuse, table, diffuse_gain=gains[0], specular_gain=gains[1])
        maps = tuple(m.float() for m in REGIONS["random"]())
        return part, maps, evaluate(part, maps, simd.OFF)

    return make


@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.5, 2.0), (0.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
@pytest.mark.parametrize("parts", ["both", "diffuse", "table", "neither"])
def test_gains_and_missing_parts(eager_part, level, gains, parts) -> None:
    part, maps, expected = eager_part(gains, parts)
    found = evaluate(part, maps, level)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=2e-5)


@pytest.fixture(scope="module")
def baked() -> rt.RadenBrdf:
    """A small random model with a baked table."""
    pieces = ((1, 4, 2), (1, 2, 3, 4, 4, 3, 2, 1, 1), (3, 1, 1, 2, 2, 3))
    generator = torch.Generator().manual_seed(8)
    values = torch.rand(*(1 + sum(cuts) for cuts in pieces), 3, generator=generator)
    table = ReflectanceTable(values, (0.0, -70.0, -60.0), (20.0, 20.0, 20.0), pieces)
    return rt.RadenBrdf(CosineDiffuse(torch.ones(3), torch.ones(3)), table)


def test_a_baked_table_is_read_as_in_the_eager_form(baked, level) -> None:
    maps = tuple(m.float() for m in REGIONS["random"]())
    exact = baked(*(m.double() for m in maps)).detach()
    found, eager = (evaluate(baked, maps, which) - exact for which in (level, simd.OFF))
    assert found.abs().mean() <= 2 * eager.abs().mean()
    assert found.abs().quantile(0.999) <= 2 * eager.abs().quantile(0.999)


def image_maps(height: int = 37, width: int = 101) -> Maps:
    return tuple(
        directions(2 * height * width, seed).float().reshape(3, 2, height, width).transpose(0, 1)
        for seed in (1, 2, 3)
    )


def test_layouts_do_not_matter(model, level) -> None:
    """Each pixel's value depends on nothing but its own vectors: equal bit for bit."""
    maps = tuple(m.contiguous() for m in image_maps())
    whole = evaluate(model, maps, level)
    layouts = {
        "channels last": lambda m: m.contiguous(memory_format=torch.channels_last),
        "transposed": lambda m: m.transpose(2, 3).contiguous().transpose(2, 3),
        "every other column": lambda m: m.repeat_interleave(2, 3)[..., ::2],
        "part of a larger image": lambda m: torch.nn.functional.pad(m, (3, 5, 2, 1))[
            ..., 2:-1, 3:-5
        ],
        "misaligned": lambda m: torch.cat([m.new_zeros(1), m.flatten()])[1:].view(m.shape),
    }
    for layout in layouts.values():
        assert torch.equal(evaluate(model, tuple(layout(m) for m in maps), level), whole)
    crop = evaluate(model, tuple(m[:1, :, 5:6, 7:30] for m in maps), level)
    assert torch.equal(crop, whole[:1, :, 5:6, 7:30])
    column = evaluate(model, tuple(m[0, :, :, 9:10] for m in maps), level)
    assert torch.equal(column, whole[0, :, :, 9:10])
    stacked = evaluate(model, tuple(m.view(2, 1, 3, 37, 101) for m in maps), level)
    assert torch.equal(stacked, whole.view(2, 1, 3, 37, 101))


def test_constant_maps_are_broadcast_not_expanded(model, level) -> None:
    normal, light, view = image_maps()
    for shape in (
        (slice(0, 1), slice(0, 1)),
        (slice(None), slice(0, 1)),
        (slice(0, 1), slice(None)),
    ):
        few_l, few_v = (m[:1, :, shape[0], shape[1]] for m in (light, view))
        found = evaluate(model, (normal, few_l, few_v), level)
        full = tuple(m.expand_as(normal).contiguous() for m in (few_l, few_v))
        assert torch.equal(found, evaluate(model, (normal, *full), level))


@pytest.mark.parametrize("shape", [(0, 3, 4, 4), (1, 3, 0, 4), (2, 3, 4, 0), (3, 0, 1)])
def test_no_pixels(model, shape) -> None:
    maps = (torch.ones(shape), torch.ones(3, 1, 1), torch.ones(3, 1, 1))
    assert evaluate(model, maps, simd.LEVELS[-1]).shape == shape


def test_dtypes(model) -> None:
    maps = image_maps(5, 7)
    mixed = (maps[0].half(), maps[1].bfloat16(), maps[2])
    found = evaluate(model, mixed, simd.LEVELS[-1])
    assert found.dtype == torch.float32
    assert torch.equal(found, evaluate(model, tuple(m.float() for m in mixed), simd.LEVELS[-1]))
    doubled = (maps[0].double(), *maps[1:])
    assert evaluate(model, doubled, simd.LEVELS[-1]).dtype == torch.float64
    half = copy.deepcopy(model).bfloat16()
    torch.testing.assert_close(
        evaluate(half, maps, simd.LEVELS[-1]), evaluate(half, maps, simd.OFF),
        rtol=1e-5, atol=2e-5,
    )  # fmt: skip


def test_wrong_devices_are_one_line(model) -> None:
    maps = [m.to("meta") for m in image_maps(4, 4)]
    with pytest.raises(
        InputError,
        match=r"^model and maps: expected one device, got .* on cpu, maps on meta[^\n]*$",
    ):
        model(*maps)
    with pytest.raises(
        InputError, match=r"^maps: expected one device, got normal on cpu, light on meta[^\n]*$"
    ):
        model(image_maps(4, 4)[0], *maps[1:])
    assert copy.deepcopy(model).to("meta")(*maps).shape == (2, 3, 4, 4)


def large_maps() -> Maps:
    return tuple(m.repeat(1, 1, 4, 4) for m in image_maps())


def test_any_number_of_threads_gives_the_same_bits(model, level) -> None:
    before = torch.get_num_threads()
    try:
        images = []
        for threads in (1, 2, 64):
            torch.set_num_threads(threads)
            images.append(evaluate(model, large_maps(), level))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(image, images[0]) for image in images)


def test_callers_at_the_same_time(model) -> None:
    maps = large_maps()
    expected, found = evaluate(model, maps, simd.LEVELS[-1]), []

    def call() -> None:
        with torch.no_grad():
            for _ in range(5):
                found.append(torch.equal(model(*maps), expected))

    callers = [threading.Thread(target=call) for _ in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(300)
    assert found == [True] * 20


def test_a_forked_child_has_threads_of_its_own(tmp_path: Path) -> None:
    script = tmp_path / "fork.py"
    script.write_text(
        "import os, torch, raden_torch as rt\n"
        "from raden_torch.brdf.model import kernel\n"
        "from raden_torch.brdf.model.reflectance_table import ReflectanceTable\n"
        "torch.set_num_threads(2)\n"
        "t = ReflectanceTable(torch.rand(3, 3, 3, 3), (0., -70., -70.), (35., 70., 70.))\n"
        "model, up = rt.RadenBrdf(None, t), torch.tensor([0., 0., 1.]).view(1, 3, 1, 1)\n"
        "maps = [up + 0.2 * torch.rand(1, 3, 300, 300) for _ in range(3)]\n"
        "with torch.no_grad():\n"
        "    first = model(*maps)\n"
        "    child = os.fork()\n"
        "    same = bool((model(*maps).numpy() == first.numpy()).all())\n"
        "if child == 0:\n"
        "    os._exit(0 if same else 1)\n"
        "assert same and os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0\n"
    )
    subprocess.run([sys.executable, "-W", "ignore", script], check=True, timeout=300)


def operator_arguments(model: rt.RadenBrdf, maps: Maps, **flags: bool) -> tuple[object, ...]:
    tensors = tuple(m.clone().requires_grad_(flags.get("gradients", False)) for m in maps)
    return (*tensors, model.runtime_table(), model.layout.warp)


def test_the_operators_are_registered_as_torch_wants_them(model) -> None:
    maps = image_maps(3, 5)
    with torch.no_grad():
        detached = copy.deepcopy(model).requires_grad_(False)
        arguments = operator_arguments(detached, maps)
    tests = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(torch.ops.raden_torch.brdf.default, arguments, test_utils=tests)
    torch.library.opcheck(
        torch.ops.raden_torch.brdf.default,
        operator_arguments(model, maps, gradients=True),
        test_utils=tests,
    )
    lamps = torch.rand(2, 1, 13)
    lamps[..., 0] = 0
    torch.library.opcheck(
        torch.ops.raden_torch.shade.default,
        (maps[0], None, maps[1], None, None, maps[2][:, :1], lamps, *arguments[3:]),
        test_utils=tests,
    )


Gradients = dict[str, torch.Tensor]


def gradients_of(
    model: rt.RadenBrdf, maps: Maps, level: str, to: torch.dtype = torch.float32
) -> Gradients:
    """Of a random weighted sum of the image, by the name of what it is taken by."""
    copied = copy.deepcopy(model).to(to)
    named = dict(zip(("normal", "light", "view"), maps, strict=True))
    leaves = {name: m.to(to).clone().requires_grad_() for name, m in named.items()}
    with simd.using(level):
        f = copied(*leaves.values())
    weights = torch.randn(f.shape, generator=torch.Generator().manual_seed(9)).to(to)
    (f * weights).sum().backward()
    return {k: x.grad for k, x in leaves.items()} | {
        k: x.grad for k, x in copied.named_parameters()
    }


@pytest.fixture(params=["plain", "baked"])
def either_model(request: pytest.FixtureRequest, model, baked) -> rt.RadenBrdf:
    return baked if request.param == "baked" else model


@pytest.fixture(scope="module")
def eager_gradients() -> Callable[[rt.RadenBrdf, str], tuple[Maps, Gradients, Gradients]]:
    """By model and region: the maps, the exact gradients and the eager ones, computed once."""

    @cache
    def make(model: rt.RadenBrdf, region: str) -> tuple[Maps, Gradients, Gradients]:
        maps = tuple((3.7 * m[:, :, :2000]).float() for m in REGIONS[region]())
        exact = gradients_of(model, maps, simd.OFF, torch.float64)
        return maps, exact, gradients_of(model, maps, simd.OFF)

    return make


@pytest.mark.parametrize("region", [name for name in REGIONS if name != "at nodes"])  # kinks
def test_the_gradient_errs_no_more_than_the_eager_one(
    either_model, eager_gradients, level, region
) -> None:
    maps, exact, eager = eager_gradients(either_model, region)
    found = gradients_of(either_model, maps, level)
    for name, truth in exact.items():
        # kinks at cell borders may fall on either side: a rare pixel is another gradient's
        scale = truth.abs().flatten().quantile(0.99)

        def error(of: torch.Tensor, truth: torch.Tensor = truth) -> torch.Tensor:
            return (of - truth).abs().flatten().quantile(0.98)

        assert torch.isfinite(found[name]).all(), name
        times = 4 if name.startswith("diffuse") else 2  # three sums of signed rounding errors
        assert error(found[name]) <= times * error(eager[name]) + 1e-5 * scale, name


def test_gradients_of_special_vectors_are_finite(either_model, level) -> None:
    tiny, huge = torch.tensor(1e-30), torch.tensor(1e30)
    up = torch.tensor([0.0, 0.0, 1.0])
    bad = (torch.zeros(3), torch.full((3,), torch.nan), torch.full((3,), torch.inf))
    vectors = torch.stack([up, -up, tiny * up, huge * up, torch.tensor([1.0, 0.0, 1e-30]), *bad])
    triples = torch.cartesian_prod(*3 * [torch.arange(len(vectors))])
    maps = tuple(vectors[triples[:, k]].T[None, :, :, None] for k in range(3))
    for name, gradient in gradients_of(either_model, maps, level).items():
        assert torch.isfinite(gradient).all(), name


def test_gradients_are_summed_over_what_is_broadcast(model, level) -> None:
    n, l, v = image_maps(6, 7)  # noqa: E741
    constant = (n, l[:, :, :1, :1], v[:, :, :, :1])
    whole = tuple(m.expand_as(n) for m in constant)
    by_pixel, found = (gradients_of(model, maps, level) for maps in (whole, constant))
    for name, size in (("light", (2, 3, 1, 1)), ("view", (2, 3, 6, 1))):
        assert found[name].shape == size
        torch.testing.assert_close(found[name], by_pixel[name].sum_to_size(size))


@pytest.mark.parametrize("frozen", ["table", "diffuse"])
def test_only_what_asks_for_it_gets_a_gradient(model, frozen) -> None:
    copied = copy.deepcopy(model)
    getattr(copied, frozen).requires_grad_(False)
    copied(*image_maps(3, 5)).sum().backward()
    for name, parameter in copied.named_parameters():
        assert (parameter.grad is None) == name.startswith(frozen), name


@pytest.mark.parametrize("part", ["table", "diffuse"])
def test_gradients_of_a_model_without_a_part(model, level, part) -> None:
    copied = copy.deepcopy(model)
    setattr(copied, part, None)
    exact = gradients_of(copied, image_maps(6, 7), simd.OFF, torch.float64)
    for name, found in gradients_of(copied, image_maps(6, 7), level).items():
        torch.testing.assert_close(found, exact[name].float(), rtol=1e-4, atol=1e-4)


def test_gradients_in_half_precision_come_back_in_it(model, level) -> None:
    maps = tuple(m.to(torch.bfloat16) for m in image_maps(6, 7))
    found = gradients_of(model, maps, level, torch.bfloat16)
    assert {g.dtype for g in found.values()} == {torch.bfloat16}


def test_gradients_are_the_same_bits_every_time(model, level) -> None:
    first, second = (gradients_of(model, image_maps(200, 300), level) for _ in range(2))
    assert all(torch.equal(g, second[name]) for name, g in first.items())


def test_deterministic_gradients_are_the_same_bits_by_any_number_of_threads(model, level) -> None:
    before, tables = torch.get_num_threads(), []
    torch.use_deterministic_algorithms(True)
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            tables.append(gradients_of(model, image_maps(200, 300), level)["table.values"])
    finally:
        torch.set_num_threads(before)
        torch.use_deterministic_algorithms(False)
    assert torch.equal(tables[0], tables[1])
    assert torch.equal(tables[0], tables[2])


def test_gradients_of_gradients_take_the_eager_form(model) -> None:
    def twice(level: str) -> torch.Tensor:
        n, l, v = (m.clone().requires_grad_() for m in image_maps(3, 5))  # noqa: E741
        with simd.using(level):
            (slope,) = torch.autograd.grad(model(n, l, v).sum(), n, create_graph=True)
        return torch.autograd.grad(slope.square().sum(), l)[0]

    torch.testing.assert_close(twice(simd.level()), twice(simd.OFF), rtol=1e-3, atol=1e-3)


@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
def test_transforms_take_the_eager_form_and_gains_may_be_tensors(model) -> None:
    maps = image_maps(3, 5)
    frozen = copy.deepcopy(model).requires_grad_(False)
    assert kernel.takes(frozen, *maps)
    f, slope = torch.func.jvp(lambda n: frozen(n, *maps[1:]), (maps[0],), (maps[1],))
    assert f.shape == slope.shape
    frozen.specular_gain = torch.tensor(0.5, requires_grad=True)
    half = frozen(*maps)
    (by_gain,) = torch.autograd.grad(half.sum(), frozen.specular_gain)
    with torch.no_grad():
        frozen.specular_gain.fill_(1.0)
        whole = frozen(*maps)
        frozen.specular_gain = 0.0
        none = frozen(*maps)
    torch.testing.assert_close(half, (whole + none) / 2)
    torch.testing.assert_close(by_gain, (whole - none).sum(), rtol=1e-4, atol=1e-4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_compile_and_export_see_one_operator(model) -> None:
    maps = image_maps(3, 5)
    with torch.no_grad():
        expected = model(*maps)
        program = torch.export.export(model, maps)
        assert "raden_torch.brdf" in str(program.graph)
        assert torch.equal(program.module()(*maps), expected)
        compiled = torch.compile(model, backend="aot_eager", fullgraph=True)
        assert torch.equal(compiled(*maps), expected)


def test_off_takes_the_eager_form(model, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = image_maps(3, 5)
    with torch.no_grad(), simd.using(simd.OFF):
        assert not kernel.takes(model, *maps)
        assert "eager torch: RADEN_TORCH_SIMD=off" in simd.system_report()
    monkeypatch.setattr(simd, "LEVELS", ())
    monkeypatch.setattr(simd, "_asked", None)
    assert "was not built" in simd.system_report()
    with torch.no_grad():
        assert model(*maps).shape == maps[0].shape


@pytest.mark.parametrize(("asked", "code"), [("portable", 0), ("off", 0), ("sse9", 2)])
def test_the_environment_chooses_the_simd(asked: str, code: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "raden_torch.cli", "info", "--system"],
        env={**os.environ, simd.VARIABLE: asked},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == code
    assert asked in (done.stderr if code else done.stdout)
    assert len(done.stderr.splitlines()) == (1 if code else 0)


SCENES = {
    "directional": [rt.DirectionalLight((0.3, 0.2, 1.0), (1.0, 2.0, 3.0))],
    "point": [rt.PointLight((0.3, 0.2, 2.0), (3.0, 2.0, 1.0))],
    "spot": [rt.SpotLight((0.3, 0.2, 2.0), (0.0, 0.0, 0.0), inner_deg=5, outer_deg=40)],
    "several": [
        rt.DirectionalLight(torch.tensor([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])),
        rt.DirectionalLight((0.0, 0.0, -1.0)),
        rt.PointLight((0.0, 0.5, 1.0)),
    ],
    "none": [],
}


def scene(camera: bool = True, mask: torch.Tensor | None = None) -> rt.GBuffer:
    normal = image_maps()[0] + torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1)
    generator = torch.Generator().manual_seed(6)
    position = torch.rand(normal.shape, generator=generator) - 0.5
    view = None if camera else (0.2, 0.1, 1.0)
    return rt.GBuffer(
        normal, view, position=position, camera=(0.0, 0.0, 3.0) if camera else None, mask=mask
    )


def lit(model: rt.RadenBrdf, gbuffer: rt.GBuffer, lights, level: str) -> torch.Tensor:
    with torch.no_grad(), simd.using(level):
        return rt.shade(model, gbuffer, lights)


@pytest.mark.parametrize("camera", [True, False])
@pytest.mark.parametrize("lights", SCENES)
def test_shade_is_as_the_eager_form(model, level, lights, camera) -> None:
    gbuffer = scene(camera)
    found, expected = (lit(model, gbuffer, SCENES[lights], which) for which in (level, simd.OFF))
    assert found.shape == expected.expand_as(found).shape
    torch.testing.assert_close(found, expected.expand_as(found), rtol=1e-4, atol=3e-5)


def sparse_masks() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(7)
    scattered = (torch.rand(2, 1, 37, 101, generator=generator) < 0.1).float()
    block = torch.zeros(1, 1, 37, 101)
    block[..., 5:20, 10:90] = 0.5
    return {
        "scattered": scattered,
        "block": block,
        "nothing": torch.zeros(1, 1, 1, 1),
        "bool": scattered.bool(),
        "one row": block[..., 7:8, :],
        "not finite": torch.where(scattered > 0, float("nan"), 2.0),
    }


@pytest.mark.parametrize("mask", sparse_masks())
def test_skipped_pixels_change_nothing(model, level, mask) -> None:
    """Bit for bit the whole image times the mask."""
    kept = sparse_masks()[mask]
    whole = lit(model, scene(), SCENES["several"], level)
    found = lit(model, scene(mask=kept), SCENES["several"], level)
    weight = torch.nan_to_num(kept.float(), nan=0.0).clamp(0, 1)
    assert torch.equal(found, whole * weight)
    torch.testing.assert_close(
        found,
        lit(model, scene(mask=kept), SCENES["several"], simd.OFF),
        rtol=1e-4,
        atol=3e-5,
    )


@pytest.mark.parametrize("layout", ["channels last", "columns first"])
def test_a_mask_over_maps_in_other_strides(model, level, layout) -> None:
    """Rationale: tiles that a mask covers wholly are copied from such maps pixel by pixel, too.
    Expected: bit for bit the picture of the same maps in rows."""
    size = 6, 256
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(1, 3, *size, generator=generator) + torch.tensor([0, 0, 1.5]).view(3, 1, 1)
    mask = torch.ones(1, 1, *size)
    mask[..., 70:120] = (torch.rand(50, generator=generator) > 0.5).float()
    order = (0, 2, 3, 1) if layout == "channels last" else (0, 1, 3, 2)
    strided = normal.permute(order).contiguous().permute([order.index(k) for k in range(4)])
    assert torch.equal(strided, normal)
    assert strided.stride(-1) != 1
    view = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    rows, other = (
        lit(
            model,
            rt.GBuffer(normal=n, view=view, mask=mask),
            [rt.DirectionalLight((1, 1, 2))],
            level,
        )
        for n in (normal, strided)
    )
    assert torch.equal(rows, other)
    assert float(rows.max()) > 0


def test_wrong_batches_of_lights_are_one_line(model) -> None:
    lights = rt.DirectionalLight(torch.ones(3, 3))
    with pytest.raises(InputError, match=r"^[^\n]*broadcast[^\n]*$"):
        lit(model, scene(), lights, simd.LEVELS[-1])
    no_position = rt.GBuffer(scene().normal, view=(0.0, 0.0, 1.0))
    with pytest.raises(InputError, match="expected a G-buffer with position"):
        lit(model, no_position, rt.PointLight((0.0, 0.0, 1.0)), simd.LEVELS[-1])
