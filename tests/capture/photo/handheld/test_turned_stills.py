"""Pictures that EXIF, or a video's header, turns by 90 or 180 degrees: one sensor took them all."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from raden_torch.capture.exchange import load_measurement
from raden_torch.capture.photo.camera import read_camera, read_poses
from raden_torch.capture.photo.capture_handheld import Handheld, capture_handheld
from raden_torch.capture.photo.handheld.footage import clips_of, in_one_frame, pictures
from raden_torch.capture.photo.handheld.handheld_file import (
    HandheldPaths,
    next_command,
    write_handheld,
)
from tests.capture.photo.handheld.conftest import Footage, setup

Command = Callable[..., subprocess.CompletedProcess[str]]


def tagged(source: Path, target: Path, orientation: int) -> Path:
    """The same JPEG, its pixels as they are, with an orientation in its EXIF."""
    exif = Image.Exif()
    exif[274] = orientation
    block = exif.tobytes()
    data, length = source.read_bytes(), (len(block) + 2).to_bytes(2, "big")
    target.write_bytes(data[:2] + b"\xff\xe1" + length + block + data[2:])
    return target


def turned(footage: Footage, folder: Path, orientations: Sequence[int]) -> Path:
    """The stills of the footage, with these orientations in turn."""
    folder.mkdir()
    for k, path in enumerate(sorted(footage.paths[1].iterdir())):
        tagged(path, folder / path.name, orientations[k % len(orientations)])
    return folder


@pytest.fixture(scope="module")
def upright(footage: Footage, tmp_path_factory: pytest.TempPathFactory) -> Handheld:
    folder = tmp_path_factory.mktemp("upright") / "stills"
    return capture_handheld([turned(footage, folder, (1,))], setup(photographs=12))


@pytest.mark.slow
@pytest.mark.parametrize("orientations", [(1, 3), (1, 6, 8, 3)])
def test_the_sensor_has_one_lens(
    footage: Footage, upright: Handheld, tmp_path: Path, orientations: tuple[int, ...]
) -> None:
    """Rationale: the stored pixels are the same, so camera and lamp are, but for OpenCV's
    rounding, which is not the same in every run. Read as EXIF turns them, the principal point was
    3 px and the lamp 5 mm elsewhere."""
    found = capture_handheld(
        [turned(footage, tmp_path / "stills", orientations)], setup(photographs=12)
    )
    np.testing.assert_allclose(found.camera.matrix, upright.camera.matrix, atol=1e-4)
    np.testing.assert_allclose(found.camera.distortion, upright.camera.distortion, atol=1e-6)
    np.testing.assert_allclose(found.lamps[0].at_m, upright.lamps[0].at_m, atol=1e-6)
    (note,) = (note for note in found.notes if "another orientation" in note)
    assert note.startswith("still001.jpg … (")
    assert note.endswith("turned by EXIF's orientation 1")
    assert not any("another orientation" in note for note in upright.notes)


@pytest.mark.slow
def test_the_measurement_is_the_same(
    footage: Footage, upright: Handheld, raden: Command, tmp_path: Path
) -> None:
    """Rationale: `capture brdf` reads each still as the camera file says."""
    mixed = capture_handheld(
        [turned(footage, tmp_path / "stills", (1, 3, 6))], setup(photographs=12)
    )
    values = []
    for name, found in (("upright", upright), ("mixed", mixed)):
        paths = HandheldPaths(tmp_path / name)
        photographs = write_handheld(found, paths.folder)
        line = next_command(found, paths, photographs, None, "90").replace("\\\n", " ")
        words = shlex.split(line)
        words[words.index("shell.csv")] = str(tmp_path / f"{name}.csv")
        made = raden(*words[1:], "--go-on", warn="default")
        assert made.returncode == 0, made.stderr
        values.append(load_measurement(tmp_path / f"{name}.csv").values)
    np.testing.assert_allclose(*values, rtol=1e-4)
    said = {pose.orientation for pose in read_poses(tmp_path / "mixed/camera.json")[1].values()}
    assert said == {1}
    said = {pose.orientation for pose in read_poses(tmp_path / "upright/camera.json")[1].values()}
    assert said == {None}


@pytest.mark.slow
def test_a_camera_file_says_its_orientation(
    footage: Footage, upright: Handheld, tmp_path: Path
) -> None:
    """All stills the other way than those of the calibration: they are brought to these."""
    write_handheld(upright, tmp_path / "first")
    camera = tmp_path / "first/camera.json"
    assert read_camera(camera).orientation == 1
    stills = turned(footage, tmp_path / "stills", (3,))
    found = capture_handheld([stills], setup(camera=camera, photographs=12))
    np.testing.assert_allclose(found.lamps[0].at_m, upright.lamps[0].at_m, atol=1e-6)
    content = json.loads(camera.read_text())
    content["orientation"] = 9
    camera.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="orientation"):
        read_camera(camera)


@pytest.mark.slow
def test_calibrate_has_one_frame(footage: Footage, raden: Command, tmp_path: Path) -> None:
    cameras = []
    for name, orientations in (("upright", (1,)), ("mixed", (1, 3, 8))):
        stills = sorted(turned(footage, tmp_path / name, orientations).iterdir())[:8]
        made = raden(
            "capture", "calibrate", *stills, "--squares", "11x9", "--square", "0.016", "--marker",
            "0.012", "-o", tmp_path / f"{name}.json",
        )  # fmt: skip
        assert made.returncode == 0, made.stderr
        assert ("still001.jpg: EXIF says another" in made.stdout) == (name == "mixed")
        cameras.append(read_camera(tmp_path / f"{name}.json"))
    np.testing.assert_allclose(cameras[0].matrix, cameras[1].matrix, atol=1e-4)
    assert cameras[1].size == (540, 960)
    poses = read_poses(tmp_path / "mixed.json")[1].values()
    assert {pose.orientation for pose in poses} == {1}


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_video_is_turned_as_its_header_says(tmp_path: Path, degrees: int) -> None:
    """Two films of the same pixels, whose headers turn them differently, come as one sensor has
    them: turned as the first."""
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:16, :24] = 220
    plain = tmp_path / "plain.mp4"
    film = cv2.VideoWriter(str(plain), cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48))
    for _ in range(3):
        film.write(picture)
    film.release()
    other = shutil.copy(plain, tmp_path / "other.mp4")
    data = bytearray(other.read_bytes())
    matrix = data.index(b"tkhd") + 44  # version 0: 40 bytes of it before its matrix
    cosine, sine = round(np.cos(np.radians(degrees))), round(np.sin(np.radians(degrees)))
    for place, value in ((0, cosine), (4, sine), (12, -sine), (16, cosine)):
        data[matrix + place : matrix + place + 4] = (value << 16).to_bytes(4, "big", signed=True)
    other.write_bytes(data)
    own = next(pictures(clips_of([other])[0], 0))
    assert own.pixels.shape[:2] == ((64, 48) if degrees in (90, 270) else (48, 64))
    first, second = in_one_frame(clips_of([plain, other]), None)
    a, b = next(pictures(first, 0)), next(pictures(second, 1))
    np.testing.assert_array_equal(a.pixels, b.pixels)
    assert (a.other_way, b.other_way) == (False, degrees != 0)
    assert abs(a.pixels[:12, :20].astype(int) - 220).max() < 8
