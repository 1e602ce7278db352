"""Around the GPU kernels, without a GPU: who takes them, what they ask of torch, the benchmarks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

import raden_torch as rt
from raden_torch.brdf.model import kernel, simd

pytest.importorskip("triton", reason="triton is not installed: the GPU kernels are not tested")

ROOT = Path(__file__).resolve().parents[3]


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


def test_a_gpu_without_triton_takes_the_eager_form_and_says_so(monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: "a card")
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: (9, 0))
    monkeypatch.setattr(simd, "_has_triton", lambda: False)
    assert not kernel._runs_on(torch.device("cuda:0"))
    assert "on cuda:0: eager torch: triton 3.9 is not installed (a card)" in simd.system_report()


@pytest.mark.parametrize(
    ("shape", "wide"),
    [((1, 3, 4000, 4000), False), ((1, 3, 40_000, 40_000), True), ((300, 3, 2000, 2000), False)],
)
def test_maps_of_more_than_31_bits_are_counted_in_64(shape, wide) -> None:
    """Of one image: each begins at an offset that has 64 bits in any case."""
    from raden_torch.brdf.model import triton_launch

    large = torch.empty(shape, device="meta")
    assert triton_launch._arranged([large, large])[2] is wide
    one = torch.empty((1, 3, 1, 1), device="meta").expand(shape)
    assert triton_launch._arranged([one, large])[2] is wide


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
def test_the_benchmark_runs_through(tmp_path: Path) -> None:
    """On the CPU: whatever is not a card's own would fail there, too."""
    script = ROOT / "benchmarks" / "gpu.py"
    command = [sys.executable, "-W", "ignore", script, "--smoke", "--runs", "2", "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    report = json.loads((tmp_path / "gpu.json").read_text())
    assert report["errors"]["not finite"] == 0
    assert len(report["times"]) == 2 * (3 + 2) + 1 + 3
    assert all(row["ms"] > 0 for rows in report["times"].values() for row in rows.values())
    assert (tmp_path / "gpu.png").stat().st_size > 10_000


@pytest.mark.slow
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
