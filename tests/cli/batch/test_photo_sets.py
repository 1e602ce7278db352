"""`raden capture batch` on simulated photographs: a chrome ball and a matt one under four lamps."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from raden_torch.images.pixels import write_pixels
from raden_torch.interrupts import Interrupted
from raden_torch.writer_lock import writer_lock

SIZE, RADIUS = 80, 30
LAMPS = np.array([[0.4, 0.2, 0.9], [-0.4, 0.2, 0.9], [0.1, -0.5, 0.85], [0.2, 0.5, 0.8]])
DEFAULTS = """
[lights]
photos = "chrome_*.png"
mask = "mask.png"
coded = "linear"
[normals]
photos = "matt_*.png"
lights = "lights.json"
mask = "mask.png"
coded = "linear"
"""


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set whose lamps are known, simulated: mirror images as spots, and Lambert's law."""
    folder = tmp_path_factory.mktemp("photographs")
    y, x = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    inside = np.hypot(x, y) < RADIUS
    z = np.sqrt(np.maximum(RADIUS**2 - x**2 - y**2, 0))
    normal = np.stack([x, -y, z], axis=-1) / RADIUS
    write_pixels((255 * inside).astype(np.uint8), folder / "mask.png")
    for k, lamp in enumerate(LAMPS / np.linalg.norm(LAMPS, axis=1, keepdims=True)):
        half = lamp + np.array([0, 0, 1])
        half /= np.linalg.norm(half)
        spot = np.exp(-(np.hypot(x - RADIUS * half[0], y + RADIUS * half[1]) ** 2) / 4)
        lit = np.clip(normal @ lamp, 0, 1) * inside
        for name, light in {"chrome": spot * inside, "matt": 0.8 * lit}.items():
            rgb = np.rint(65535 * np.repeat(light[..., None], 3, axis=-1)).astype(np.uint16)
            write_pixels(rgb, folder / f"{name}_{k}.png")
    return folder


@pytest.fixture
def sets(photographs: Path, tmp_path: Path) -> Path:
    """Two good ones, b and d; c lacks a photograph, a has a wrong file, e has none."""
    (tmp_path / "defaults.toml").write_text(DEFAULTS)
    for name in "abcde":
        shutil.copytree(photographs, tmp_path / name)
    for name in "bcd":
        (tmp_path / name / "set.toml").touch()
    (tmp_path / "a" / "set.toml").write_text("[light]")
    (tmp_path / "c" / "matt_1.png").unlink()
    (tmp_path / "d" / "set.toml").write_text('[lights]\noutput = "lamps.json"\n[normals]\n')
    with (tmp_path / "d" / "set.toml").open("a") as file:
        file.write('lights = "lamps.json"\nmethod = "least-squares"')
    return tmp_path


def jobs(folder: Path) -> dict[str, dict]:
    found = json.loads((folder / "report.json").read_text("utf-8"))["jobs"]
    return {job["name"]: job for job in found}


def states(folder: Path) -> dict[str, str]:
    return {name: job["state"] for name, job in jobs(folder).items()}


def test_one_failing_set_is_told_and_the_rest_go_on(raden, sets: Path) -> None:
    done = raden("capture", "batch", sets, warn="default")
    assert done.returncode == 2
    assert states(sets) == {"a": "failed", "b": "done", "c": "failed", "d": "done"}
    found = jobs(sets)
    assert "got 'light'; did you mean lights?" in found["a"]["message"]
    assert "expected one lamp per photograph" in found["c"]["message"]
    assert f"raden: {sets / 'e'}: left out, no set.toml\n" in done.stderr
    assert "2 failed, 2 done" in done.stderr.splitlines()[-1]
    text = (sets / "report.txt").read_text("utf-8")
    assert f"c: FAILED: {found['c']['message']}" in text
    lamps = json.loads((sets / "d" / "lamps.json").read_text("utf-8"))["lamps"]
    said = np.array([lamp["direction_to_lamp"] for lamp in lamps])
    expected = LAMPS / np.linalg.norm(LAMPS, axis=1, keepdims=True)
    assert np.rad2deg(np.arccos((said * expected).sum(axis=1))).max() < 1
    normals = json.loads((sets / "d" / "normals" / "normals.json").read_text("utf-8"))
    assert normals["method"] == "least-squares"
    assert not list(sets.glob("*.png"))


