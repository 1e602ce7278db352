"""A session in other processes, and inputs that are not as usual."""

from __future__ import annotations

import os
import pickle
import signal
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.errors import InputError

pytest.importorskip("onnxruntime")

from raden_torch.export.shader_session import ShaderSession

UP = np.zeros((1, 3, 4, 5), np.float32) + np.array([0, 0, 1], np.float32)[:, None, None]
MAPS = {"light": UP, "view": UP}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("session") / "matt.onnx"
    model = rt.RadenBrdf(CosineDiffuse(torch.full((3,), 0.25), torch.full((3,), 1.0)), None)
    rt.export_onnx(model, path)
    return path


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork is POSIX's")
def test_a_forked_child_computes(file: Path) -> None:
    session = ShaderSession(file, threads=2)
    expected = session.run(normal=UP, **MAPS)
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # ends it where it waits for threads that it does not have
        os._exit(0 if np.array_equal(session.run(normal=UP, **MAPS), expected) else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_pickled_session_computes(file: Path) -> None:
    session = ShaderSession(file, tile=7, threads=1)
    again = pickle.loads(pickle.dumps(session))
    np.testing.assert_array_equal(again.run(normal=UP, **MAPS), session.run(normal=UP, **MAPS))


@pytest.mark.parametrize(
    ("normal", "message"),
    [
        ("x", "normal: expected numbers"),
        (UP * 1j, "normal: expected numbers, got complex"),
        (torch.from_numpy(UP).requires_grad_(), "normal: .*detach"),
        ([[1], [1, 2]], "normal"),
    ],
    ids=["text", "complex", "gradient", "ragged"],
)
def test_inputs_that_are_no_real_arrays(file: Path, normal: object, message: str) -> None:
    session = ShaderSession(file, threads=1)
    with pytest.raises(InputError, match=message):
        session.run(normal=normal, **MAPS)


@pytest.mark.parametrize("option", [{"threads": -1}, {"tile": 1.5}, {"tile": "x"}, {"tile": 0}])
def test_options_out_of_range(file: Path, option: dict[str, object]) -> None:
    with pytest.raises(InputError, match="ShaderSession"):
        ShaderSession(file, **option)


def test_texts_that_are_damaged(file: Path, capfd: pytest.CaptureFixture[str]) -> None:
    import onnx

    graph = onnx.load(file)
    for entry in graph.metadata_props:
        if entry.key == "parameters":
            entry.value = "{"
    for data in (graph.SerializeToString(), file.read_bytes().replace(b"normal", b"\xc7ormal")):
        with pytest.raises(InputError, match=r"ShaderSession|onnxruntime"):
            ShaderSession(data)
    assert "EP Error" not in capfd.readouterr().out
