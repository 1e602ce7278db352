"""Raw files on their way through `raden capture` and `raden relight`."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

import raden_torch as rt
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.development import developed
from raden_torch.capture.photo.photograph import read_linear, read_stored
from raden_torch.errors import InputError
from raden_torch.images.shot_settings import ShotSettings
from tests.dng import mosaic_of

Command = Callable[..., subprocess.CompletedProcess[str]]
H, W = 24, 32
BLACK, WHITE = 256, 4095
SET_SO = {33434: (5, [1 / 50]), 33437: (5, [4.0]), 34855: (3, 100), 37386: (5, [50.0])}


def counted(linear: np.ndarray, pattern: str = "RGGB") -> np.ndarray:
    """What a sensor of 12 bits counts of `[H, W, 3]` in units of its white level."""
    mosaic = mosaic_of(linear, pattern)
    return np.clip(np.rint(BLACK + (WHITE - BLACK) * mosaic), 0, WHITE).astype(np.uint16)


def flat(*rgb: float) -> np.ndarray:
    return np.broadcast_to(np.array(rgb), (H, W, 3)).astype(float)


@pytest.fixture
def write(tmp_path: Path, dng: ModuleType) -> Callable[..., Path]:
    def make(name: str, linear: np.ndarray, **options: object) -> Path:
        return dng.write_dng(
            tmp_path / name, counted(linear), **{"black": BLACK, "white": WHITE, **options}
        )

    return make


def test_a_raw_file_is_the_cameras_own_rgb(write: Callable[..., Path]) -> None:
    path = write("a.dng", flat(0.2, 0.4, 0.1), exif={**SET_SO, 42033: (2, b"77\0")})
    photo = read_linear(path)
    step = 1 / (WHITE - BLACK)
    np.testing.assert_allclose(photo.linear, flat(0.2, 0.4, 0.1), atol=0.51 * step)
    np.testing.assert_allclose(photo.rounding, step / np.sqrt(12), rtol=1e-5)
    assert (photo.pattern, photo.bits, photo.exposure_s) == ("RGGB", 16, pytest.approx(1 / 50))
    assert photo.colour is not None
    expected = ShotSettings(
        pytest.approx(1 / 50), 100, 4.0, 50.0, "Nobody Box 1", "77", orientation=1
    )
    assert photo.settings == expected
    kept = read_linear(path, keep_mosaic=True)
    np.testing.assert_allclose(kept.linear[0, :2, 0], (0.2, 0.4), atol=0.51 * step)
    assert read_stored(path).dtype == np.uint8


def test_saturation_follows_the_white_level(write: Callable[..., Path]) -> None:
    linear = flat(0.2, 0.4, 0.1)
    linear[8, 8] = 1.2
    path = write("a.dng", linear)
    assert read_linear(path, keep_mosaic=True).saturated.sum() == 1
    half = read_linear(path, white_level=(WHITE + BLACK) / 2)
    np.testing.assert_allclose(half.linear[2, 2], (0.4, 0.8, 0.2), atol=1e-3)
    with pytest.raises(InputError, match=r"white level: expected 258…65535, got 100"):
        read_linear(path, white_level=100)


def test_what_raw_files_are_not(write: Callable[..., Path]) -> None:
    path = write("a.dng", flat(0.2, 0.4, 0.1))
    with pytest.raises(InputError, match=r"a\.dng: expected a raw file to be linear, got sRGB"):
        read_linear(path, coded="srgb")
    with pytest.raises(InputError, match="to be linear, got a response"):
        read_linear(path, coded=np.linspace(0, 1, 256))
    with pytest.raises(InputError, match=r"a\.dng: expected no pattern for a raw file"):
        read_linear(path, pattern="RGGB")


def test_what_is_not_done_is_warned_of(dng: ModuleType, write: Callable[..., Path]) -> None:
    path = write("a.dng", flat(0.2, 0.4, 0.1), tags={51009: dng.opcodes(9)})
    with pytest.warns(UserWarning, match=r"a\.dng: not applied: the DNG's OpcodeList2 GainMap"):
        read_linear(path)


def test_a_stack_of_raw_files(write: Callable[..., Path]) -> None:
    """Expected: radiance per second, from the exposures that are not saturated."""
    light = 0.1 + 0.4 * np.random.default_rng(0).random((H, W, 1)) * np.ones(3)
    light = cv2.GaussianBlur(light, (0, 0), 3)
    paths = [
        write(f"{t}.dng", light * t, exif={**SET_SO, 33434: (5, [t])}) for t in (0.5, 1.0, 4.0)
    ]
    photo, merged = developed(paths)
    assert merged is not None
    np.testing.assert_allclose(photo.linear[2:-2, 2:-2], light[2:-2, 2:-2], atol=6e-3)
    other = write("other.dng", light, exif={**SET_SO, 37386: (5, [35.0])})
    message = r"other\.dng: focal length in mm: expected 50 as in .*0\.5\.dng, got 35"
    with pytest.raises(InputError, match=message):
        developed([*paths, other])


def test_a_chart_in_a_raw_file_gives_the_colours_of_the_camera(
    raden: Command, chart_scene: Callable, tmp_path: Path, dng: ModuleType
) -> None:
    """Rationale: the camera's own RGB is fitted, whatever the file's matrix says; the photograph is
    relit by it. Expected: the chart's colours come back."""
    camera = np.array([[0.7, 0.25, 0.05], [0.1, 0.8, 0.1], [0.05, 0.3, 0.65]])
    scene = chart_scene(noise=0.0, camera=camera, exposure=0.8)
    path = dng.write_dng(
        tmp_path / "chart.dng", counted(scene.linear, "GRBG"), pattern="GRBG", black=BLACK,
        white=WHITE, matrix=None,
    )  # fmt: skip
    done = raden("capture", "colour", path, "-o", tmp_path / "colour.json")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "colour.json").read_text())["mean_delta_e_2000"] < 1
    correction = read_colour(tmp_path / "colour.json")
    found = correction.to_linear_srgb(read_linear(path).linear)
    background = 0.35
    np.testing.assert_allclose(found[4, 4], background, atol=0.01)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "m.safetensors"
    result = rt.fit(rt.simulate_specimen("yakogai", step_deg=35.0), interpolation="trilinear")
    rt.save_model(result.model, path)
    return path


