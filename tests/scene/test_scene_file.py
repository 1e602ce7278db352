"""Scene files that are wrong: one line each that says what, where, and what would be right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cyclopts import CycloptsError
from PIL import Image

from raden_torch.cli import run
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.pixels import read_image, write_pixels
from raden_torch.scene.scene import Scene

Writer = Callable[..., Path]

ROOM = '[lights.environment]\nbuiltin = "room"\n'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("samples = 2", "sample = 2", "did you mean samples"),
        ("[camera]", "[camra]", "did you mean camera"),
        ("position = [1.5, 3.7, 5.6]", "position = [1.5, 3.7]", "camera.position: expected 3"),
        ("position = [1.5, 3.7, 5.6]", "position = [0.1, 0.2, 0.0]", "outside of the box"),
        ("target = [0.05, 0.36, 0.0]", "target = [1.5, 3.7, 5.6]", "a target other than"),
        ('artwork = "none"', 'artwork = "makei"', "one of makie, none"),
        ('artwork = "none"', 'ground = "blck"', "did you mean black"),
        ('artwork = "none"', "rounding = 2.0", "rounding"),
        ('builtin = "room"', 'file = "nowhere.hdr"', "nowhere.hdr"),
        (ROOM, "", "lights: expected at least one"),
        ("exposure = 0.0", "exposure = nan", "exposure"),
    ],
)
def test_a_wrong_scene_is_one_line(scene_file: Writer, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        Scene.read(scene_file((old, new)))._box  # noqa: B018
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('[[materials]]\nname = "a"\n', "expected one of model, shell"),
        ('[[materials]]\nname = "a"\nshell = "oyster"\n', "expected one of yakogai"),
        ('[[materials]]\nname = "a"\nshell = "akoya"\ntablets = [1.1, 1.0]\n', "rising numbers"),
        ('[[materials]]\nname = "a"\nmetal = "gold"\n' * 2, "'a' twice"),
        ('[[layers]]\nmaterial = "yakogia"\nmask = "m.png"\n', "did you mean yakogai"),
        (
            "[[lights.point]]\norbit = {}\nkeyframes = [{ frame = 1, position = [0, 1, 0] }]\n",
            "lights.point[0]",
        ),
    ],
)
def test_wrong_materials_layers_and_lamps(scene_file: Writer, more: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        Scene.read(scene_file(more=more))
    assert said in str(caught.value)


def test_a_map_of_another_size(scene_file: Writer, tmp_path: Path) -> None:
    write_pixels(np.full((20, 30), 255, np.uint8), tmp_path / "m.png")
    write_pixels(np.full((20, 31), 255, np.uint8), tmp_path / "n.png")
    layer = '[[layers]]\nmaterial = "vermilion"\nmask = "{}"\n'
    path = scene_file(more=layer.format("m.png") + layer.format("n.png"))
    with pytest.raises(InputError, match=r"n\.png: expected 30 x 20 pixels, as .*, got 31 x 20"):
        Scene.read(path).frame()


@pytest.mark.parametrize("value", [np.nan, -1.0, np.inf])
def test_an_environment_that_is_no_light(scene_file: Writer, tmp_path: Path, value: float) -> None:
    grey = np.full((8, 16), 0.5, np.float32)
    wrong = grey.copy()
    wrong[3, 5] = value
    write_channels(tmp_path / "room.exr", {"R": grey, "G": wrong, "B": grey})
    path = scene_file(('builtin = "room"', 'file = "room.exr"'))
    with pytest.raises(InputError, match="channel G, row 3, column 5"):
        Scene.read(path).frame()


def test_paths_start_at_the_scene_s_folder(
    scene_file: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_channels(tmp_path / "room.exr", {c: np.full((8, 16), 0.5, np.float32) for c in "RGB"})
    path = scene_file(('builtin = "room"', 'file = "room.exr"'))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert Scene.read(path).frame().mean() > 0.01


def test_the_command_line(scene_file: Writer, tmp_path: Path) -> None:
    scene, frames = str(scene_file()), tmp_path / "frames"

    def render(*words: str) -> None:
        run(["render", scene, *words])

    render("-o", str(tmp_path / "a.exr"))
    assert (tmp_path / "a.exr").stat().st_size > 1000
    render("-o", str(frames), "--frames", "1-2")
    first = (frames / "frame_0001.png").stat().st_mtime_ns
    render("-o", str(frames), "--frames", "1-3")
    assert (frames / "frame_0003.png").exists()
    assert (frames / "frame_0001.png").stat().st_mtime_ns == first
    with pytest.raises(SystemExit) as ended:  # pictures of another size are not kept
        render("-o", str(frames), "--frames", "1-3", "--size", "48")
    assert ended.value.code == 3
    assert (frames / "frame_0001.png").stat().st_mtime_ns == first
    render("-o", str(frames), "--frames", "1", "--size", "48", "--force")
    assert read_image(frames / "frame_0001.png").pixels.shape == (27, 48, 3)
    for words in (["--light", "1,1,1"], ["--force"], ["--frames", "0-2"], ["--json"]):
        with pytest.raises((InputError, CycloptsError)):
            render("-o", str(tmp_path / "a.png"), *words)
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize("name", ["a.mp4", "a.webm", "a.webp"])
def test_moving_pictures(scene_file: Writer, tmp_path: Path, name: str) -> None:
    import cv2

    path = tmp_path / name
    scene = scene_file(('artwork = "none"', 'artwork = "none"\nturn_deg = 90.0'))
    run(["render", str(scene), "-o", str(path), "--frames", "1-3"])
    if name.endswith("webp"):
        with Image.open(path) as image:
            assert (image.n_frames, image.size) == (3, (96, 54))
        return
    film = cv2.VideoCapture(str(path))
    read = [film.read() for _ in range(4)]
    assert [ok for ok, _ in read] == [True, True, True, False]
    assert np.abs(read[0][1].astype(float) - read[2][1]).mean() > 1  # it turned
