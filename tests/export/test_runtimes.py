"""The exported file in the programs that will run it: one picture in all of them."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import onnx
import pytest

import raden_torch as rt
from raden_torch.export.check import ExportReport, StressSet
from raden_torch.export.constants import fix_parameters, is_fixed
from raden_torch.export.export import verify_onnx
from raden_torch.export.forms import form_of
from raden_torch.export.runtimes import Runtime, SkippedRuntime, load_others
from raden_torch.export.workers.worker import PROGRAMS, Worker, WorkerError

INSTALLED = Path(__file__).resolve().parents[2] / "runtimes"
"""What `make runtimes` installed."""
OLD = INSTALLED / "onnxruntime-1.18/bin/python"
NAMES = ["OpenVINO", "OpenCV dnn", "onnxruntime (onnxruntime-1.18)", "onnxruntime-node"]
NAMES += ["onnxruntime-web"]
PROFILES = {
    "gbuffer": {},
    "fixed": {"fixed": True},
    "brdf": {"output": "brdf"},
    "scene": {"profile": "scene"},
    "fit": {"form": "fit"},
}


@pytest.fixture(scope="module")
def report(exported: Callable, shell: rt.RadenBrdf) -> Callable[[str], ExportReport]:
    made: dict[str, ExportReport] = {}

    def verified(name: str) -> ExportReport:
        if name not in made:
            path = exported(shell, **PROFILES[name]).path
            made[name] = verify_onnx(path, node_modules=INSTALLED / "node_modules", pythons=[OLD])
        return made[name]

    return verified


@pytest.mark.slow
@pytest.mark.parametrize("runtime", NAMES)
@pytest.mark.parametrize("profile", PROFILES)
def test_every_runtime_gives_the_same_picture(
    report: Callable[[str], ExportReport], profile: str, runtime: str
) -> None:
    result = next(r for r in report(profile).runtimes if r.name == runtime)
    if result.status == "skipped" and "installed" in result.reason:
        required = os.environ.get("RADEN_TORCH_REQUIRED_RUNTIMES", "").split()
        assert runtime not in required, result.reason
        pytest.skip(result.reason)
    if result.status == "skipped" and str(OLD) in result.reason:
        pytest.skip(result.reason)
    assert result.status == "same picture", result.reason
    assert sum(region.pixels for region in result.regions.values()) > 1000


def test_another_python_is_asked_for_its_own_picture(
    exported: Callable, shell: rt.RadenBrdf
) -> None:
    """This Python, as if it were another: the conversation, with nothing installed."""
    data = exported(shell).path.read_bytes()
    others = load_others(data, pythons=[Path(sys.executable)])
    runtime = next(r for r in others if r.name.startswith("onnxruntime ("))
    assert isinstance(runtime, Runtime)
    result = StressSet(form_of(shell, "runtime"), "gbuffer", "radiance").run(runtime)
    assert (result.status, result.reason) == ("same picture", "")


def test_a_worker_says_what_is_wrong(exported: Callable, shell: rt.RadenBrdf) -> None:
    command = [sys.executable, str(PROGRAMS / "other_python.py")]
    with pytest.raises(WorkerError, match="InvalidProtobuf"):
        Worker(command, {"model.onnx": b"not a model"})
    with pytest.raises(WorkerError, match="missing"):
        Worker([str(PROGRAMS / "missing")], {})
    with pytest.raises(WorkerError, match="ended"):
        Worker([sys.executable, "-c", "print('hello')"], {})
    worker = Worker(command, {"model.onnx": exported(shell).path.read_bytes()})
    try:
        with pytest.raises(WorkerError, match="normal"):
            worker.run({"light": np.ones((1, 3, 1, 1), np.float32)})
        up = np.float32([0, 0, 1]).reshape(1, 3, 1, 1)
        output, times = worker.timed({"normal": up, "light": up, "view": up}, 3)
    finally:
        worker.close()
    assert output.shape == (1, 3, 1, 1)
    assert output.min() > 0.1
    assert len(times) == 3
    assert min(times) > 0


def test_what_is_not_installed_is_skipped_with_a_reason(tmp_path: Path) -> None:
    def reasons(found: Sequence[Runtime | SkippedRuntime]) -> dict[str, str]:
        return {r.name: r.reason for r in found if isinstance(r, SkippedRuntime)}

    found = reasons(list(load_others(b"", node_modules=tmp_path, pythons=[tmp_path / "a/b/c"])))
    assert "No such file" in found["onnxruntime (a)"]
    assert "installed" in found["onnxruntime-node"]
    assert "installed" in found["onnxruntime-web"]


def test_a_fixed_file_keeps_only_what_is_no_parameter(
    exported: Callable, shell: rt.RadenBrdf
) -> None:
    free = exported(shell)
    fixed = exported(shell, fixed=True)
    graph = onnx.load(fixed.path)
    assert is_fixed(graph)
    assert not is_fixed(onnx.load(free.path))
    names = {port.name for port in graph.graph.input}
    assert names == {"normal", "light", "view", "mask", "irradiance", "exposure"}
    assert abs(fixed.report.bytes - free.report.bytes) < 2000
    assert fix_parameters(onnx.load(free.path)).graph.input == graph.graph.input
    assert fix_parameters(onnx.ModelProto()) == onnx.ModelProto()
