"""Files as they were stored, and what is made of them, against OpenCV's and NumPy's own readers."""

from __future__ import annotations

from pathlib import Path

import colour as colour_science
import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.camera import read_camera
from raden_torch.capture.photo.exposure_weights import (
    Noise,
    evenly_picked,
    exposure_weight,
    weighted_mean,
)
from raden_torch.capture.photo.linearity import linearity_of
from raden_torch.capture.photo.noise_fit import fit_noise
from raden_torch.capture.photo.opencv_calibration import is_opencv_file, read_opencv_camera
from raden_torch.capture.photo.photograph import Photograph
from raden_torch.capture.photo.stored_photograph import StoredPhotograph, bayer_pattern
from raden_torch.capture.photo.stored_values import linear_values
from raden_torch.errors import InputError

TIMES = (0.01, 0.03, 0.1, 0.3)


def stored(values: np.ndarray, **said: object) -> StoredPhotograph:
    return StoredPhotograph(Path("a.png"), values, **said)  # type: ignore[arg-type]


def test_srgb_values_are_colour_science_s_light() -> None:
    values = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, 2)
    found = linear_values(stored(values), "auto", None, None)
    wanted = colour_science.models.eotf_sRGB(values / 255)
    np.testing.assert_allclose(found.linear, wanted, atol=1e-6)
    assert found.saturated.sum() == 1
    assert found.saturated[255, 0]


def test_rounding_is_a_step_over_root_twelve() -> None:
    """Of a uniform error of one whole number; a curve stretches it by its slope."""
    values = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    found = linear_values(stored(values), "linear", None, None)
    np.testing.assert_allclose(found.rounding, 1 / 65535 / np.sqrt(12), rtol=3e-3)
    np.testing.assert_allclose(found.linear[..., 0], values / 65535, rtol=1e-6)
    random = np.random.default_rng(0)
    curve = np.linspace(0, 1, 256, dtype=np.float32) ** 2
    light = random.uniform(0.2, 0.9, 200_000)
    eight = np.rint(255 * np.sqrt(light)).astype(np.uint8)[None]
    bent = linear_values(stored(eight), curve, None, None)
    z = (bent.linear[0, :, 0] - light) / bent.rounding[0, :, 0]
    assert z.std() == pytest.approx(1, abs=0.02)


def test_what_the_file_says_gives_way_to_what_is_stated() -> None:
    values = np.full((4, 4), 1000, np.uint16)
    photo = stored(values, white_level=4000.0, pattern="GRBG")
    assert linear_values(photo, "linear", None, None).linear.max() == pytest.approx(0.25)
    assert linear_values(photo, "linear", 2000.0, None).linear.max() == pytest.approx(0.5)
    assert linear_values(photo, "linear", 1000.0, None).saturated.all()
    assert bayer_pattern(photo, None) == "GRBG"
    assert bayer_pattern(photo, "rggb") == "RGGB"
    assert bayer_pattern(photo, "none") is None
    with pytest.raises(InputError, match=r"a\.png: white level: expected 2…65535, got 70000"):
        linear_values(photo, "linear", 70000.0, None)


def test_floats_keep_their_unit() -> None:
    values = np.array([[[0.5, 2.0, np.inf]]], np.float32)
    found = linear_values(stored(values), "auto", None, None)
    assert found.linear.tolist() == [[[0.5, 2.0, 0.0]]]
    assert (found.rounding == 0).all()
    assert stored(values).bits is None
    assert stored(np.zeros((2, 2), np.uint16)).bits == 16


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".calib"])
def test_opencv_s_own_calibration_files(tmp_path: Path, suffix: str) -> None:
    matrix = np.array([[812.5, 0, 320.25], [0, 810.0, 241.5], [0, 0, 1]])
    distortion = np.array([[-0.21, 0.05, 1e-3, -2e-3, 0.0]])
    written = tmp_path / ("a.yml" if suffix == ".calib" else f"a{suffix}")
    file = cv2.FileStorage(str(written), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 640)
    file.write("image_height", 480)
    file.write("camera_matrix", matrix)
    file.write("distortion_coefficients", distortion)
    file.release()
    path = written.rename(tmp_path / f"b{suffix}")  # of another name it is known by how it begins
    assert is_opencv_file(path)
    found, bent, size = read_opencv_camera(path)
    np.testing.assert_array_equal(found, matrix)
    np.testing.assert_array_equal(bent, distortion[0])
    assert size == (480, 640)
    assert read_camera(path).fov_deg == pytest.approx(np.degrees(2 * np.arctan(320 / 812.5)))
    path.write_bytes(path.read_bytes().replace(b"camera_matrix", b"camera_motrix"))
    with pytest.raises(InputError, match=r"got no whole camera_matrix"):
        read_opencv_camera(path)


