"""`raden capture handheld` on simulated footage, to a measurement."""

from __future__ import annotations

import json
import shlex
import subprocess
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement
from raden_torch.capture.photo.camera import read_camera, read_poses
from raden_torch.capture.photo.capture_handheld import Handheld, capture_handheld
from raden_torch.capture.photo.handheld.handheld_file import (
    HandheldPaths,
    check_folder,
    write_handheld,
)
from raden_torch.capture.photo.lamps import read_lamps
from raden_torch.errors import InputError
from tests.capture.photo.brdf.conftest import node_truth
from tests.capture.photo.handheld.conftest import (
    BALL,
    FLASH_M,
    GREY_M,
    LAMPS_M,
    Footage,
    setup,
)
from tests.capture.photo.handheld.simulated_scene import (
    GREYS,
    Phone,
    Scene,
    auto_gains,
    hand_path,
    inverse_tone_curve,
    patches,
    write_stills,
)

pytestmark = pytest.mark.slow
Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def found(footage: Footage) -> Handheld:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return capture_handheld(footage.paths, setup(photographs=30, every=1))


def direction_off_deg(found: np.ndarray, true: tuple[float, ...]) -> float:
    a, b = (np.asarray(v) - [0.082, 0.071, 0.0] for v in (found, true))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def test_camera_lamps_and_curve_are_found(found: Handheld, phone: Phone) -> None:
    assert len(found.chosen) == 30
    assert {found.looked_at[k].clip for k in found.chosen} == {0, 1}
    focal = np.diag(found.camera.matrix)[:2] / np.diag(phone.matrix)[:2]
    np.testing.assert_allclose(focal, 1, atol=0.005)
    for lamp, true in zip(found.lamps, LAMPS_M, strict=True):
        assert direction_off_deg(lamp.at_m, true) < max(0.5, 2.5 * lamp.std_deg)
        np.testing.assert_allclose(lamp.balls_m[0], BALL[:2], atol=3e-4)
    assert found.response is not None
    z = np.arange(30, 235)
    ratio = found.response.table[z] / inverse_tone_curve(z / 255)
    np.testing.assert_allclose(ratio / np.median(ratio), 1, atol=0.05)


def test_blurred_pictures_are_left_out_and_why(found: Handheld) -> None:
    by_name = {each.name: each for each in found.looked_at}
    for number in (10, 11, 12, 20):
        each = by_name[f"walk_{number:06d}.png"]
        assert each.refused.startswith(("moved", "out of focus", "no board found"))
        assert each.name not in {kept.name for kept in found.kept}
    assert "left out: " in str(found)


def test_exposures_are_those_that_were_set(found: Handheld, footage: Footage) -> None:
    """By the white, relative; it is 0.9 in all, and the lamps are equally strong."""
    assert np.ptp(np.log(found.exposures[:, 1])) > 0.1
    balance = found.exposures / found.exposures[:, 1:2]
    np.testing.assert_allclose(balance / np.median(balance, axis=0), 1, atol=0.03)


def test_the_files_make_a_measurement(
    found: Handheld, footage: Footage, raden: Command, tmp_path: Path
) -> None:
    """The command that is proposed, as a shell would split it."""
    from raden_torch.capture.photo.handheld.handheld_file import next_command

    paths = HandheldPaths(tmp_path / "out")
    photographs = write_handheld(found, paths.folder)
    assert len(photographs) == 30
    assert read_camera(paths.camera).size == (540, 960)
    assert set(read_poses(paths.camera)[1]) == {path.name for path in photographs}
    lamps = read_lamps(paths.lights)
    assert sorted(sum(lamps.photographs, ())) == sorted(path.name for path in photographs)
    line = next_command(found, paths, photographs, None, "90").replace("\\\n", " ")
    words = shlex.split(line.replace("--white-factor 90", "--white-factor 90 --go-on"))
    frames = [str(p) for p in sorted(paths.frames.iterdir())]
    words = [part for w in words for part in (frames if w.endswith("*.png") else [w])]
    words[words.index("shell.csv")] = str(tmp_path / "shell.csv")
    made = raden(*words[1:], warn="default")
    assert made.returncode == 0, made.stderr
    measured = load_measurement(tmp_path / "shell.csv")
    truth = node_truth(measured.angles_deg) @ [0.2126, 0.7152, 0.0722]
    value = measured.as_rgb().values @ [0.2126, 0.7152, 0.0722]
    error = abs(value / truth - 1)
    assert len(error) > 200
    assert np.median(error) < 0.02
    assert np.quantile(error, 0.9) < 0.08


def every_fourth(found: Handheld) -> Handheld:
    """As if these alone had been chosen."""
    return replace(
        found,
        chosen=found.chosen[::4],
        poses=found.poses[::4],
        lamp_of=found.lamp_of[::4],
        exposures=found.exposures[::4],
    )


