"""`raden capture lights`, `capture normals` and `relight` on the shared photographs, as a user
calls them; and what a person may do wrong."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from raden_torch.brdf.files.image_file import read_normal_map
from raden_torch.capture.photo.capture_normals import capture_normals
from raden_torch.errors import InputError

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def showing(raden: Command) -> Command:
    """The command with its warnings shown."""
    return lambda *arguments: raden(*arguments, warn="default")


def process(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "default", "-m", "raden_torch.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
    )


def photos(shared: Path, name: str) -> list[Path]:
    return [shared / "data/photometric_stereo" / f"{name}.{k}.png" for k in range(12)]


@pytest.fixture(scope="module")
def lights(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("capture") / "lights.json"
    mask = shared / "data/photometric_stereo/chrome.mask.png"
    done = process(
        *("capture", "lights", *photos(shared, "chrome"), "--mask", mask),
        *("--coded", "linear", "-o", path),
    )
    assert done.returncode == 0, done.stderr
    assert "deg from the camera's axis" in done.stdout
    assert min(cv2.imread(str(path.with_suffix(".png"))).shape[:2]) > 300
    return path


@pytest.mark.slow
def test_photographs_to_a_relit_picture(
    showing: Command, shared: Path, lights: Path, tmp_path: Path
) -> None:
    import raden_torch as rt

    folder = shared / "data/photometric_stereo"
    mask = folder / "buddha.mask.png"
    done = process(
        *("capture", "normals", *photos(shared, "buddha"), "--lights", lights),
        *("--mask", mask, "--coded", "linear", "-o", tmp_path / "b"),
    )
    assert done.returncode == 0, done.stderr
    assert "buddha.2.png: it disagrees" in done.stderr
    result = json.loads((tmp_path / "b/normals.json").read_text("utf-8"))
    assert result["kind"] == "normals"
    assert len(result["lamps"]) == 12
    png, exr = (read_normal_map(tmp_path / "b" / f"normals.{s}") for s in ("png", "exr"))
    assert (png - exr).abs().max() < 1e-4
    assert cv2.imread(str(tmp_path / "b/normals.png"), cv2.IMREAD_UNCHANGED).dtype == np.uint16
    for name in ("albedo.png", "confidence.png", "found.png"):
        assert cv2.imread(str(tmp_path / "b" / name)).max() > 100
    model = tmp_path / "shell.safetensors"
    rt.save_model(rt.fit(rt.simulate_specimen("yakogai"), interpolation="trilinear").model, model)
    maps = ("--normals", tmp_path / "b/normals.png", "--mask", mask, "--model", model, "--linear")
    original = ("--original-light", tmp_path / "b/normals.json")
    sheet = tmp_path / "sheet.png"
    done = process("relight", folder / "buddha.3.png", *maps, *original, "--sheet", 12, "-o", sheet)
    assert done.returncode == 0, done.stderr
    height, width = cv2.imread(str(sheet)).shape[:2]
    assert height % 3 == 0
    assert width % 4 == 0
    assert cv2.imread(str(sheet)).mean() > 20
    done = showing("relight", folder / "gray.3.png", *maps, *original, "-o", tmp_path / "no.png")
    assert done.returncode == 2
    assert "expected one of its photographs, got gray.3.png" in done.stderr


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*photograph 1, but lamp 1")
def test_what_a_person_may_do_wrong(
    showing: Command, shared: Path, lights: Path, tmp_path: Path
) -> None:
    folder = shared / "data/photometric_stereo"
    grey = photos(shared, "gray")
    mask = ("--mask", folder / "gray.mask.png", "--coded", "linear", "-o", tmp_path / "out")
    burnt, small = tmp_path / "burnt.png", tmp_path / "small.png"
    cv2.imwrite(str(burnt), np.full((340, 512, 3), 255, np.uint8))
    cv2.imwrite(str(small), np.full((34, 51, 3), 80, np.uint8))
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((340, 512, 3), np.uint8))
    cases = (
        (grey[::-1], "another order than the lamps"),
        (grey[:5], "got 12 lamps for 5 photographs"),
        ([burnt] * 12, "burnt.png: over-exposed"),
        ([*grey[:11], small], "small.png: expected photographs of one size, got 51 x 34"),
        ([*grey[:11], black], "black.png: the object is black"),
    )
    for given, message in cases:
        with pytest.raises(InputError, match=message):
            capture_normals(given, lights, folder / "gray.mask.png", coded="linear")
    done = showing("capture", "normals", *cases[0][0], "--lights", lights, *mask)
    assert done.returncode == 2
    assert cases[0][1] in done.stderr
    assert not (tmp_path / "out").exists()
    stand = tmp_path / "stand.png"
    shutil.copy(folder / "buddha.mask.png", stand)
    done = showing(
        *("capture", "lights", *photos(shared, "chrome")[:3], "--mask", stand),
        *("-o", tmp_path / "l.json"),
    )
    assert done.returncode == 2
    assert "stand.png: not round" in done.stderr
    assert not (tmp_path / "l.json").exists()
