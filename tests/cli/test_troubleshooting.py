"""The tables of docs/troubleshooting.md: each mistake gets the message that the page shows.

A row begins with a command, or with Python, in backticks; its second cell is what is said. `…` in a
message stands for anything, and words after the backticks say what was left out. The files that the
rows name are made here.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

import raden_torch as rt
from raden_torch.brdf.fitting.fit import FitResult
from raden_torch.images.exr import write_channels

Command = Callable[..., subprocess.CompletedProcess[str]]

PAGE = Path(__file__).parents[2] / "docs/troubleshooting.md"
ROW = re.compile(r"^\| `(?P<said>[^`]+)`(?P<note>[^|]*)\| (?P<message>.+?) \| (?P<cure>.+) \|$")
NAMES = "incidence_deg,receiving_deg,tilt_deg,X,Y,Z\n"


def rows() -> list[re.Match[str]]:
    """Those of all tables, in order."""
    found = (ROW.match(line) for line in PAGE.read_text("utf-8").splitlines())
    return [row for row in found if row]


COMMANDS = [row for row in rows() if row["said"].startswith("raden ")]
PYTHON = [row for row in rows() if not row["said"].startswith("raden ")]


@pytest.fixture(scope="module")
def result() -> FitResult:
    return rt.fit(rt.simulate_specimen("yakogai", step_deg=35.0), interpolation="trilinear")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, result: FitResult) -> Path:
    """What a newcomer may have at hand."""
    path = tmp_path_factory.mktemp("newcomer")
    _write_measurements(path)
    _write_images(path)
    rt.save_model(result.model, path / "shell.safetensors")
    whole = (path / "shell.safetensors").read_bytes()
    (path / "half.safetensors").write_bytes(whole[: len(whole) * 3 // 4])
    save_file({"weight": torch.ones(3)}, path / "network.safetensors")
    torch.save({"weight": torch.ones(3)}, path / "network.pt")
    (path / "scene.toml").write_text("[camera\nfov_deg = 30\n")
    for name in ("folder", "locked"):
        (path / name).mkdir()
    (path / "locked").chmod(0o555)
    return path


def _write_measurements(path: Path) -> None:
    rt.simulate_specimen("yakogai", step_deg=35.0, noise=0.01).save(path / "shell.csv")
    plain = rt.simulate_specimen("yakogai", step_deg=35.0)
    plain.save(path / "no_std.csv")
    readings = np.column_stack([plain.angles_deg, plain.values])
    of_angles, plane = readings[:, :3], readings[readings[:, 2] == 0]

    def write(name: str, values: Any, names: str = NAMES) -> None:
        lines = (",".join(f"{value:.6g}" for value in row) for row in values)
        (path / name).write_text(names + "\n".join(lines) + "\n")

    write("radians.csv", np.column_stack([np.deg2rad(of_angles), plain.values]))
    write("steep.csv", readings + np.array([60, 0, 0, 0, 0, 0]))
    write("plane.csv", plane)
    write("no_tilt.csv", plane[:, [0, 1, 3, 4, 5]], "incidence_deg,receiving_deg,X,Y,Z\n")
    write("no_unit.csv", readings, "incidence,receiving,tilt,X,Y,Z\n")
    write("no_names.csv", readings.round(3), "")
    write("twice.csv", np.vstack([readings[:3], readings[:1] * [1, 1, 1, 2, 2, 2]]))
    (path / "empty.csv").write_text("")
    (path / "names_only.csv").write_text(NAMES)
    (path / "error.csv").write_text(NAMES + "10,20,0,#N/A,43.6,47.2\n")
    (path / "commas.csv").write_text(NAMES + "10,0,20,0,0,0,41,5,43,6,47,2\n")
    (path / "notes.txt").write_text("Measured on Tuesday.\n")
    text = (path / "shell.csv").read_text()
    (path / "windows.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    german = plane[:, :6].copy()
    lines = (";".join(f"{value:.6g}".replace(".", ",") for value in row) for row in german)
    (path / "german.csv").write_text(NAMES.replace(",", ";") + "\n".join(lines) + "\n")


def _write_images(path: Path) -> None:
    grey = np.full((24, 32, 3), 128, np.uint8)
    cv2.imwrite(str(path / "photo.png"), grey)
    cv2.imwrite(str(path / "large.png"), grey.repeat(2, 0).repeat(2, 1))
    cv2.imwrite(str(path / "normals.png"), np.full((24, 32, 3), (255, 128, 128), np.uint8))
    cv2.imwrite(str(path / "small_mask.png"), np.full((12, 16), 255, np.uint8))
    cv2.imwrite(str(path / "ball.png"), np.full((24, 32), 255, np.uint8))
    one = np.ones((24, 32), np.float32)
    write_channels(path / "beauty.exr", {"R": one, "G": one, "B": one})
    write_channels(path / "depth.exr", {"Z": one * 5})


def shown(cell: str) -> re.Pattern[str]:
    """The message of a cell, in which … stands for anything."""
    text = cell.strip("` ").replace(r"\|", "|")
    return re.compile(".*".join(map(re.escape, re.split(r"\s*…\s*", text))), re.DOTALL)


def test_the_page_has_forty_mistakes() -> None:
    assert len(COMMANDS) + len(PYTHON) >= 40
    lines = [line for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `")]
    assert len(lines) == len(rows())  # none that this test does not read
    for row in rows():
        assert len(row["message"].replace("…", "")) > 10, row["said"]


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row["said"])
def test_a_command_says_what_the_page_shows(
    raden: Command, folder: Path, row: re.Match[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", _as_a_user)
    if "not installed" in row["note"]:
        for name in row["note"].split("(")[1].split()[0].split(","):
            monkeypatch.setitem(sys.modules, name, None)
    before = sorted(folder.rglob("*"))
    words = [word.strip("'") for word in row["said"].split()[1:]]
    done = raden(*words, cwd=folder, warn="default")
    message = done.stderr.strip()
    assert shown(row["message"]).fullmatch(message), message
    if "warning:" in message.splitlines()[-1]:
        assert done.returncode == 0
        (folder / words[-1]).unlink(missing_ok=True)
    else:
        assert done.returncode == 2
        assert done.stdout == ""
    assert sorted(folder.rglob("*")) == before


def _as_a_user(path: Any, mode: int) -> bool:
    """Whether the owner may; the superuser, who may run the tests, may write everywhere."""
    return not (mode & os.W_OK) or bool(os.stat(path).st_mode & 0o200)


@pytest.mark.parametrize("row", PYTHON, ids=lambda row: row["said"])
def test_python_says_what_the_page_shows(
    folder: Path, result: FitResult, row: re.Match[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, 8, 8)
    names = {
        "rt": rt,
        "torch": torch,
        "normal": up,
        "view": up,
        "measurement": rt.load_measurement("shell.csv"),
        "model": result.model,
        "result": result,
        "gbuffer": rt.GBuffer(up, (0, 0, 1)),
        "lamp": rt.DirectionalLight((1, 1, 2)),
    }
    before = sorted(folder.rglob("*"))
    with (
        torch.no_grad() if "no_grad" in row["note"] else torch.enable_grad(),
        pytest.raises((ValueError, RuntimeError)) as caught,
    ):
        eval(row["said"], names)
    text = " ".join(str(caught.value).split())
    assert shown(row["message"]).fullmatch(text), text
    assert sorted(folder.rglob("*")) == before