def test_an_earlier_runs_frames_do_not_stay(found: Handheld, tmp_path: Path) -> None:
    paths = HandheldPaths(tmp_path)
    before = {path.name for path in write_handheld(found, tmp_path) if path.parent == paths.frames}
    (paths.frames / "mine_000001.png").write_bytes(b"")
    few = every_fourth(found)
    after = {path.name for path in write_handheld(few, tmp_path) if path.parent == paths.frames}
    assert after < before
    assert {path.name for path in paths.frames.iterdir()} == {*after, "mine_000001.png"}
    report = json.loads(paths.report.read_text())
    assert len(report["pictures"]) == len(found.looked_at)
    assert sum(each["kept"] for each in report["pictures"]) == 8
    assert all(each["kept"] or each["refused"] for each in report["pictures"])


def test_a_film_without_a_good_picture_is_noted(footage: Footage, tmp_path: Path) -> None:
    """The other clips are measured all the same, and written."""
    film = cv2.VideoWriter(
        str(tmp_path / "dark.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 30, (960, 540)
    )
    for _ in range(3):
        film.write(np.full((540, 960, 3), 30, np.uint8))
    film.release()
    found = capture_handheld([tmp_path / "dark.avi", footage.paths[1]], setup())
    assert "dark.avi: no picture of it is kept (no board found)" in found.notes
    assert len(write_handheld(found, tmp_path / "out")) == 24
    assert "lamp 1 (stills)" in str(found)


def test_footage_among_the_results_is_refused(footage: Footage, raden: Command) -> None:
    stills = footage.paths[1]
    with pytest.raises(InputError, match="expected footage outside of"):
        check_folder(stills.parent, [stills.parent / "frames"])
    with pytest.raises(InputError, match="expected a folder, got a file"):
        check_folder(footage.paths[0] / "out", [stills])


def test_a_flash_is_found_in_the_cameras_frame(phone: Phone, tmp_path: Path) -> None:
    scene = Scene(flash_m=np.array(FLASH_M), grey_m=GREY_M, balls_m=(BALL,))
    frames = hand_path(16, seed=11, exposure_s=0, polar_deg=(8.0, 50.0))
    gain = auto_gains(scene, phone, frames, level=0.6)
    write_stills(tmp_path, scene, phone, frames, gain=gain, seed=5)
    found = capture_handheld([tmp_path], setup(lamp_on_camera=True))
    np.testing.assert_allclose(found.lamps[0].at_m[:2], FLASH_M[:2], atol=0.004)
    assert "a lamp on the camera shows light and view side by side only" in found.notes[-1]


def test_the_command_says_what_was_found(footage: Footage, raden: Command, tmp_path: Path) -> None:
    stills = footage.paths[1]
    middles = patches(GREY_M).mean(axis=1)
    greys = [
        f"--grey={x:.5f},{y:.5f},{100 * g:g}" for (x, y), g in zip(middles, GREYS, strict=True)
    ]
    arguments = [
        "capture", "handheld", stills, "--squares", "11x9", "--square", "0.016", "--marker",
        "0.012", "--region", "0.056,0.052 0.108,0.052 0.108,0.09 0.056,0.09", "--white-region",
        "0.12,0.053 0.14,0.053 0.14,0.089 0.12,0.089", "--ball", "0.156,0.0315,15",
    ]  # fmt: skip
    made = raden(*arguments, *greys, "-o", tmp_path / "out")
    assert made.returncode == 0, made.stderr
    assert "24 photographs chosen of 24" in made.stdout
    assert "raden capture brdf" in made.stdout
    assert (tmp_path / "out/handheld.png").stat().st_size > 50_000
    for more, said in (
        (
            ["--white-region", "0.2,0.05 0.22,0.05 0.22,0.09"],
            "the white is dark beside the board's",
        ),
        (["--lamps-stand", "camera", "--shadow", "0,0,30,0.1,0.1"], "expected a lamp that stands"),
        (["--flash", "1,2,3"], "flash: expected a lamp on the camera"),
        (["--grey", "0.1,0.1,0"], "grey patch: reflectance factor: expected above 0"),
        (["--ball", "nan,0,15"], "expected three finite numbers"),
        (["--blur", "0"], "--blur: expected above 0 pixels"),
        (["--squares", "5x7"], "expected pictures that show the board"),
    ):
        refused = raden(*arguments, *more, "-o", tmp_path / "not")
        assert refused.returncode == 2, (more, refused.stdout)
        assert said in refused.stderr
        assert refused.stderr.count("\n") == 1
    assert not (tmp_path / "not").exists()


def test_pictures_of_two_sizes_are_refused(footage: Footage, tmp_path: Path) -> None:
    stills = sorted(footage.paths[1].iterdir())[:2]
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), cv2.imread(str(stills[1]))[:500])
    with pytest.raises(InputError, match="expected pictures of one camera, all of 960"):
        capture_handheld([*stills, other], setup())


def test_a_camera_file_of_another_lens_is_refused(
    found: Handheld, footage: Footage, tmp_path: Path
) -> None:
    paths = HandheldPaths(tmp_path)
    write_handheld(found, tmp_path)
    content = json.loads(paths.camera.read_text())
    content["distortion"] = [-0.3, 0.1, 0.0, 0.0, 0.0]
    wrong = tmp_path / "wrong.json"
    wrong.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"wrong\.json: expected the camera that took these"):
        capture_handheld([footage.paths[1]], replace(setup(), camera=wrong))
