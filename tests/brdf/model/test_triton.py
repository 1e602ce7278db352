"""The GPU kernels against float64 and against the CPU kernel.

On a machine without a GPU they run in Triton's interpreter, which has to be asked for before triton
is loaded: `test_in_the_interpreter` runs the others in a process of their own. With
`--device cuda` they run on the GPU.
"""

from __future__ import annotations

import copy
import math
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.model import kernel, shading_kernel, simd
from raden_torch.brdf.shading.stress_geometries import regions, worst_errors
from raden_torch.geometry import normalised

pytest.importorskip("triton", reason="triton is not installed: the GPU kernels are not tested")

# in NumPy, which the interpreter computes with; on a GPU it is an infinity, and not chosen
pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value", "ignore:divide")

INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
NOISY = {"L near V, too near", "L near V, not unit"}
ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.skipif(INTERPRETED, reason="this is the interpreter")
def test_in_the_interpreter() -> None:
    found = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__],
        env={**os.environ, "TRITON_INTERPRET": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stdout[-4000:] + found.stderr[-2000:]


@pytest.fixture
def launch(device: torch.device) -> Any:
    if not INTERPRETED and device.type != "cuda":
        pytest.skip("no GPU here (--device cuda); test_in_the_interpreter runs this one")
    from raden_torch.brdf.model import triton_launch

    return triton_launch


@pytest.fixture(scope="module", params=["trilinear", "lobes"])
def shell(request: pytest.FixtureRequest) -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai"), interpolation=request.param).model


@pytest.fixture(scope="module")
def form() -> tuple[Tensor, tuple[float, float]]:
    """A small table in which nothing is smooth."""
    generator = torch.Generator().manual_seed(0)
    return torch.rand(5, 9, 7, 3, generator=generator), (0.4, 0.7)


def maps_of(*shapes: tuple[int, ...], device: torch.device, seed: int = 1) -> list[Tensor]:
    """Directions, most of them above a horizon."""
    generator = torch.Generator().manual_seed(seed)
    maps = [torch.randn(shape, generator=generator) for shape in shapes]
    for m in maps:
        m[..., 2, :, :] = m[..., 2, :, :].abs() + 0.3
    return [m.to(device) for m in maps]


def exactly(form: Any, *maps: Tensor) -> Tensor:
    """f_r by the eager form in float64, on the CPU."""
    from raden_torch.brdf.model.runtime_table import read

    table, warp = form
    return read(table.cpu().double(), warp, *(normalised(m.detach().cpu().double()) for m in maps))


def close(found: Tensor, expected: Tensor, share: float = 5e-6) -> None:
    """Within a share of the largest expected value."""
    assert found.dtype == torch.float32
    assert found.shape == expected.shape
    largest = float(expected.abs().max())
    worst = float((found.cpu().double() - expected.double()).abs().max())
    assert worst <= share * largest, (worst, largest)


@torch.no_grad()
def test_error_in_every_region(launch, shell, device) -> None:
    """As of the CPU kernel, tests/brdf/test_stress.py."""
    table, warp = shell.runtime_table().to(device), shell.layout.warp

    def shader(*maps: Tensor) -> Tensor:
        return launch.brdf(*(m.to(device) for m in maps), table, warp).cpu()

    for name, error in worst_errors(shader, shell).items():
        assert error.finite, name
        if name not in NOISY:
            assert error.worst < 5e-6, name


@torch.no_grad()
@pytest.mark.skipif(not INTERPRETED, reason="a GPU rounds as it does")
def test_error_with_the_roundings_of_a_gpu(launch, shell, monkeypatch) -> None:
    """Roots and quotients of a GPU are approximations, 2 units in the last place wrong at most."""
    from triton.runtime.interpreter import InterpreterBuilder, TensorHandle

    generator = np.random.default_rng(0)

    def wrong(exact: Any) -> Any:
        def form(self: Any, *arguments: Any) -> Any:
            found = exact(self, *arguments)
            ulp = np.spacing(np.abs(found.data)) * generator.integers(-2, 3, found.data.shape)
            return TensorHandle((found.data + ulp).astype(found.data.dtype), found.dtype)

        return form

    for name in ("create_fdiv", "create_sqrt", "create_rsqrt"):
        monkeypatch.setattr(InterpreterBuilder, name, wrong(getattr(InterpreterBuilder, name)))
    table, warp = shell.runtime_table(), shell.layout.warp

    def shader(*maps: Tensor) -> Tensor:
        return launch.brdf(*maps, table, warp)

    for name, error in worst_errors(shader, shell, 1000).items():
        assert error.finite, name
        if name not in NOISY:
            assert error.worst < 5e-6, name


@torch.no_grad()
def test_invalid_vectors_give_zero(launch, form, device) -> None:
    good, inf, nan = (0.3, -0.2, 0.9), math.inf, math.nan
    bad = [(0.0, 0.0, 0.0), (nan, 0.0, 1.0), (0.0, inf, 1.0), (-inf, nan, 0.0)]
    triples = [t for b in bad for t in ((b, good, good), (good, b, good), (good, good, b))]
    maps = torch.tensor(triples).permute(1, 2, 0)[:, None, :, :, None].to(device)
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        assert (launch.brdf(*maps.to(dtype).unbind(0), *form_on(form, device)) == 0).all()


def form_on(form: Any, device: torch.device) -> tuple[Tensor, tuple[float, float]]:
    return form[0].to(device), form[1]


LAYOUTS: dict[str, list[tuple[int, ...]]] = {
    "a frame": [(2, 3, 33, 47)] * 3,
    "lights and views of an image": [(2, 3, 33, 47), (2, 3, 1, 1), (1, 3, 1, 1)],
    "a light a row": [(1, 3, 33, 47), (1, 3, 33, 1), (1, 3, 1, 47)],
    "a list": [(1, 3, 1500, 1), (1, 3, 1, 1), (1, 3, 1500, 1)],
    "many images of one pixel": [(700, 3, 1, 1), (1, 3, 1, 1), (700, 3, 1, 1)],
    "without a batch": [(3, 9, 11), (3, 1, 1), (3, 9, 11)],
    "two batches": [(2, 4, 3, 5, 6), (1, 4, 3, 5, 6), (3, 1, 1)],
    "nothing": [(0, 3, 4, 4), (1, 3, 1, 1), (1, 3, 1, 1)],
    "no row": [(1, 3, 0, 4), (1, 3, 1, 1), (1, 3, 1, 1)],
}


@torch.no_grad()
@pytest.mark.parametrize("shapes", LAYOUTS.values(), ids=LAYOUTS)
def test_shapes(launch, form, device, shapes) -> None:
    maps = maps_of(*shapes, device=device)
    found = launch.brdf(*maps, *form_on(form, device))
    assert found.is_contiguous()
    expected = exactly(form, *maps)
    if expected.numel() == 0:
        assert found.shape == expected.shape
    else:
        close(found, expected)


@torch.no_grad()
def test_strides_and_types_are_read_as_they_are(launch, form, device) -> None:
    n, l, v = maps_of(*[(2, 3, 20, 24)] * 3, device=device)  # noqa: E741
    n = n.permute(0, 2, 3, 1).contiguous().permute(0, 3, 1, 2).half()
    l = torch.stack([l, -l], dim=-1)[..., 0].to(torch.bfloat16)  # noqa: E741
    v = v.repeat(1, 1, 2, 1)[:, :, 3:23].transpose(2, 3).contiguous().transpose(2, 3)
    close(launch.brdf(n, l, v, *form_on(form, device)), exactly(form, n, l, v))


@torch.no_grad()
@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_precision_is_finite_everywhere(launch, form, device, half) -> None:
    for name, vectors in regions(200).items():
        f = launch.brdf(*(v.to(device, half) for v in vectors), *form_on(form, device))
        assert f.dtype == torch.float32
        assert torch.isfinite(f).all(), name


def gradients(form: Any, maps: list[Tensor], change: Tensor, dtype: torch.dtype) -> list[Tensor]:
    """By torch's autograd from the eager form: of the maps and the table."""
    from raden_torch.brdf.model.runtime_table import read

    inputs = [x.detach().cpu().to(dtype).requires_grad_() for x in (*maps, form[0])]
    full = torch.broadcast_tensors(*(normalised(m) for m in inputs[:3]))
    f = read(inputs[3], form[1], *full)
    return list(torch.autograd.grad(f, inputs, change.cpu().to(dtype)))


@pytest.mark.parametrize("shapes", [LAYOUTS["a frame"], LAYOUTS["lights and views of an image"]])
def test_gradient_is_that_of_the_eager_form(launch, form, device, shapes) -> None:
    maps = maps_of(*shapes, device=device)
    change = torch.randn(2, 3, 33, 47, generator=torch.Generator().manual_seed(5)).to(device)
    exact = gradients(form, maps, change, torch.float64)
    single = gradients(form, maps, change, torch.float32)
    table, warp = form_on(form, device)
    found = launch.brdf_backward(change, [*maps, table], warp, [True] * 4)
    for f, e, s in zip(found, exact, single, strict=True):
        assert f.shape == e.shape
        scale, error = e.abs().max(), (f.cpu() - e).abs()
        # where a pixel lies on a node in one precision it may lie beside it in the other
        assert error.quantile(0.99) <= 2 * (s - e).abs().quantile(0.99) + 1e-6 * scale
        assert error.mean() <= 2 * (s - e).abs().mean() + 1e-6 * scale


@pytest.mark.parametrize("wanted", [(1, 0, 0, 0), (0, 1, 1, 0), (0, 0, 0, 1), (1, 0, 0, 1)])
def test_only_what_is_wanted(launch, form, device, wanted) -> None:
    maps = maps_of(*[(1, 3, 9, 11)] * 3, device=device)
    table, warp = form_on(form, device)
    change = torch.ones(1, 3, 9, 11, device=device)
    everything = launch.brdf_backward(change, [*maps, table], warp, [True] * 4)
    found = launch.brdf_backward(change, [*maps, table], warp, [bool(w) for w in wanted])
    expected = [g for g, w in zip(everything, wanted, strict=True) if w]
    for f, e in zip(found, expected, strict=True):
        torch.testing.assert_close(f, e)


def test_gradients_are_finite_in_every_region(launch, form, device) -> None:
    table, warp = form_on(form, device)
    for name, vectors in regions(300).items():
        maps = [v.float().to(device) for v in vectors]
        change = torch.ones(torch.broadcast_shapes(*(m.shape for m in maps)), device=device)
        for g in launch.brdf_backward(change, [*maps, table], warp, [True] * 4):
            assert torch.isfinite(g).all(), name


@pytest.fixture
def deterministic() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


def test_the_tables_gradient_is_the_same_bits_where_torch_is_deterministic(
    launch, form, device, deterministic
) -> None:
    """In any order of the pixels, so in any order in which a GPU takes them."""
    maps = maps_of(*[(1, 3, 33, 47)] * 3, device=device)
    change = torch.randn(1, 3, 33, 47, generator=torch.Generator().manual_seed(5)).to(device)
    table, warp = form_on(form, device)
    order = torch.randperm(33 * 47, generator=torch.Generator().manual_seed(6)).to(device)
    shuffled = [m.flatten(2)[..., order].view(m.shape) for m in (change, *maps)]
    found, again = (
        launch.brdf_backward(one[0], [*one[1:], table], warp, [False, False, False, True])[0]
        for one in ([change, *maps], shuffled)
    )
    assert torch.equal(found, again)
    exact = gradients(form, maps, change, torch.float64)[3]
    close(found, exact, 1e-6)
    for size in (1e30, 1e-30):
        scaled = launch.brdf_backward(size * change, [*maps, table], warp, [False] * 3 + [True])[0]
        close((scaled.double() / size).float(), exact, 1e-6)
    for change_of, expected in ((0.0, 0.0), (math.nan, math.nan)):
        given = torch.full_like(change, change_of)
        some = launch.brdf_backward(given, [*maps, table], warp, [False] * 3 + [True])[0]
        assert torch.equal(some.nan_to_num(7.0), torch.full_like(some, expected).nan_to_num(7.0))


def lights_of(count: int) -> list[Any]:
    kinds = [
        rt.DirectionalLight((0.3, 0.2, 1.0), (3.0, 2.0, 1.0)),
        rt.PointLight((0.5, 0.5, 2.0), (1.0, 2.0, 3.0)),
        rt.SpotLight((0.0, 0.3, 1.5), (0.1, 0.0, 0.0), (2.0, 2.0, 2.0), inner_deg=5, outer_deg=20),
        rt.PointLight((0.2, 0.1, 0.0)),  # in the surface
        rt.DirectionalLight((0.0, 0.0, -1.0)),  # from behind
    ]
    return kinds[:count]


@pytest.fixture
def as_operators(launch, device, monkeypatch) -> Iterator[list[str]]:
    """Torch's operators by the GPU's kernels, in the interpreter those of the CPU; which ran."""
    ran: list[str] = []
    one = launch._launch
    monkeypatch.setattr(
        launch, "_launch", lambda name, *a, **k: (ran.append(name), one(name, *a, **k))
    )
    if device.type == "cuda":
        yield ran
        return
    library = torch.library.Library("raden_torch", "IMPL", "CPU")
    by_name = {
        "brdf": kernel._brdf_in_triton,
        "shade": shading_kernel._shade_in_triton,
        "brdf_backward": kernel._brdf_backward_in_triton,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a kernel is overridden
        for name, form in by_name.items():
            library.impl(name, form, allow_override=True)
    yield ran
    library._destroy()


def scene(device: torch.device, mask: Tensor | None, **view: Any) -> rt.GBuffer:
    y, x = torch.meshgrid(torch.linspace(-1, 1, 37), torch.linspace(-1, 1, 41), indexing="ij")
    normal = torch.stack([0.3 * torch.sin(9 * x), 0.3 * torch.sin(8 * y + x), 0.6 + 0.5 * y])[None]
    normal[..., 3, 3] = math.nan
    position = torch.stack([x, y, 0.05 * x * y])[None]
    maps = {"normal": normal.expand(2, -1, -1, -1), "position": position, "mask": mask}
    return rt.GBuffer(**{k: None if m is None else m.to(device) for k, m in maps.items()}, **view)


def a_mask() -> Tensor:
    mask = torch.rand(2, 1, 37, 41, generator=torch.Generator().manual_seed(2)) * 1.4 - 0.2
    mask[0, 0, 5, 6] = math.nan
    mask[1, 0, 20:] = 0
    return mask


@torch.no_grad()
@pytest.mark.parametrize("lights", [0, 1, 5])
@pytest.mark.parametrize(
    ("masked", "camera", "leaning"),
    [
        *((False, False, False), (True, False, False), (False, True, False), (True, True, False)),
        *((False, False, True), (True, True, True)),
    ],
)
def test_shade(as_operators, shell_on, device, lights, masked, camera, leaning) -> None:
    model, on_device = shell_on
    view = {"camera": (0.1, -0.2, 3.0)} if camera else {"view": (0.1, 0.1, 1.0)}
    if leaning:
        view["layer_normal"] = scene(device, None, view=(0, 0, 1)).normal[:1].flip(3).to(device)
    mask = a_mask() if masked else None
    lamps = lights_of(lights)
    with simd.using(simd.OFF):
        exact = rt.shade(model.double(), _double(scene(torch.device("cpu"), mask, **view)), lamps)
    found = rt.shade(on_device, scene(device, mask, **view), lamps)
    assert as_operators == ["shade"]
    assert torch.isfinite(found).all()
    if lights == 0:
        assert found.shape == exact.shape
        assert (found == 0).all()
    else:
        assert exact.max() > 0
        close(found, exact)


@torch.no_grad()
@pytest.mark.parametrize(("tolerance", "used"), [(0.0, False), (1e-4, False), (0.02, True)])
def test_lamps_are_left_out_within_the_tolerance(
    as_operators, shell_on, device, tolerance, used
) -> None:
    """As tests/brdf/shading/test_tolerance.py asks of the CPU kernel."""
    model, on_device = shell_on
    generator = torch.Generator().manual_seed(3)
    lamps = [
        rt.PointLight(40 * torch.rand(3, generator=generator) + torch.tensor([-20.0, -20.0, 0.5]))
        for _ in range(12)
    ]
    lamps = [*lamps, *lights_of(3), rt.DirectionalLight((0.0, 0.1, 1.0), 1e-3)]
    gbuffer = scene(device, None, view=(0.1, 0.1, 1.0))
    with simd.using(simd.OFF):
        exact = rt.shade(model.double(), _double(scene(torch.device("cpu"), None,
                                                       view=(0.1, 0.1, 1.0))), lamps)  # fmt: skip
    found = rt.shade(on_device, gbuffer, lamps, tolerance=tolerance)
    assert as_operators == ["shade"]
    off = (found.cpu() - exact).abs().amax()
    assert off <= tolerance + 5e-6 * exact.max()
    assert (off > 5e-6 * exact.max()) == used


def _double(gbuffer: rt.GBuffer) -> rt.GBuffer:
    maps = {name: m.double() if isinstance(m, Tensor) else m for name, m in vars(gbuffer).items()}
    return rt.GBuffer(**maps)


@pytest.fixture(scope="module")
def fitted() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("yakogai"), interpolation="trilinear").model


@pytest.fixture
def shell_on(fitted, device: torch.device) -> tuple[rt.RadenBrdf, rt.RadenBrdf]:
    """The model, and another one of the same on the device."""
    return copy.deepcopy(fitted), copy.deepcopy(fitted).to(device)


def test_training_through_the_model(as_operators, shell_on, device) -> None:
    """Normals, table and diffuse part, through torch's autograd and the bake."""
    model, on_device = shell_on
    maps = maps_of(*[(1, 3, 20, 20)] * 3, device=torch.device("cpu"))

    def step(of: rt.RadenBrdf, dtype: torch.dtype, where: torch.device) -> list[Tensor]:
        n, l, v = (m.detach().clone().to(where, dtype) for m in maps)  # noqa: E741
        n.requires_grad_()
        of(n, l, v).square().sum().backward()
        return [g.grad.cpu() for g in (n, *of.parameters())]

    found = step(on_device, torch.float32, device)
    assert as_operators == ["reflect", "differentiate"]
    exact = step(model.double(), torch.float64, torch.device("cpu"))
    for f, e in zip(found, exact, strict=True):
        error = (f - e).abs()
        assert error.quantile(0.99) <= 1e-4 * e.abs().max()


@torch.no_grad()
def test_rows_of_an_index_beyond_32_bits(launch, form, device, monkeypatch) -> None:
    """The 64-bit form, on a small map."""
    monkeypatch.setattr(launch, "_INT32", 0)
    n, l, v = maps_of(*[(2, 3, 9, 11)] * 3, device=device)  # noqa: E741
    l = l.transpose(2, 3).contiguous().transpose(2, 3)  # noqa: E741
    maps = (n, l, v)
    close(launch.brdf(*maps, *form_on(form, device)), exactly(form, *maps))
