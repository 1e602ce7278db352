"""The `raden` command as a user calls it, on files: each subcommand once as a process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

import raden_torch as rt

Command = Callable[..., subprocess.CompletedProcess[str]]


def process(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
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
    done = process("fit", folder / "shell.csv", "-o", folder / "shell.safetensors")
    assert done.returncode == 0, done.stderr
    assert "12615 measured" in done.stdout
    assert "reciprocity" in done.stdout
    return folder


def test_info_of_both_kinds(raden: Command, shell: Path) -> None:
    measurement = raden("info", shell / "shell.csv").stdout
    assert "simulated" in measurement
    assert "incidence: 0…70 deg by 5, 15 values" in measurement
    model = process("info", shell / "shell.safetensors", "--against", shell / "shell.csv").stdout
    assert "model of yakogai" in model
    assert "12615 readings: RMS 0.000" in model


def test_a_spreadsheets_table_is_read_with_a_word(raden: Command, tmp_path: Path) -> None:
    table = tmp_path / "shell.csv"
    text = "# material: 夜光貝\nIncidence (deg);Receiving (deg);Tilt (deg);X;Y;Z\n1;2;0;1,5;2;3\n"
    table.write_bytes(text.encode("cp932"))
    done = raden("info", table, warn="default")
    assert "measurement of 夜光貝" in done.stdout
    assert done.stderr == (
        f"raden: warning: {table}: read as Shift-JIS, semicolon-separated with decimal commas, "
        "columns Incidence (deg), Receiving (deg), Tilt (deg) as incidence_deg, receiving_deg, "
        "tilt_deg\n"
    )
    table.write_text(text.replace("2;3", "2.0;3"), encoding="utf-8")
    done = raden("info", table, warn="default")
    assert done.returncode == 2
    assert done.stderr == (
        f"raden: {table}: line 3, column X: '1,5' has a decimal comma, '2.0' in line 3, column Y "
        "a decimal point; expected one kind\n"
    )


@pytest.mark.slow
def test_render_takes_light_and_camera(raden: Command, shell: Path) -> None:
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
        render = process if not options else raden
        done = render("render", model, "--shape", "sphere", "--size", 96, "-o", path, *options)
        assert done.returncode == 0, done.stderr
        assert f"wrote {path}" in done.stdout
        pictures.append(cv2.imread(str(path)))
        assert pictures[-1].shape == (96, 96, 3)
        assert pictures[-1].max() > 100
    left, right = pictures[1][:, :48].mean(), pictures[1][:, 48:].mean()
    assert left > 2 * right


@pytest.mark.slow
def test_render_plate_plot_and_relight(raden: Command, shell: Path) -> None:
    model = shell / "shell.safetensors"
    done = raden("render", model, "--shape", "plate", "--size", 64, "-o", shell / "plate.png")
    assert done.returncode == 0, done.stderr
    assert cv2.imread(str(shell / "plate.png")).max() > 100
    for source in ("shell.csv", "shell.safetensors"):
        plot = process if source == "shell.csv" else raden
        done = plot(
            "plot", shell / source, "--figure", "5", "--figure", "path", "-o", shell / "g.png"
        )
        assert done.returncode == 0, done.stderr
        assert min(cv2.imread(str(shell / "g.png")).shape[:2]) > 300
    n = 40
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(1, -1, n))
    inside = x * x + y * y < 0.8
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    normals = (np.stack([z, y, x], axis=-1) + 1) / 2 * 65535 * inside[..., None]
    cv2.imwrite(str(shell / "n.png"), normals.astype(np.uint16))
    cv2.imwrite(str(shell / "m.png"), inside.astype(np.uint8) * 255)
    for name in ("p1.png", "p2.png"):
        cv2.imwrite(str(shell / name), np.full((n, n, 3), 90, np.uint8))
    maps = ("--normals", shell / "n.png", "--mask", shell / "m.png", "--model", model)
    both = (shell / "p1.png", shell / "p2.png")
    done = process("relight", *both, *maps, "--light", "1,0,1", "-o", shell / "relit")
    assert done.returncode == 0, done.stderr
    one, two = (cv2.imread(str(shell / "relit" / p.name)) for p in both)
    assert np.array_equal(one, two)
    assert (one[:30][~inside[:30]] == 90).all()  # above the caption
    assert (
        one[:, n // 2 :][inside[:, n // 2 :]].mean() > one[:, : n // 2][inside[:, : n // 2]].mean()
    )
    done = raden("relight", both[0], *maps, "--strip", "4", "-o", shell / "strip.png")
    assert cv2.imread(str(shell / "strip.png")).shape == (n, 4 * n, 3)
    cv2.imwrite(str(shell / "n.jpg"), (normals / 257).astype(np.uint8))
    jpeg = ("--normals", shell / "n.jpg", "--model", model, "-o", shell / "j.png")
    done = raden("relight", both[0], *jpeg, warn="default")
    assert done.returncode == 0
    assert "raden: warning:" in done.stderr


@pytest.mark.slow
def test_exr_gbuffers(raden: Command, shell: Path, shared: Path) -> None:
    model, folder = shell / "shell.safetensors", shared / "data/gbuffer"
    done = raden("render", model, "--gbuffer", folder / "normals.exr", "-o", shell / "box.exr")
    assert done.returncode == 0, done.stderr
    from raden_torch.brdf.files.exr_tensors import read_colour

    assert read_colour(shell / "box.exr").shape == (1, 3, 64, 64)
    ball = folder / "singlepart.0001.exr"
    done = raden(
        *("relight", ball, "--normals", ball, "--fov", 54, "--model", model),
        *("--light", "1,1,1", "-o", shell / "ball.exr"),
        warn="default",
    )
    assert done.returncode == 0, done.stderr
    before, after = read_colour(ball), read_colour(shell / "ball.exr")
    assert before.shape == after.shape
    assert (after - before).abs().max() > 0.1
    done = raden("render", model, "--gbuffer", folder / "albedo.exr", "-o", shell / "no.png")
    assert done.returncode == 2
    assert "channels B, G, R" in done.stderr


@pytest.mark.slow
def test_depth_along_the_ray_is_the_planar_picture(
    raden: Command, shell: Path, shared: Path
) -> None:
    from raden_torch.brdf.files.exr_tensors import read_colour

    folder, pictures = shared / "data/cases", []
    for name, kind in (("planar", "planar"), ("along_ray", "distance")):
        done = raden(
            *("render", shell / "shell.safetensors", "--gbuffer", folder / f"depth_{name}.exr"),
            *("--fov", 50, "--depth", kind, "-o", shell / f"{name}.exr"),
        )
        assert done.returncode == 0, done.stderr
        pictures.append(read_colour(shell / f"{name}.exr"))
    assert (pictures[0] - pictures[1]).abs().max() < 0.01 * pictures[0].max()


@pytest.mark.slow
def test_demo_makes_a_gallery(tmp_path: Path) -> None:
    done = process("demo", "--out", tmp_path / "gallery", "--size", 128)
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


def test_export_and_verify(raden: Command, shell: Path) -> None:
    made = process("export", shell / "shell.safetensors", "-o", shell / "shell.onnx")
    assert (made.returncode, made.stderr) == (0, "")
    assert f"wrote {shell / 'shell.onnx'}" in made.stdout
    again = process("verify", shell / "shell.onnx")
    assert (again.returncode, again.stderr) == (0, "")
    for report in (made, again):
        assert "gbuffer profile, output radiance" in report.stdout
        assert "onnxruntime" in report.stdout
        assert "same picture" in report.stdout
    wrong = raden("export", shell / "shell.safetensors", "-o", shell / "x.onnx", "--opset", 9)
    assert (wrong.returncode, wrong.stderr.splitlines()) == (
        2,
        ["raden: --opset: expected 18 to 21, got 9"],
    )


BAD = {
    "missing measurement": ("fit", "none.csv", "-o", "m.safetensors"),
    "output folder missing": ("fit", "bad.csv", "-o", "none/m.safetensors"),
    "bad measurement": ("fit", "bad.csv", "-o", "m.safetensors"),
    "half of the diffuse": ("fit", "bad.csv", "-o", "m.safetensors", "--diffuse-scale", "1,1,1"),
    "not a model": ("render", "bad.csv", "-o", "p.png"),
    "no picture suffix": ("render", "bad.csv", "-o", "p.txt"),
    "two numbers": ("render", "bad.csv", "--light", "1,2", "-o", "p.png"),
    "unknown light": ("render", "bad.csv", "--light", "lamp:1,2,3", "-o", "p.png"),
    "exposure": ("render", "bad.csv", "--exposure", "bright", "-o", "p.png"),
    "memory": ("render", "bad.csv", "--gbuffer", "g.exr", "-o", "p.exr", "--memory", "much"),
    "no G-buffer": ("render", "bad.csv", "--gbuffer", "none.exr", "-o", "p.exr"),
    "unknown file": ("info", "none"),
    "score of a measurement": ("info", "bad.csv", "--against", "bad.csv"),
    "gallery is a file": ("demo", "--out", "bad.csv"),
    "plot suffix": ("plot", "bad.csv", "-o", "p.txt"),
    "plot of a bad file": ("plot", "bad.csv", "-o", "p.png"),
    "export of a measurement": ("export", "bad.csv", "-o", "x.onnx"),
    "verify something else": ("verify", "bad.csv"),
    "verify nothing": ("verify", "none.onnx"),
    "relight without normals": (
        *("relight", "bad.csv", "--normals", "n.png", "--model", "m.safetensors", "-o", "p.png"),
    ),
    "strip and light": (
        *("relight", "bad.csv", "--normals", "n.png", "--model", "m.safetensors", "-o", "p.png"),
        *("--strip", "3", "--light", "1,1,1"),
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_exit_code_2(raden: Command, name: str, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("incidence_deg,receiving_deg,tilt_deg,X,Y,Z\n1,2,3,4,5\n")
    done = raden(*BAD[name], cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("raden: ")
    assert len(done.stderr.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize("name", ["bad measurement", "unknown light", "verify nothing"])
def test_a_process_ends_as_the_command_does_in_this_one(
    raden: Command, name: str, tmp_path: Path
) -> None:
    (tmp_path / "bad.csv").write_text("incidence_deg,receiving_deg,tilt_deg,X,Y,Z\n1,2,3,4,5\n")
    alone, here = (run(*BAD[name], cwd=tmp_path) for run in (process, raden))
    assert alone.returncode == here.returncode == 2
    assert (alone.stdout, alone.stderr) == (here.stdout, here.stderr)


def test_what_a_library_in_c_writes_is_caught_too(
    raden: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(arguments: list[str]) -> None:
        os.write(2, b"a library\n")
        print("and Python", file=sys.stderr)
        print("on stdout")
        sys.exit(3)

    monkeypatch.setattr("raden_torch.cli.run", run)
    done = raden("info")
    assert (done.returncode, done.stdout) == (3, "on stdout\n")
    assert done.stderr == "a library\nand Python\n"


@pytest.mark.parametrize(
    "command", ["fit", "info", "plot", "render", "relight", "demo", "export", "verify"]
)
def test_help_has_an_example(command: str) -> None:
    done = process(command, "--help")
    assert done.returncode == 0
    assert f"Example: raden {command}" in done.stdout