def test_a_result_file_is_not_opencv_s(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    assert not is_opencv_file(tmp_path / "a.json")
    assert not is_opencv_file(tmp_path / "none.json")
    with pytest.raises(InputError, match=r"none\.yml: expected a camera file, got no such file"):
        read_opencv_camera(tmp_path / "none.yml")


def exposed(light: np.ndarray, noise: Noise, seed: int = 0) -> list[Photograph]:
    random = np.random.default_rng(seed)
    photos = []
    for t in TIMES:
        signal = light * t
        spread = np.sqrt(noise.variance(signal, np.zeros_like(signal)))
        values = (signal + spread * random.normal(size=light.shape)).astype(np.float32)
        full = (values >= 1).any(axis=2)
        photos.append(Photograph(values, full, np.zeros_like(values), Path("a"), 16, t))
    return photos


def test_weights_are_the_inverse_variance_of_the_radiance() -> None:
    """Var(x / t) = variance / t²; the weighted mean has the variance 1 / Σ w."""
    noise, light = Noise(0.01, 0.002), np.full((60, 60, 1), 2.0, np.float32)
    everywhere = np.ones((60, 60), bool)
    means, weight = [], np.zeros(1)
    for seed in range(30):
        photos = exposed(light, noise, seed)
        weights = [
            exposure_weight(p, t, everywhere, noise, light)
            for p, t in zip(photos, TIMES, strict=True)
        ]
        radiances = [p.linear / t for p, t in zip(photos, TIMES, strict=True)]
        weight = np.sum(weights, axis=0)
        total = np.sum([w * x for w, x in zip(weights, radiances, strict=True)], axis=0)
        means.append(weighted_mean(total, weight))
    for w, t in zip(weights, TIMES, strict=True):
        np.testing.assert_allclose(w, t**2 / (0.01**2 + 0.002 * 2.0 * t), rtol=1e-5)
    spread = np.std(means)
    assert spread == pytest.approx(float(1 / np.sqrt(weight.mean())), rel=0.02)
    nothing = exposure_weight(photos[0], TIMES[0], ~everywhere, noise, light)
    assert (nothing == 0).all()
    assert (weighted_mean(nothing, nothing) == 0).all()
    assert [len(a) for a in evenly_picked(np.zeros(1_200_000), np.zeros(1_200_000))] == [
        600_000
    ] * 2


@pytest.mark.parametrize("noise", [Noise(0.004, 0.0), Noise(0.001, 0.001)], ids=["read", "photons"])
def test_the_noise_is_found_in_the_scatter(noise: Noise) -> None:
    light = np.geomspace(0.05, 20, 160_000).reshape(400, 400, 1).astype(np.float32)
    photos = exposed(light, noise)
    usable = [(p.linear < 0.9).all(axis=2) for p in photos]
    weights = [
        exposure_weight(p, t, use, noise, light)
        for p, t, use in zip(photos, TIMES, usable, strict=True)
    ]
    weight = np.sum(weights, axis=0)
    total = np.sum([w * p.linear / t for w, p, t in zip(weights, photos, TIMES, strict=True)], 0)
    merged = weighted_mean(total, weight)
    found = fit_noise(photos, TIMES, usable, noise, merged, weight)
    assert found is not None
    signal = np.geomspace(0.005, 0.9, 20).astype(np.float32)
    rounding = np.zeros_like(signal)
    np.testing.assert_allclose(
        found.variance(signal, rounding), noise.variance(signal, rounding), rtol=0.1
    )
    assert fit_noise(photos[:1], TIMES[:1], usable[:1], noise, merged, weights[0]) is None


def test_a_shutter_that_is_ten_per_cent_slow_shows_in_the_linearity() -> None:
    """Of two exposures of equal weight, one 10 % too bright: each is 5 % off their mean."""
    light = np.geomspace(1, 9, 10_000).reshape(100, 100, 1).astype(np.float32)
    noise, times = Noise(0.001, 0.0), (0.1, 0.1001)
    photos = [
        Photograph(light * t * factor, np.zeros((100, 100), bool), 0 * light, Path("a"), 16, t)
        for t, factor in zip(times, (1.0, 1.1), strict=True)
    ]
    everywhere = [np.ones((100, 100), bool)] * 2
    weights = [
        exposure_weight(p, t, use, noise, light)
        for p, t, use in zip(photos, times, everywhere, strict=True)
    ]
    total = sum(w * p.linear / t for w, p, t in zip(weights, photos, times, strict=True))
    found = linearity_of(photos, times, everywhere, noise, total, weights[0] + weights[1])
    assert found is not None
    assert found.samples == 20_000
    assert found.median == pytest.approx(0.05 / 1.05, abs=2e-3)
    assert found.median_left_out == pytest.approx((1 - 1 / 1.1 + 0.1) / 2, abs=6e-3)
    assert linearity_of(photos[:1], times[:1], everywhere[:1], noise, total, weights[0]) is None