@pytest.fixture
def surface(tmp_path: Path, model: Path) -> list[object]:
    """Normals that face the camera, the right half relit."""
    facing = np.full((H, W, 3), (65535, 32768, 32768), np.uint16)
    mask = np.zeros((H, W), np.uint8)
    mask[:, W // 2 :] = 255
    cv2.imwrite(str(tmp_path / "n.png"), facing)
    cv2.imwrite(str(tmp_path / "m.png"), mask)
    return ["--normals", tmp_path / "n.png", "--mask", tmp_path / "m.png", "--model", model]


def test_a_raw_file_is_relit(
    raden: Command, tmp_path: Path, write: Callable[..., Path], surface: list[object]
) -> None:
    """Expected: what is not relit is the picture in sRGB, neutral where the camera's RGB is what it
    calls neutral; where its colours are from is said."""
    path = write("photo.dng", 0.4 * flat(0.5, 1.0, 0.625), neutral=(0.5, 1.0, 0.625))
    relit = tmp_path / "relit.png"
    done = raden("relight", path, *surface, "--light", "0,0,1", "-o", relit, warn="default")
    assert done.returncode == 0, done.stderr
    said = "photo.dng: colours by the matrix of the file and the white balance as shot"
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
    left = cv2.imread(str(relit), cv2.IMREAD_UNCHANGED)[4, 4, ::-1] / 65535
    np.testing.assert_allclose(left, 1.055 * 0.4 ** (1 / 2.4) - 0.055, atol=2e-3)


def test_where_the_colours_of_frames_are_from_is_said_once(
    raden: Command, tmp_path: Path, write: Callable[..., Path], surface: list[object]
) -> None:
    """The first frame is read to plan the work, too."""
    for number in (1, 2):
        write(f"photo.{number:04}.dng", flat(0.2, 0.4, 0.1))
    given = ["--frames", "1-2", "-o", tmp_path / "relit.####.png"]
    done = raden("relight", tmp_path / "photo.####.dng", *surface, *given, warn="default")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("colours by the matrix of the file") == 1


def test_a_camera_that_nobody_knows_is_relit_by_a_colour_file(
    raden: Command, tmp_path: Path, write: Callable[..., Path], surface: list[object]
) -> None:
    path = write("photo.dng", flat(0.2, 0.4, 0.1), matrix=None)
    relit = tmp_path / "relit.png"
    done = raden("relight", path, *surface, "-o", relit)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "got an unknown one; `raden capture colour` measures its colours" in done.stderr
    assert not relit.exists()
    to_xyz = np.linalg.inv(
        [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    )
    said = {"format": "raden capture", "version": 1, "kind": "colour", "method": "least squares"}
    colour = tmp_path / "colour.json"
    colour.write_text(json.dumps({**said, "matrix": (to_xyz * [2, 1, 4]).tolist()}))
    done = raden("relight", path, *surface, "--colour", colour, "-o", relit)
    assert done.returncode == 0, done.stderr
    left = cv2.imread(str(relit), cv2.IMREAD_UNCHANGED)[4, 4, ::-1] / 65535
    np.testing.assert_allclose(left, 1.055 * 0.4 ** (1 / 2.4) - 0.055, atol=2e-3)


def test_info_of_a_raw_file(raden: Command, dng: ModuleType, write: Callable[..., Path]) -> None:
    path = write("a.dng", flat(0.2, 0.4, 0.1), exif=SET_SO, tags={51009: dng.opcodes(9)})
    assert raden("info", path).stdout.splitlines() == [
        "camera raw file: 32 x 24 pixels (width x height)",
        "Bayer mosaic RGGB; black level 256, white level 4095",
        "camera: Nobody Box 1",
        "exposure: 1/50 s, f/4, ISO 100, 50 mm",
        "colours: the matrix of the file and the white balance as shot (2.000, 1.000, 1.600)",
        "not applied: the DNG's OpcodeList2 GainMap",
    ]
    unknown = raden("info", write("b.dng", flat(0.2, 0.4, 0.1), matrix=None)).stdout
    assert "colours: an unknown camera; `raden capture colour` measures them" in unknown
