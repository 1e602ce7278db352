"""A camera of known colours is corrected; one that is not linear is called so."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.photo.band_reflectance import band_reflectance
from raden_torch.capture.photo.chart import Chart, Patches, read_patches
from raden_torch.capture.photo.chart_reference import reference_xyz
from raden_torch.capture.photo.chart_search import find_charts
from raden_torch.capture.photo.colour import METHODS, fit_colour, read_colour, write_colour
from raden_torch.capture.photo.dark_and_flat import subtract_dark
from raden_torch.capture.photo.exposures import merge_exposures
from raden_torch.capture.photo.photograph import Photograph, read_linear, shown
from raden_torch.errors import InputError

CAMERA = np.array([[0.9, 0.35, 0.1], [0.1, 1.1, 0.15], [0.02, 0.2, 0.8]])
ALL = np.ones(24, bool)
CENTRES = np.stack([np.arange(24) % 6, np.arange(24) // 6], -1) * 40.0


def patches_of(rgb: np.ndarray, usable: np.ndarray = ALL) -> Patches:
    return Patches(rgb, rgb * 0, usable, CENTRES)


def test_a_linear_camera_is_inverted() -> None:
    """Rationale: XYZ → RGB by a matrix. Expected: least squares is chosen and is its inverse."""
    reference = reference_xyz()
    noise = 1 + 0.002 * np.random.default_rng(0).normal(size=(24, 3))
    correction, report = fit_colour(
        patches_of(0.7 * reference @ CAMERA.T * noise), reference, "a.tif"
    )
    assert correction.method == "least squares"
    np.testing.assert_allclose(correction.matrix, np.linalg.inv(0.7 * CAMERA), atol=0.03)
    assert report.mean < 0.5
    assert report.worst < 2
    assert report.left_out["least squares"][0] >= report.mean
    assert report.neutral_exponent == pytest.approx(1, abs=0.02)
    assert report.notes == ()
    assert set(report.left_out) == set(METHODS)


def test_a_camera_that_no_matrix_inverts() -> None:
    """Rationale: Finlayson 2015. Expected: where the sensors are not linear in XYZ but scale with
    exposure, a root-polynomial predicts the left-out patches better, and keeps doing so when the
    exposure changes."""
    reference = reference_xyz()
    xyz = reference @ CAMERA.T
    rgb = xyz + 0.25 * np.stack(
        [np.sqrt(xyz[:, i] * xyz[:, j]) for i, j in ((0, 1), (1, 2), (0, 2))], -1
    )
    correction, report = fit_colour(patches_of(rgb), reference, "a.tif")
    assert correction.method.startswith("root-polynomial")
    assert report.left_out[correction.method][0] < 0.5 * report.left_out["least squares"][0]
    np.testing.assert_allclose(correction.to_xyz(3 * rgb), 3 * correction.to_xyz(rgb), rtol=1e-4)


def test_a_curve_is_noticed() -> None:
    rgb = (0.8 * reference_xyz() @ CAMERA.T) ** (1 / 2.2)
    _, report = fit_colour(patches_of(rgb), reference_xyz(), "a.png")
    assert report.neutral_exponent == pytest.approx(1 / 2.2, abs=0.03)
    assert "not linear" in str(report)


def test_saturated_patches_are_left_out() -> None:
    rgb = 0.7 * reference_xyz() @ CAMERA.T
    usable = ALL.copy()
    usable[[18, 15]] = False
    rgb[[18, 15]] = 1.0
    correction, report = fit_colour(patches_of(rgb, usable), reference_xyz(), "a.png")
    assert "yellow, white 9.5" in report.notes[0]
    np.testing.assert_allclose(correction.matrix, np.linalg.inv(0.7 * CAMERA), atol=1e-6)
    assert np.isnan(report.patches[[15, 18]]).all()
    usable[:7] = False
    with pytest.raises(
        InputError, match=r"a\.png: expected at least 18 usable patches, got 15 of 24 \(saturated"
    ):
        fit_colour(patches_of(rgb, usable), reference_xyz(), "a.png")


def test_file(tmp_path: Path) -> None:
    rgb = 0.7 * reference_xyz() @ CAMERA.T
    correction, report = fit_colour(patches_of(rgb), reference_xyz(), "a.tif")
    path = tmp_path / "colour.json"
    chart = Chart(np.eye(3), False, 0.1)
    write_colour(path, correction, report, chart, edition="2014", made_from=["/x/a.tif"])
    back = read_colour(path)
    assert back.method == correction.method
    np.testing.assert_array_equal(back.matrix, correction.matrix)
    np.testing.assert_allclose(back.to_xyz(rgb), reference_xyz(), atol=1e-5)
    text = path.read_text()
    assert '"a.tif"' in text
    assert "/x/" not in text
    for change, message in (
        (('"least squares"', '"magic"'), "method: expected .*, got 'magic'"),
        (('"kind": "colour"', '"kind": "camera"'), "expected a colour file, got a camera file"),
        (('"version": 1', '"version": 9'), "expected version 1, got 9"),
        (('"matrix"', '"matrox"'), r"matrix: expected 3 rows, got none; is it 'matrox'\?"),
        (("{", "["), "no valid JSON"),
    ):
        path.write_text(text.replace(*change, 1))
        with pytest.raises(InputError, match=message):
            read_colour(path)


@pytest.mark.slow
def test_a_photograph_of_a_chart(chart_scene: Callable) -> None:
    """End to end, with the noise of a photograph: below 1.5 ΔE2000 on average."""
    scene = chart_scene(camera=CAMERA @ np.diag([0.8, 0.7, 0.6]), turn_deg=12, noise=0.004)
    linear = scene.linear.astype(np.float32)
    photo = Photograph(linear, np.zeros(linear.shape[:2], bool), linear * 0, Path("a.tif"))
    patches = read_patches(photo, find_charts(scene.srgb, "a.tif")[0])
    _, report = fit_colour(patches, reference_xyz(), "a.tif")
    assert report.mean < 1.5


def test_light_over_a_chart_is_taken_out() -> None:
    rng = np.random.default_rng(5)
    reference = rng.uniform(0.04, 0.9, 24)
    x, y = (CENTRES / CENTRES.max(axis=0)).T
    light = 3 * (1 - 0.5 * x + 0.3 * y)
    found = band_reflectance(light * reference, reference, CENTRES)
    assert found.terms >= 3
    assert found.worst < 1e-9
    noisy = band_reflectance(
        light * reference * (1 + 0.02 * rng.normal(size=24)), reference, CENTRES
    )
    assert noisy.rms < 0.03
    with pytest.raises(
        InputError, match="expected one value each, for ten patches or more, got signal"
    ):
        band_reflectance(light[:5], reference[:5], CENTRES[:5])
    with pytest.raises(InputError, match="finite"):
        band_reflectance(light * 0, reference, CENTRES)


@pytest.mark.slow
def test_real_mosaics_against_the_spectrometer(shared: Path) -> None:
    """Each patch predicted without its own reading: within 0.05 rms from 450 to 700 nm.

    At 400 nm the camera and lamp see next to nothing (9 levels of 255), so it is not asserted.
    """
    folder = shared / "data" / "colorchecker" / "raw_bayer"
    with (folder / "spectra_averaged.csv").open() as file:
        head, *rows = csv.reader(file)
    table = np.array(rows, float)
    first = head.index("dark skin")
    times_ms = (25, 100, 500, 2000)

    def read(name: str, ms: int) -> Photograph:
        return read_linear(next(folder.glob(name)), pattern="GBRG", exposure_s=ms / 1000)

    darks = [read(f"d2_dark_{ms}ms*-0004.tif", ms) for ms in times_ms]
    bands = {
        nm: merge_exposures(
            [
                subtract_dark(read(f"d2_colorChecker30cm_{nm}nm_{ms}ms*.tif", ms), darks)
                for ms in times_ms
            ]
        ).radiance
        for nm in (450, 500, 550, 600, 650, 700)
    }
    seen = [bands[nm][..., i] / bands[nm].max() for i, nm in enumerate((650, 550, 450))]
    (chart,) = find_charts(shown(np.stack(seen, -1)), "bands")
    for nm, radiance in bands.items():
        photo = Photograph(radiance, np.zeros(radiance.shape[:2], bool), radiance, Path(f"{nm}"))
        patches = read_patches(photo, chart)
        channel = 2 if nm < 490 else 1 if nm < 580 else 0
        reference = table[table[:, 0] == nm][0, first : first + 24]
        found = band_reflectance(patches.rgb[:, channel], reference, patches.centres)
        assert found.rms < 0.05, nm
        assert found.median < 0.03, nm
