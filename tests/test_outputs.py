"""No command writes onto its own input, or under a suffix that says something else."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import raden_torch as rt
from raden_torch.cli.common import app, without_other_inputs
from raden_torch.errors import InputError
from raden_torch.files import check_output


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coarse measurement, its model, and a photograph with normals and a mask."""
    path = tmp_path_factory.mktemp("outputs")
    measurement = rt.simulate_specimen("yakogai", step_deg=10.0)
    measurement.save(path / "shell.csv")
    rt.save_model(rt.fit(measurement, interpolation="trilinear").model, path / "m.safetensors")
    pixels = np.full((24, 32, 3), 128, np.uint8)
    cv2.imwrite(str(path / "photo.png"), pixels)
    cv2.imwrite(str(path / "photo16.png"), pixels.astype(np.uint16) * 257)
    cv2.imwrite(str(path / "normals.png"), np.full((24, 32, 3), (255, 128, 128), np.uint8))
    cv2.imwrite(str(path / "mask.png"), np.full((24, 32), 255, np.uint8))
    (path / "link.csv").symlink_to(path / "shell.csv")
    os.link(path / "shell.csv", path / "hard.csv")
    os.link(path / "m.safetensors", path / "hard.onnx")
    os.link(path / "m.safetensors", path / "hard.png")
    os.link(path / "shell.csv", path / "hard.safetensors")
    return path


def refused(folder: Path, *words: str) -> str:
    """The one line with which a command refuses; its inputs are as they were."""
    before = {p: p.read_bytes() for p in folder.iterdir()}
    here = [str(folder / w) if (folder / w).exists() or "." in w[1:] else w for w in words]
    result = CliRunner().invoke(app, here)
    assert isinstance(result.exception, InputError), result.output
    assert {p: p.read_bytes() for p in folder.iterdir()} == before
    message = str(result.exception)
    assert "\n" not in message
    return message


RELIGHT = ("relight", "photo.png", "--normals", "normals.png", "--model", "m.safetensors")


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "shell.csv", "-o", "hard.safetensors"),
        ("merge", "shell.csv", "-o", "shell.csv"),
        ("merge", "shell.csv", "-o", "link.csv"),
        ("merge", "shell.csv", "-o", "hard.csv"),
        ("plot", "m.safetensors", "-o", "hard.png"),
        ("export", "m.safetensors", "-o", "hard.onnx"),
        ("render", "m.safetensors", "-o", "hard.png"),
        (*RELIGHT, "-o", "photo.png"),
        (*RELIGHT, "-o", "normals.png"),
        (*RELIGHT, "--mask", "mask.png", "-o", "mask.png"),
    ],
)
def test_an_input_is_never_overwritten(folder: Path, words: tuple[str, ...]) -> None:
    assert "is also an input" in refused(folder, *words)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("fit", "shell.csv", "-o", "model.csv"), ".safetensors"),
        (("fit", "shell.csv", "-o", "shell.csv"), ".safetensors"),
        (("merge", "shell.csv", "-o", "x.png"), ".csv"),
        (("export", "m.safetensors", "-o", "shell.glsl"), ".onnx"),
        (("export", "m.safetensors", "-o", "page.html"), ".onnx"),
        (("scan", "--simulate", "-o", "x.json"), ".csv"),
    ],
)
def test_a_suffix_that_says_something_else_is_refused(
    folder: Path, words: tuple[str, ...], wanted: str
) -> None:
    message = refused(folder, *words)
    assert f"expected a file name that ends in {wanted}, got {Path(words[-1]).suffix}" in message


def test_the_library_refuses_another_suffix_for_onnx(folder: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.onnx, got \.html"):
        rt.export_onnx(rt.load_model(folder / "m.safetensors"), folder / "page.html")
    assert not (folder / "page.html").exists()


def test_an_older_file_that_is_no_input_may_be_replaced(tmp_path: Path) -> None:
    old, other = tmp_path / "old.csv", tmp_path / "other.csv"
    old.write_text("a")
    other.write_text("a")
    assert check_output(old, (".csv",), inputs=(other, None, tmp_path / "missing")) == old


def test_a_list_leaves_out_what_is_another_input(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = [folder / "photo.png", folder / "mask.png"]
    assert without_other_inputs(photos, folder / "mask.png", None) == [folder / "photo.png"]
    assert "mask.png" in capsys.readouterr().err
    both = folder / "both.exr"  # a picture and its normals in one file
    assert without_other_inputs([both], both) == [both]
    with pytest.raises(InputError, match="expected files besides"):
        without_other_inputs([folder / "mask.png"], folder / "mask.png")


def test_version() -> None:
    result = CliRunner().invoke(app, ["--version"])
    assert result.exit_code == 0
    assert result.output == f"raden {version('raden_torch')}\n"


def test_a_16_bit_photograph_is_relit_and_captioned(folder: Path, tmp_path: Path) -> None:
    words = [str(folder / w) if "." in w else w for w in RELIGHT]
    words[1] = str(folder / "photo16.png")
    out = tmp_path / "relit.png"
    result = CliRunner().invoke(app, [*words, "--light", "1,1,2", "-o", str(out)])
    assert result.exit_code == 0, result.output
    pixels = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
    assert pixels.dtype == np.uint16
    assert pixels.shape == (24, 32, 3)
    assert len(np.unique(pixels[-12:].reshape(-1, 3), axis=0)) > 3  # the caption
