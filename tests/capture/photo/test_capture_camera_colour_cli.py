"""`raden capture calibrate` and `colour` as a user calls them, on files; once as a process."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.board import Board
from raden_torch.capture.photo.capture_colour import capture_colour
from raden_torch.capture.photo.development import Development
from raden_torch.errors import InputError
from tests.dng import mosaic_of

BOARD = ("--squares", "5x7", "--square", "0.04", "--marker", "0.02")


Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def capture(raden: Command) -> Command:
    return lambda *arguments: raden("capture", *arguments)


def process(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "raden_torch.cli", "capture", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.mark.slow
def test_calibrate(capture: Command, board_scene: Callable, tmp_path: Path) -> None:
    places = [
        ((0.5, 0.1, 0.1), (-0.12, -0.1, 0.5)),
        ((-0.5, 0.2, -0.2), (-0.08, -0.16, 0.5)),
        ((0.1, 0.55, 0.4), (0.0, -0.15, 0.45)),
        ((0.1, -0.6, 1.5), (0.16, -0.1, 0.5)),
    ]
    photos = []
    for i, place in enumerate(places):
        photos.append(tmp_path / f"{i}.png")
        cv2.imwrite(str(photos[-1]), board_scene(Board(5, 7, 0.04, 0.02), *place, seed=i))
    output = tmp_path / "camera.json"
    done = process("calibrate", *photos, *BOARD, "-o", output)
    assert done.returncode == 0, done.stderr
    assert "3.png: 24 corners" in done.stdout
    result = json.loads(output.read_text())
    assert result["camera_matrix_px"][0][0] == pytest.approx(620, rel=0.01)
    assert result["board"]["legacy"] is False
    assert len(result["poses"]) == 4
    assert "orientation" not in result  # the files state none
    assert cv2.imread(str(tmp_path / "camera.png")).shape[1] == 1280
    # and the next step reads it
    again = capture(
        "calibrate", photos[0], *BOARD, "--camera", output, "-o", tmp_path / "pose.json"
    )
    assert again.returncode == 0, again.stderr
    pose = json.loads((tmp_path / "pose.json").read_text())["poses"][0]
    np.testing.assert_allclose(pose["translation_board_to_camera_m"], places[0][1], atol=0.006)


def test_calibrate_without_boards(capture: Command, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((200, 300, 3), 90, np.uint8))
    done = capture("calibrate", tmp_path / "a.png", *BOARD, "-o", tmp_path / "c.json")
    assert done.returncode == 2
    assert "photographs that show the board: expected at least 3, got 0 of 1" in done.stderr
    assert "a.png: expected a 5 x 7 board" in done.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "a.png"]


@pytest.mark.slow
def test_colour(chart_scene: Callable, tmp_path: Path) -> None:
    scene = chart_scene(turn_deg=70, mirrored=True, noise=0.002)
    linear = np.clip(np.rint(scene.linear * 65535), 0, 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.tiff"), linear[..., ::-1])
    output = tmp_path / "colour.json"
    done = process("colour", tmp_path / "a.tiff", "--coded", "linear", "-o", output)
    assert done.returncode == 0, done.stderr
    assert "the chart is mirrored" in done.stdout
    result = json.loads(output.read_text())
    assert result["chart_mirrored"] is True
    assert result["mean_delta_e_2000"] < 1.5
    assert cv2.imread(str(tmp_path / "colour.png")).shape[1] == 640
    # the same file taken as sRGB: said to be not linear
    text = capture_colour([tmp_path / "a.tiff"], output)
    assert "the photograph is not linear" in text


@pytest.mark.slow
def test_colour_of_a_stack_of_mosaics(
    capture: Command, chart_scene: Callable, tmp_path: Path
) -> None:
    """No pattern is stated: the greens are found in the mosaic, red and blue by the chart."""
    scene = chart_scene(noise=0.0, exposure=1.0)
    mosaic = mosaic_of(scene.linear, "BGGR")
    rng = np.random.default_rng(6)
    files, times = [], []
    for seconds in (0.25, 1.0, 4.0):
        noisy = mosaic * 0.5 * seconds + 0.002 * rng.normal(size=mosaic.shape)
        stored = np.clip(np.rint(noisy * 65535), 0, 65535).astype(np.uint16)
        files.append(tmp_path / f"{seconds}.tiff")
        cv2.imwrite(str(files[-1]), stored)
        times += ["--exposure", seconds]
    done = capture("colour", *files, *times, "-o", tmp_path / "colour.json")
    assert done.returncode == 0, done.stderr
    assert "Bayer pattern BGGR" in done.stdout
    assert "median deviation" in done.stdout
    assert json.loads((tmp_path / "colour.json").read_text())["mean_delta_e_2000"] < 2
    with pytest.raises(InputError, match=r"0\.25\.tiff: no exposure time in its EXIF"):
        capture_colour(files, tmp_path / "c.json", development=Development(pattern="BGGR"))


def test_colour_without_a_chart(capture: Command, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((200, 300, 3), 90, np.uint8))
    done = capture("colour", tmp_path / "a.png", "-o", tmp_path / "c.json")
    assert done.returncode == 2
    assert "a.png: expected a ColorChecker Classic" in done.stderr
    cv2.imwrite(str(tmp_path / "b.jpg"), np.full((200, 300, 3), 255, np.uint8))
    for name, how, message in (
        ("b.jpg", Development(), r"b\.jpg: over-exposed, 100 %"),
        ("b.jpg", Development(coded="linear"), r"b\.jpg: a JPEG is never linear"),
        (
            "a.png",
            Development(exposures_s=(1.0, 2.0)),
            "exposure times: expected none, or one for each of 1 photographs, got 2",
        ),
    ):
        with pytest.raises(InputError, match=message):
            capture_colour([tmp_path / name], tmp_path / "c.json", development=how)
    with pytest.raises(InputError, match="2014 or 2005"):
        capture_colour([tmp_path / "a.png"], tmp_path / "c.json", edition="1999")
    with pytest.raises(InputError, match=r"expected a file name that ends in \.json, got \.toml"):
        capture_colour([tmp_path / "a.png"], tmp_path / "c.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.jpg"]
