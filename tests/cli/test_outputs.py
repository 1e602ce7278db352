"""No command writes onto its own input, or under a suffix that says something else."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
import pytest

import raden_torch as rt
from raden_torch.cli.status import without_other_inputs
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs, written_beside
from raden_torch.images.exr import write_channels

Command = Callable[..., subprocess.CompletedProcess[str]]


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


@pytest.fixture
def refused(raden: Command, folder: Path) -> Callable[..., str]:
    """The one line with which a command refuses; its inputs are as they were."""

    def line(*words: str) -> str:
        before = {p: p.read_bytes() for p in folder.iterdir()}
        here = [str(folder / w) if (folder / w).exists() or "." in w[1:] else w for w in words]
        done = raden(*here)
        assert done.returncode == 2, done.stderr
        assert {p: p.read_bytes() for p in folder.iterdir()} == before
        assert done.stderr.count("\n") == 1
        return done.stderr

    return line


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
def test_an_input_is_never_overwritten(refused: Callable[..., str], words: tuple[str, ...]) -> None:
    assert "is also an input" in refused(*words)


_SHADERS = ".onnx or .glsl or .wgsl or .html or .gltf or .osl or .xml or .bsdf or .mtlx"


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("fit", "shell.csv", "-o", "model.csv"), ".safetensors"),
        (("fit", "shell.csv", "-o", "shell.csv"), ".safetensors"),
        (("merge", "shell.csv", "-o", "x.png"), ".csv"),
        (("export", "m.safetensors", "-o", "shell.hlsl"), _SHADERS),
        (("export", "m.safetensors", "-o", "page.htm"), _SHADERS),
        (("scan", "--simulate", "-o", "x.json"), ".csv"),
    ],
)
def test_a_suffix_that_says_something_else_is_refused(
    refused: Callable[..., str], words: tuple[str, ...], wanted: str
) -> None:
    message = refused(*words)
    assert f"expected a file name that ends in {wanted}, got {Path(words[-1]).suffix}" in message


def test_the_library_refuses_another_suffix_for_onnx(folder: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.onnx, got \.html"):
        rt.export_onnx(rt.load_model(folder / "m.safetensors"), folder / "page.html")
    assert not (folder / "page.html").exists()


def test_the_library_refuses_another_suffix(folder: Path, tmp_path: Path) -> None:
    measurement = rt.load_measurement(folder / "shell.csv")
    model = rt.load_model(folder / "m.safetensors")
    for write, name, wanted in (
        (lambda path: rt.save_model(model, path), "x.csv", ".safetensors"),
        (measurement.save, "x.safetensors", ".csv"),
        (lambda path: write_channels(path, {"Z": np.ones((2, 2))}), "x.png", ".exr"),
    ):
        with pytest.raises(InputError, match=f"ends in {wanted}, got {Path(name).suffix}"):
            write(tmp_path / name)
    assert not list(tmp_path.iterdir())


CAPTURE = ("--squares", "7x5", "--square", "0.012", "--marker", "0.009")


@pytest.mark.parametrize(
    "words",
    [
        # the picture beside the result would be the photograph
        ("capture", "calibrate", "photo.png", *CAPTURE, "-o", "photo.json"),
        ("capture", "colour", "photo.png", "-o", "photo.json"),
        ("capture", "colour", "photo16.png", "-o", "c.json", "--picture", "photo16.png"),
        ("capture", "lights", "photo.png", "--mask", "mask.png", "-o", "mask.json"),
        *(
            ("capture", "brdf", "photo.png", "--lights", "l.json", "--shape", "sphere", *more)
            for more in (("-o", "photo.csv"), ("--dark", "photo16.png", "-o", "photo16.csv"))
        ),
        ("capture", "brdf", "photo.png", "--lights", "l.json", "--shape", "plane", "-o", "l.csv"),
        ("capture", "normals", "photo.png", "--lights", "maps/normals.json", "-o", "maps"),
        ("capture", "normals", "maps/found.png", "--lights", "l.json", "-o", "maps"),
        ("bench", "--measurement", "maps/bench.json", "--readings", "shell.csv", "--out", "maps"),
        # a link in the folder leads back to a photograph, or to the model
        (*RELIGHT, "-o", "maps"),
        (*RELIGHT[:2], "photo16.png", *RELIGHT[2:], "-o", "linked"),
    ],
)
def test_what_is_written_beside_is_an_output_too(
    raden: Command, folder: Path, words: tuple[str, ...]
) -> None:
    for name in ("maps", "linked"):
        (folder / name).mkdir(exist_ok=True)
    (folder / "l.json").write_text("{}")
    shutil.copy(folder / "shell.csv", folder / "maps/bench.json")
    for name in ("maps/found.png", "maps/normals.json"):
        (folder / name).write_text("kept")
    for link, to in (("maps/photo.png", "photo.png"), ("linked/photo16.png", "m.safetensors")):
        (folder / link).unlink(missing_ok=True)
        (folder / link).symlink_to(folder / to)
    kept = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    done = raden(*(folder / w if is_path(w) else w for w in words))
    assert done.returncode == 2
    assert "is also an input" in done.stderr
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == kept


def is_path(word: str) -> bool:
    return word in ("maps", "linked") or word.endswith((".png", ".csv", ".json", ".safetensors"))


def test_a_rig_s_white_is_an_input_of_the_scan(raden: Command, tmp_path: Path) -> None:
    rt.simulate_specimen("yakogai", step_deg=35.0).save(tmp_path / "tile.csv")
    rig = (Path(__file__).parents[2] / "docs/rig.md").read_text().split("```toml\n")[1]
    rig = rig.split("```")[0].replace("# file =", "file =").replace("reflectance_factor", "# ")
    (tmp_path / "rig.toml").write_text(rig.replace("[45, 0, 0]", "[35, 0, 0]"))
    before = (tmp_path / "tile.csv").read_bytes()
    done = raden("scan", "--config", tmp_path / "rig.toml", "-o", tmp_path / "tile.csv")
    assert done.returncode == 2
    assert "tile.csv: is also an input" in done.stderr
    assert (tmp_path / "tile.csv").read_bytes() == before


def test_two_outputs_are_two_files(tmp_path: Path) -> None:
    first, second = tmp_path / "a.json", tmp_path / "a.png"
    check_outputs(first, second)
    second.symlink_to(first)  # which need not be there
    with pytest.raises(InputError, match=r"a\.png: is also the output .*a\.json; expected another"):
        check_outputs(first, second)


def test_an_output_that_is_a_link_stays_one(tmp_path: Path) -> None:
    """The file behind it is replaced; under a second name (a hard link) the old content stays."""
    (tmp_path / "far").mkdir()
    real, link, other = tmp_path / "far/data.bin", tmp_path / "out.csv", tmp_path / "hard"
    real.write_text("older")
    os.link(real, other)
    link.symlink_to(real)
    measurement = rt.simulate_specimen("yakogai", step_deg=35.0)
    measurement.save(link)
    assert link.is_symlink()
    assert rt.load_measurement(real) == measurement
    assert other.read_text() == "older"
    real.unlink()
    measurement.save(link)  # it leads to where a file may be made
    assert link.is_symlink()
    assert rt.load_measurement(real) == measurement
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["data.bin", "far", "hard", "out.csv"]


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    lost, loop = tmp_path / "lost.csv", tmp_path / "loop.csv"
    lost.symlink_to(tmp_path / "nowhere" / "x.csv")
    loop.symlink_to(loop)
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "null.csv").symlink_to("/dev/null")
    for path, wanted in (
        (lost, "expected an existing folder, got "),
        (loop, "a link that leads back to itself"),
        (tmp_path / "pipe.csv", "expected a file to write, got a device or a pipe"),
        (tmp_path / "null.csv", "expected a file to write, got a device or a pipe"),
        (tmp_path, "expected a file name, got a folder"),
    ):
        with pytest.raises(InputError, match=wanted), written_beside(path):
            pytest.fail("nothing is written")


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


def test_version(raden: Command) -> None:
    done = raden("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"raden {version('raden_torch')}\n"


def test_a_16_bit_photograph_is_relit_and_captioned(
    raden: Command, folder: Path, tmp_path: Path
) -> None:
    words = [str(folder / w) if "." in w else w for w in RELIGHT]
    words[1] = str(folder / "photo16.png")
    out = tmp_path / "relit.png"
    done = raden(*words, "--light", "1,1,2", "-o", out)
    assert done.returncode == 0, done.stderr
    pixels = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
    assert pixels.dtype == np.uint16
    assert pixels.shape == (24, 32, 3)
    assert len(np.unique(pixels[-12:].reshape(-1, 3), axis=0)) > 3  # the caption
