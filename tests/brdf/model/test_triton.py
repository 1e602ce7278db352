"""The GPU kernels against float64 and against the CPU kernel.

On a machine without a GPU they run in Triton's interpreter, which has to be asked for before triton
is loaded: `test_in_the_interpreter` runs the others in a process of their own. With
`--device cuda` they run on the GPU.
"""

from __future__ import annotations

import copy
import json
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
from torch.utils._python_dispatch import TorchDispatchMode

import raden_torch as rt
from raden_torch.brdf.model import kernel, simd
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


@pytest.mark.parametrize(("capability", "runs"), [((7, 5), False), ((8, 0), True), ((12, 0), True)])
def test_which_devices_run_them(monkeypatch, capability: tuple[int, int], runs: bool) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    assert simd.triton_runs("cuda:1") is runs
    with simd.using(simd.OFF):
        assert not simd.triton_runs("cuda:1")
    monkeypatch.setattr(simd, "_has_triton", lambda: False)
    assert not simd.triton_runs("cuda:1")


def test_the_choice_is_a_constant_of_compiled_code(monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: (9, 0))

    @torch.compile(backend="eager", fullgraph=True)
    def chosen(x: Tensor) -> Tensor:
        return x + 1 if simd.triton_runs("cuda:0") else x

    assert chosen(torch.zeros(1)) == 1


def test_the_system_report_names_every_gpu(monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: f"card {device[-1]}")
    capability = {"cuda:0": (9, 0), "cuda:1": (7, 0)}
    monkeypatch.setattr(torch.cuda, "get_device_capability", capability.__getitem__)
    report = simd.system_report()
    assert "on cuda:0: Triton kernels (card 0)" in report
    assert (
        "on cuda:1: eager torch: the Triton kernels need CUDA and compute capability 8.0" in report
    )


@pytest.mark.parametrize("name", ["brdf", "brdf_backward", "shade"])
def test_the_operators_have_a_form_for_gpus(name: str) -> None:
    assert torch._C._dispatch_has_kernel_for_dispatch_key(f"raden_torch::{name}", "CUDA")


class _Recorder(TorchDispatchMode):
    """Torch's operators that are called: name, and the kinds of device of their tensors."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple[str, set[str]]] = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        tensors = [a for a in args if isinstance(a, Tensor)]
        self.calls.append((str(func), {t.device.type for t in tensors}))
        return func(*args, **(kwargs or {}))


@torch.no_grad()
def test_shading_what_is_on_the_device_waits_for_nothing(monkeypatch) -> None:
    """As a CUDA graph asks for. The meta device stands for the GPU: it refuses to be read."""
    model = rt.RadenBrdf(None, None)
    table = torch.zeros(*model.layout.shape, 3, device="meta")
    monkeypatch.setattr(kernel, "_runs_on", lambda device: True)
    monkeypatch.setattr(rt.RadenBrdf, "runtime_table", lambda self: table)
    for module, check in (("lights", "_check"), ("gbuffer", "_triple")):
        monkeypatch.setattr(f"raden_torch.brdf.shading.{module}.{check}", lambda *_, **__: None)
    n, three = torch.zeros(1, 3, 8, 8, device="meta"), torch.zeros(3, device="meta")
    lamps = [
        rt.PointLight(three, three),
        rt.SpotLight(three, three, three),
        rt.DirectionalLight(three, three),
    ]
    scene = rt.GBuffer(n, camera=three, position=n, mask=n[:, :1])
    with _Recorder() as recorder:
        assert rt.shade(model, scene, lamps).shape == n.shape
    assert "raden_torch.shade.default" in {name for name, _ in recorder.calls}
    assert not [name for name, kinds in recorder.calls if "cpu" in kinds]


def test_the_benchmark_says_that_there_is_no_gpu() -> None:
    if torch.cuda.is_available():
        pytest.skip("there is one")
    script = ROOT / "benchmarks" / "gpu.py"
    found = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert found.returncode == 2
    assert found.stderr == "gpu: expected an NVIDIA GPU that torch can use, got none\n"


@pytest.mark.slow
@pytest.mark.skipif(INTERPRETED, reason="needs the compiler")
def test_every_kernel_compiles_without_spills() -> None:
    script = ROOT / "benchmarks" / "gpu_compile.py"
    found = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert found.returncode == 0, found.stderr[-2000:]
    report = json.loads((script.parent / "results" / "gpu_compile.json").read_text())
    kernels = {name: row for name, row in report.items() if isinstance(row, dict)}
    assert {name[-5:] for name in kernels} == {"sm_80", "sm_90"}
    for name, row in kernels.items():
        assert row["spilled bytes"] == 0, name
        assert row["accesses"].get("ld 16", 0) in (0, 8), name  # the nodes of the table


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
    maps = maps_of(*[(1, 3, 33, 47)] * 3, device=device)
    change = torch.randn(1, 3, 33, 47, generator=torch.Generator().manual_seed(5)).to(device)
    table, warp = form_on(form, device)
    arguments = (change, [*maps, table], warp, [True] * 4)
    first, second = (launch.brdf_backward(*arguments)[3] for _ in range(2))
    assert torch.equal(first, second)
    exact = gradients(form, maps, change, torch.float64)[3]
    close(first, exact, 1e-5)


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
        "shade": kernel._shade_in_triton,
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