@pytest.mark.slow
def test_done_sets_are_skipped_unless_something_changed(raden, sets: Path) -> None:
    """Expected: run again are the set whose photograph is newer, the one that lacks a result, the
    one that failed; with --force all."""
    shutil.rmtree(sets / "a")
    shutil.copy(sets / "b" / "matt_1.png", sets / "c")
    assert raden("capture", "batch", sets, warn="default").returncode == 0
    report = json.loads((sets / "report.json").read_text("utf-8"))
    assert raden("capture", "batch", sets, warn="default").returncode == 0
    assert set(states(sets).values()) == {"skipped"}
    assert jobs(sets)["b"]["text"] == report["jobs"][0]["text"]
    os.utime(sets / "b" / "chrome_0.png")
    shutil.rmtree(sets / "d" / "normals")
    assert raden("capture", "batch", sets, warn="default").returncode == 0
    assert states(sets) == {"b": "done", "c": "skipped", "d": "done"}
    (sets / "c" / "set.toml").write_text("normals = false")
    assert raden("capture", "batch", sets, "--force", warn="default").returncode == 0
    assert states(sets) == {"b": "done", "c": "done", "d": "done"}
    assert jobs(sets)["c"]["outputs"] == ["lights.json"]


def test_an_interrupted_batch_goes_on(raden, sets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in the first of two. Expected: exit code 130, and what was done before stays done."""
    shutil.rmtree(sets / "a")
    shutil.rmtree(sets / "c")
    from raden_torch.capture.photo import capture_normals

    def stop(*_: object, **__: object) -> None:
        raise Interrupted(2)

    def interrupted() -> subprocess.CompletedProcess[str]:
        with monkeypatch.context() as patch:
            patch.setattr(capture_normals, "capture_normals", stop)
            return raden("capture", "batch", sets, warn="default")

    done = interrupted()
    assert (done.returncode, done.stderr.splitlines()[-1]) == (130, "raden: stopped by SIGINT")
    assert states(sets) == {"b": "failed", "d": "not begun"}
    assert raden("capture", "batch", sets, warn="default").returncode == 0
    assert states(sets) == {"b": "done", "d": "done"}
    os.utime(sets / "b" / "matt_0.png")
    assert interrupted().returncode == 130
    assert states(sets) == {"b": "failed", "d": "not begun"}
    assert raden("capture", "batch", sets, warn="default").returncode == 0
    assert states(sets) == {"b": "done", "d": "skipped"}


def test_two_batches_on_one_folder(raden, sets: Path) -> None:
    with writer_lock(sets / "report.lock", 0):
        done = raden("capture", "batch", sets, warn="default")
    assert done.returncode == 2
    assert f"{sets}: expected to be its only writer within 0 s, but process " in done.stderr
    assert not (sets / "report.json").exists()


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("[lights]\nphotos = 3", "photos: expected a pattern or a list of them, got 3"),
        ('[lights]\nphotos = ["none_*.png"]', "photos: expected files as none_*.png, got none"),
        ("[lights]\nmsk = 1", "no such option, did you mean --mask?"),
        ("[lights]\nball_radius = 1979-05-27", "ball_radius: expected a text, a number"),
        ("lights = 1", "lights: expected a table or false, got 1"),
        ("lights = false\nnormals = false", "expected a step of calibrate"),
        ("[lights", "got no valid TOML"),
    ],
)
def test_a_wrong_set_file(raden, sets: Path, file: str, said: str) -> None:
    for name in "acd":
        shutil.rmtree(sets / name)
    (sets / "b" / "set.toml").write_text(file)
    assert raden("capture", "batch", sets, warn="default").returncode == 2
    assert said in jobs(sets)["b"]["message"]
    assert not (sets / "b" / "lights.json").exists()


def test_no_sets_and_no_report(raden, tmp_path: Path) -> None:
    assert "expected folders with a set.toml" in raden("capture", "batch", tmp_path).stderr
    assert "got none" in raden("capture", "batch", tmp_path / "x").stderr
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "set.toml").touch()
    (tmp_path / "report.json").write_text('{"format": "another", "version": 1, "jobs": []}')
    said = raden("capture", "batch", tmp_path)
    assert said.returncode == 2
    assert "report.json: format: expected 'raden_torch batch', got 'another'" in said.stderr
