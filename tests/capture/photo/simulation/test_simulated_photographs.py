"""The simulated photographs themselves, against what can be worked out without a renderer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from raden_torch.capture.photo.photograph import read_linear
from raden_torch.capture.photo.simulation.colours import white_xyz
from raden_torch.capture.photo.simulation.materials import (
    Material,
    evaluated,
    material_of,
    truth_of,
)
from raden_torch.capture.photo.simulation.mitsuba_scene import (
    Ball,
    Lamp,
    Sheet,
    matt,
    sheet,
    sphere,
)
from raden_torch.capture.photo.simulation.photo_file import write_photograph
from raden_torch.capture.photo.simulation.photo_plan import FACING, RIGHT, UP, lamp_at
from raden_torch.capture.photo.simulation.renderer import SPECIMEN, Studio
from raden_torch.capture.photo.simulation.simulate import Options, simulate_photographs
from raden_torch.capture.photo.simulation.simulated_angles import angles, directions
from raden_torch.capture.photo.simulation.simulated_camera import Camera
from raden_torch.capture.photo.simulation.variants import LLVM, mitsuba, why_no_llvm
from raden_torch.errors import InputError
from raden_torch.geometry import raden_angles
from raden_torch.measurement import native_csv
from raden_torch.optics.specimens import simulate_specimen

CAMERA = Camera(
    np.array([[320.0, 0, 61], [0, 322, 38], [0, 0, 1]]),
    np.array([-0.28, 0.35, 0.0006, -0.0004, 0.1]),
    (80, 120),
)


@pytest.fixture(scope="module")
def mi() -> Any:
    pytest.importorskip("mitsuba", reason="Mitsuba, the extra `simulate`, is not installed")
    return mitsuba()


def upper(count: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    v[:, 2] = abs(v[:, 2]) + 0.02
    return v / np.linalg.norm(v, axis=1, keepdims=True)


# --- angles, written twice


def test_angles_are_those_of_the_convention() -> None:
    light, view = upper(20_000, 1), upper(20_000, 2)
    light[:50] = view[:50]  # a lamp on the camera
    n = torch.tensor([0.0, 0, 1], dtype=torch.float64).view(1, 3, 1, 1)
    maps = [torch.from_numpy(v.T.copy())[None, :, :, None] for v in (light, view)]
    wanted = [a[0, 0, :, 0].numpy() for a in raden_angles(n, *maps)]
    for own, other in zip(angles(light, view), wanted, strict=True):
        np.testing.assert_allclose(own, other, atol=1e-7)


def test_directions_have_their_angles() -> None:
    rng = np.random.default_rng(3)
    a, r, t = (
        rng.uniform(0.01, 1.4, 5000),
        rng.uniform(-1.4, 1.4, 5000),
        rng.uniform(-1.4, 1.4, 5000),
    )
    apart = abs(a + r) > 1e-3
    for found, given in zip(angles(*directions(a, r, t)), (a, r, t), strict=True):
        np.testing.assert_allclose(found[apart], given[apart], atol=1e-9)


# --- truth


def test_a_perfect_white_is_100_in_every_geometry(mi: Any) -> None:
    truth = truth_of(mi, material_of("white"))
    assert truth.metadata.simulated
    np.testing.assert_allclose(truth.values, np.tile(100 * white_xyz(), (len(truth), 1)), rtol=1e-5)


@pytest.mark.parametrize("name", ["yakogai", "abalone"])
def test_the_truth_of_a_shell_is_its_measurement(mi: Any, name: str) -> None:
    """At the grid's nodes a table is the measurement, through our angles and Mitsuba's BSDF."""
    truth, shell = truth_of(mi, material_of(name)), simulate_specimen(name)
    # light and view in one direction is one geometry for all tilts, read where the tilt is 0
    retro = abs(truth.receiving_deg + truth.incidence_deg) < 1e-6
    np.testing.assert_allclose(truth.values[~retro], shell.values[~retro], rtol=1e-5)
    level = retro & (truth.tilt_deg == 0)
    np.testing.assert_allclose(truth.values[level], shell.values[level], rtol=1e-5)


def test_a_measurement_of_others_as_truth(mi: Any, shared: Path) -> None:
    file = shared / "data" / "measured_brdf" / "pearl-paint.csv"
    truth, given = truth_of(mi, material_of(str(file))), native_csv.read(file)
    key = np.lexsort((given.tilt_deg, given.receiving_deg, given.incidence_deg))
    off = abs(truth.values - given.values[key]) / (1 + given.values[key])
    retro = abs(truth.receiving_deg + truth.incidence_deg) < 1e-6  # one geometry for all tilts
    assert off[~retro].max() < 5e-3


def test_a_table_is_evaluated_alike_by_mitsuba_and_by_numpy(mi: Any) -> None:
    material = material_of("akoya")
    assert material.table is not None
    light, view = upper(3000, 4), upper(3000, 5)
    by_mitsuba = evaluated(mi, material.bsdf(mi), light, view)
    by_numpy = material.table.at(light, view)
    np.testing.assert_allclose(by_mitsuba, by_numpy, rtol=2e-3, atol=1e-5)


# --- light


def sphere_before(mi: Any, material: Material) -> Studio:
    things = {SPECIMEN: sphere(Ball((3.0, -2.0, -500.0), 45.0), matt(1.0))}
    return Studio(mi, things, {}, material, CAMERA, FACING)


def test_a_matt_sphere_follows_the_cosine_and_the_inverse_square(mi: Any) -> None:
    studio = sphere_before(mi, material_of("white"))
    lamp = Lamp((200.0, 150.0, -150.0), (1e5, 2e5, 3e5), 5.0)
    first = studio._passes[0]
    on = first.on(SPECIMEN)
    position, normal = first.hits[0][on], first.hits[1][on]
    np.testing.assert_allclose(normal, (position - [3, -2, -500]) / 45, atol=2e-4)
    way = np.array(lamp.position_mm) - position
    distance = np.linalg.norm(way, axis=1)
    cosine = np.clip((normal * way).sum(1) / distance, 0, None)
    wanted = (cosine / (np.pi * distance**2))[:, None] * np.array(lamp.intensity)
    found = studio.radiance(lamp)[on]
    lit = cosine > 0.02
    np.testing.assert_allclose(found[lit], wanted[lit], rtol=2e-3)
    assert np.abs(found[cosine == 0]).max() == 0


def test_a_white_tile_is_1_under_an_irradiance_of_pi(mi: Any) -> None:
    things = {
        "tile": sheet(mi, Sheet(np.array([-60, 60, -400.0]), RIGHT, -UP, 120, 120), matt(1.0))
    }
    studio = Studio(mi, things, {}, None, CAMERA, FACING)
    raw = studio.raw(lamp_at(np.array([0, 0, 199_600.0]), 200_000.0, 1.0))
    middle = raw[35:45, 55:65].reshape(-1, 3)
    np.testing.assert_allclose(middle, np.tile(CAMERA.from_xyz.sum(1), (100, 1)), rtol=1e-4)


@pytest.mark.slow
def test_a_table_lit_by_white_light_is_the_table_rendered(mi: Any) -> None:
    """The scalar variant renders a white and multiplies; Mitsuba may ask the BSDF itself."""
    material = material_of("yakogai")
    material.bsdf(mi)  # registers raden_table
    native = Material("yakogai", {"type": "raden_table"}, None, "the same by Mitsuba alone")
    lamp = lamp_at(np.array([300.0, 250.0, 100.0]), 700.0, 1.0)
    ours, theirs = (sphere_before(mi, m).raw(lamp) for m in (material, native))
    assert ours.max() > 0.1
    np.testing.assert_allclose(ours, theirs, rtol=5e-3, atol=1e-4)


def test_things_cast_shadows(mi: Any) -> None:
    tile = sheet(mi, Sheet(np.array([-60, 60, -400.0]), RIGHT, -UP, 120, 120), matt(1.0))
    things = {"tile": tile, "hat": sphere(Ball((0.0, 0.0, -300.0), 8.0), matt(0.0))}
    lamp = lamp_at(np.array([200.0, 0.0, 100.0]), 600.0, 1.0)
    raw = Studio(mi, things, {}, None, CAMERA, FACING).raw(lamp)[..., 1]
    # light from the right at the height of the lens: the ball's shadow falls to its left
    assert raw[38, 21] < 0.02 < 0.3 < raw[10, 21]


# --- lens and sensor


def test_the_lens_bends_as_opencv_says() -> None:
    points = np.random.default_rng(6).uniform([-90, -60, 400], [90, 60, 600], (500, 3))
    wanted, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), CAMERA.matrix, CAMERA.distortion
    )
    np.testing.assert_allclose(CAMERA.project(points), wanted.reshape(-1, 2), atol=1e-9)


def test_points_lie_where_their_rays_go(mi: Any) -> None:
    studio = sphere_before(mi, material_of("white"))
    first = studio._passes[0]
    seen = CAMERA.project(FACING.of_points(first.hits[0]))
    x, y = first.frame.directions()
    assert abs(seen - CAMERA.bent(x, y)).max() < 2e-3


def test_every_pixel_of_a_white_wall_is_white(mi: Any) -> None:
    """Weights of the lens sum to one, and what it bends in is there up to the corners."""
    things = {
        "tile": sheet(mi, Sheet(np.array([-200, 200, -400.0]), RIGHT, -UP, 400, 400), matt(1.0))
    }
    mask = Studio(mi, things, {}, None, CAMERA, FACING).mask("tile")
    np.testing.assert_allclose(mask, 1.0, atol=1e-9)


@pytest.mark.parametrize("bits", [8, 12, 14])
def test_noise_is_that_of_electrons(bits: int) -> None:
    camera = Camera(CAMERA.matrix, CAMERA.distortion, (400, 400), bits=bits, full_well_e=20_000)
    rng = np.random.default_rng(bits)
    for level in (0.02, 0.5):
        raw = np.full((400, 400, 3), level)
        stored = camera.photograph(raw, 0.1, rng) / (255 if bits == 8 else 65535)
        rounding = 1 / (2**bits - 1)
        shot = level / 20_000 + (4 / 20_000) ** 2
        if rounding**2 > shot:  # so coarse that rounding is no noise
            assert stored.mean() == pytest.approx(level, abs=rounding / 2)
            continue
        # 480,000 values: a mean is known to 0.2 %, a variance to 0.3 % of the noise (k = 1)
        variance = shot + rounding**2 / 12
        assert stored.mean() == pytest.approx(level, abs=5 * np.sqrt(variance / 480_000))
        assert stored.var() == pytest.approx(variance, rel=0.02)
    clipped = camera.photograph(np.full((4, 4, 3), 3.0), 0.1, rng)
    assert (clipped == np.iinfo(clipped.dtype).max).all()


@pytest.mark.parametrize("dtype_name", ["uint8", "uint16"])
def test_a_photograph_says_its_exposure_and_that_it_is_linear(
    tmp_path: Path, dtype_name: str
) -> None:
    stored = np.random.default_rng(7).integers(60, 180, (20, 30, 3)).astype(dtype_name)
    stored *= 1 if dtype_name == "uint8" else 251
    write_photograph(tmp_path / "a.png", stored, 1 / 80)
    photo = read_linear(tmp_path / "a.png")
    assert photo.exposure_s == pytest.approx(1 / 80)
    np.testing.assert_allclose(photo.linear, stored / np.iinfo(stored.dtype).max, atol=1e-6)
    with Image.open(tmp_path / "a.png") as image:
        image.verify()  # checks every chunk's sum


# --- what may go wrong


def test_without_mitsuba_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(InputError, match=r"raden_torch\[simulate\]"):
        mitsuba()


@pytest.mark.slow
def test_llvm_is_tried_in_another_process(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    why_no_llvm.cache_clear()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    try:
        assert why_no_llvm()
        with pytest.raises(InputError, match="scalar_rgb runs everywhere"):
            mitsuba(LLVM)
    finally:
        why_no_llvm.cache_clear()
    assert mi.variant() == "scalar_rgb"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"material": "tortoiseshell"}, "yakogai"),
        ({"material": "nowhere.csv"}, "No such file"),
        ({"shape": "cube"}, "sphere or plane"),
        ({"width": 40}, "300…6000"),
        ({"shape": "plane", "stack": 3}, "stack: expected 1 for a plane, got 3"),
    ],
)
def test_bad_options(mi: Any, tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulate_photographs(tmp_path / "set", Options(**options))
    assert not (tmp_path / "set").exists()


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "dear.txt").write_text("keep")
    command = [sys.executable, "-m", "raden_torch.cli", "capture", "simulate", "-o", tmp_path]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=300)
    assert done.returncode == 2
    assert "not empty" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["dear.txt"]


def test_what_is_interrupted_leaves_nothing(
    mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: Any) -> None:
        (self._folder / "board_01.png").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(
        "raden_torch.capture.photo.simulation.simulate._PhotoSession.boards", interrupted
    )
    with pytest.raises(KeyboardInterrupt):
        simulate_photographs(tmp_path / "set", Options(material="white", width=300))
    assert list(tmp_path.iterdir()) == []
