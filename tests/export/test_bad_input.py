"""Wrong input to `export_onnx` and `verify_onnx`: one line, and nothing half-written."""

from __future__ import annotations

import copy
import errno
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import raden_torch as rt
from raden_torch.errors import InputError
from raden_torch.export import export as export_module
from raden_torch.export.export import export_onnx, verify_onnx


def refused(folder: Path, call: Callable[[], object], *words: str) -> None:
    """The call raises one line with these words and leaves the folder as it was."""
    before = sorted(folder.iterdir())
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message
    assert sorted(folder.iterdir()) == before


def unchecked(path: Path) -> onnx.ModelProto:
    """The graph of a file as it was before the check, without a report."""
    graph = onnx.load(path)
    assert graph.metadata_props[-1].key == "report"
    del graph.metadata_props[-1]
    return graph


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"profile": "forward"}, ("profile: expected", "gbuffer, scene, got 'forward'")),
        ({"output": "albedo"}, ("output: expected", "radiance, brdf, got 'albedo'")),
        (
            {"profile": "scene", "output": "brdf"},
            ("expected radiance from the scene profile", "got 'brdf'"),
        ),
        ({"form": "paper"}, ("form: expected one of runtime, fit, got 'paper'",)),
        ({"opset": 17}, ("opset: expected 18 to 21, got 17",)),
        ({"opset": 99}, ("opset: expected 18 to 21, got 99",)),
    ],
)
def test_options(matt: rt.RadenBrdf, tmp_path: Path, options: dict, words: tuple[str, ...]) -> None:
    refused(tmp_path, lambda: export_onnx(matt, tmp_path / "x.onnx", **options), *words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.half(), ("diffuse.scale", "float16", "model.float()")),
        (lambda m: m.bfloat16(), ("bfloat16",)),
        (lambda m: m.to("meta"), ("expected device cpu, got meta", "model.cpu()")),
        (
            lambda m: m.diffuse.scale.data.fill_(torch.nan),
            ("diffuse.scale: expected finite values",),
        ),
    ],
)
def test_models(matt: rt.RadenBrdf, tmp_path: Path, change: Callable, words: tuple) -> None:
    model = copy.deepcopy(matt)
    change(model)
    refused(tmp_path, lambda: export_onnx(model, tmp_path / "x.onnx"), *words)


def test_paths(matt: rt.RadenBrdf, tmp_path: Path) -> None:
    (tmp_path / "folder.onnx").mkdir()
    refused(
        tmp_path,
        lambda: export_onnx(matt, tmp_path / "folder.onnx"),
        "expected a file name, got a folder",
    )
    refused(
        tmp_path, lambda: export_onnx(matt, tmp_path / "no/x.onnx"), "expected an existing folder"
    )


@pytest.mark.parametrize("package", ["onnxruntime", "onnx", "onnxscript"])
def test_a_package_is_missing(
    matt: rt.RadenBrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    call = lambda: export_onnx(matt, tmp_path / "x.onnx")  # noqa: E731
    refused(tmp_path, call, f"need {package}", "pip install 'raden_torch[export]'")


def test_an_older_torch(
    matt: rt.RadenBrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch, "__version__", "2.10.1+cpu")
    call = lambda: export_onnx(matt, tmp_path / "x.onnx")  # noqa: E731
    refused(tmp_path, call, "expected PyTorch 2.11 or later, got 2.10.1+cpu")


def test_a_disk_that_fills(
    exported: Callable, matt: rt.RadenBrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "x.onnx"
    target.write_bytes(b"an older file")
    graph = unchecked(exported(matt, output="brdf").path)
    monkeypatch.setattr(export_module, "_graph", lambda *_: graph)

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:1000])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left") as error:
        export_onnx(matt, target, output="brdf")
    assert error.value.filename == str(target)
    assert target.read_bytes() == b"an older file"
    assert list(tmp_path.iterdir()) == [target]


def test_a_wrong_picture_is_not_kept(
    exported: Callable, matt: rt.RadenBrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = unchecked(exported(matt, output="brdf").path)
    root = next(node for node in graph.graph.node if node.op_type == "Sqrt")
    root.op_type = "Abs"
    monkeypatch.setattr(export_module, "_graph", lambda *_: graph)
    call = lambda: export_onnx(matt, tmp_path / "x.onnx", output="brdf")  # noqa: E731
    refused(tmp_path, call, "not written", "expected an image within")
    onnx.save(graph, tmp_path / "wrong.onnx")
    refused(tmp_path, lambda: verify_onnx(tmp_path / "wrong.onnx"), "wrong.onnx: onnxruntime")


def test_files_that_are_not_ours(tmp_path: Path) -> None:
    value = [onnx.helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, [1]) for n in "xy"]
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    graph = onnx.helper.make_graph([node], "foreign", value[:1], value[1:])
    onnx.save(onnx.helper.make_model(graph, ir_version=8), tmp_path / "foreign.onnx")
    (tmp_path / "empty.onnx").write_bytes(b"")
    (tmp_path / "text.onnx").write_text("not a model")
    verify = lambda name: lambda: verify_onnx(tmp_path / name)  # noqa: E731
    refused(tmp_path, verify("foreign.onnx"), "foreign.onnx", "expected a shader of raden_torch")
    refused(tmp_path, verify("empty.onnx"), "empty.onnx", "not a valid ONNX file")
    refused(tmp_path, verify("text.onnx"), "text.onnx", "not a valid ONNX file")
    refused(tmp_path, verify("missing.onnx"), "missing.onnx", "No such file")
    refused(tmp_path, lambda: verify_onnx(tmp_path), "got a folder")


def test_damaged_files(exported: Callable, matt: rt.RadenBrdf, tmp_path: Path) -> None:
    whole = exported(matt, output="brdf").path.read_bytes()
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(whole[: len(whole) // 2])
    refused(tmp_path, lambda: verify_onnx(damaged), "damaged.onnx")
    draw = np.random.default_rng(0)
    for place in draw.integers(0, len(whole), 40):
        data = bytearray(whole)
        data[place] ^= 1 << int(draw.integers(0, 8))
        damaged.write_bytes(data)
        # a letter of a text may have changed, which harms nothing
        with suppress(InputError):
            verify_onnx(damaged)


def test_changed_tensors_and_newer_formats(
    exported: Callable, matt: rt.RadenBrdf, tmp_path: Path
) -> None:
    graph = onnx.load(exported(matt, output="brdf").path)
    changed = tmp_path / "changed.onnx"
    for entry in graph.metadata_props:
        if entry.key == "format_version":
            entry.value = "3"
    onnx.save(graph, changed)
    refused(tmp_path, lambda: verify_onnx(changed), "shader format: expected 2, got '3'")
    graph = onnx.load(exported(matt, output="brdf").path)
    for tensor in graph.graph.initializer:
        if tensor.name == "table":
            values = 2 * onnx.numpy_helper.to_array(tensor)
            tensor.CopyFrom(onnx.numpy_helper.from_array(values, "table"))
    onnx.save(graph, changed)
    refused(tmp_path, lambda: verify_onnx(changed), "sha256 differs")
