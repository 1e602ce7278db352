"""The `raden` command as a user calls it: as a process, on files."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import cv2
import pytest

import raden_torch as rt


def raden(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "raden_torch.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
    )


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a measurement and the model that `raden fit` made of it."""
    folder = tmp_path_factory.mktemp("cli")
    rt.simulate_specimen("yakogai").save(folder / "shell.csv")
    done = raden("fit", folder / "shell.csv", "-o", folder / "shell.safetensors")
    assert done.returncode == 0, done.stderr
    assert "12615 measured" in done.stdout
    assert "reciprocity" in done.stdout
    return folder


def test_info_of_both_kinds(shell: Path) -> None:
    measurement = raden("info", shell / "shell.csv").stdout
    assert "simulated" in measurement
    assert "incidence: 0…70 deg by 5, 15 values" in measurement
    model = raden("info", shell / "shell.safetensors", "--against", shell / "shell.csv").stdout
    assert "model of yakogai" in model
    assert "12615 readings: RMS 0.00000" in model


@pytest.mark.slow
def test_render_takes_light_and_camera(shell: Path) -> None:
    pictures = []
    for i, options in enumerate(
        (
            [],
            ["--light", "-1,0,1", "--exposure", "0"],
            ["--light", "point:2,2,2", "--camera", "3,0,5", "--light", "0,1,1"],
        )
    ):
        path = shell / f"{i}.png"
        model = shell / "shell.safetensors"
        done = raden("render", model, "--shape", "sphere", "--size", 96, "-o", path, *options)
        assert done.returncode == 0, done.stderr
        assert f"wrote {path}" in done.stdout
        pictures.append(cv2.imread(str(path)))
        assert pictures[-1].shape == (96, 96, 3)
        assert pictures[-1].max() > 100
    left, right = pictures[1][:, :48].mean(), pictures[1][:, 48:].mean()
    assert left > 2 * right


@pytest.mark.slow
def test_demo_makes_a_gallery(tmp_path: Path) -> None:
    done = raden("demo", "--out", tmp_path / "gallery", "--size", 128)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "gallery/index.html").read_text("utf-8")
    shown: list[str] = []

    class Pictures(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            shown.extend(v or "" for k, v in attrs if (tag, k) in {("img", "src"), ("a", "href")})

    Pictures().feed(page)
    assert len(shown) >= 4
    assert all((tmp_path / "gallery" / name).stat().st_size > 0 for name in shown)
    assert "simulated" in page
    assert rt.load_model(tmp_path / "gallery/shell.safetensors").provenance.simulated


BAD = {
    "missing measurement": ("fit", "none.csv", "-o", "m.safetensors"),
    "output folder missing": ("fit", "bad.csv", "-o", "none/m.safetensors"),
    "output is a folder": ("fit", "bad.csv", "-o", "."),
    "bad measurement": ("fit", "bad.csv", "-o", "m.safetensors"),
    "half of the diffuse": ("fit", "bad.csv", "-o", "m.safetensors", "--diffuse-scale", "1,1,1"),
    "not a model": ("render", "bad.csv", "-o", "p.png"),
    "no picture suffix": ("render", "bad.csv", "-o", "p.txt"),
    "two numbers": ("render", "bad.csv", "--light", "1,2", "-o", "p.png"),
    "unknown light": ("render", "bad.csv", "--light", "lamp:1,2,3", "-o", "p.png"),
    "exposure": ("render", "bad.csv", "--exposure", "bright", "-o", "p.png"),
    "unknown file": ("info", "none"),
    "score of a measurement": ("info", "bad.csv", "--against", "bad.csv"),
    "gallery is a file": ("demo", "--out", "bad.csv"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_exit_code_2(name: str, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("incidence_deg,receiving_deg,tilt_deg,X,Y,Z\n1,2,3,4,5\n")
    done = raden(*BAD[name], cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("raden: ")
    assert len(done.stderr.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize("command", ["fit", "info", "render", "demo"])
def test_help_has_an_example(command: str) -> None:
    done = raden(command, "--help")
    assert done.returncode == 0
    assert f"Example: raden {command}" in done.stdout
