"""Exposures of a known radiance, with known noise, and the real raw mosaics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.camera_response import recover_response
from raden_torch.capture.photo.dark_and_flat import flat_field, flatten, subtract_dark
from raden_torch.capture.photo.exposure_weights import Noise
from raden_torch.capture.photo.exposures import merge_exposures
from raden_torch.capture.photo.photograph import Photograph, read_linear
from raden_torch.errors import InputError
from raden_torch.images.shot_settings import ShotSettings

TIMES = (0.01, 0.04, 0.16, 0.64)


def radiance(size: int = 96) -> np.ndarray:
    x = np.linspace(0, 1, size)
    plane = np.exp(np.log(0.02) + (np.log(40) - np.log(0.02)) * x[None]) * (0.7 + 0.3 * x[:, None])
    return (plane[..., None] * [1.0, 0.8, 0.6]).astype(np.float32)


def exposed(
    light: np.ndarray, t: float, *, noise: Noise, levels: int = 4095, seed: int = 0, name: str = ""
) -> Photograph:
    rng = np.random.default_rng([seed, round(1e6 * t)])
    signal = light * t
    noisy = signal + rng.normal(size=light.shape) * np.sqrt(noise.read**2 + noise.gain * signal)
    stored = np.clip(np.rint(noisy * levels), -levels, levels)
    full = (stored >= levels).any(axis=2)
    rounding = np.full(light.shape, 1 / levels / np.sqrt(12), np.float32)
    path = Path(name or f"{t}.tif")
    return Photograph((stored / levels).astype(np.float32), full, rounding, path, 16, t)


def test_merging_recovers_radiance_and_its_noise() -> None:
    """Rationale: minimum variance. Expected: errors are as large as `sigma` says, everywhere; the
    noise model is found from the stack; the signal is linear."""
    light, noise = radiance(192), Noise(read=0.002, gain=0.0004)
    photos = [exposed(light, t, noise=noise) for t in TIMES]
    merged = merge_exposures(photos)
    assert merged.noise.read == pytest.approx(noise.read, rel=0.25)
    assert merged.noise.gain == pytest.approx(noise.gain, rel=0.25)
    z = ((merged.radiance - light) / merged.sigma)[merged.valid]
    assert abs(z.mean()) < 0.05
    assert z.std() == pytest.approx(1, abs=0.1)
    assert merged.linearity is not None
    assert merged.linearity.median < 0.03
    assert merged.linearity.median <= merged.linearity.median_left_out
    # better than the best single exposure
    single = np.abs(photos[0].linear / TIMES[0] - light)[merged.valid]
    assert np.median(np.abs(merged.radiance - light)[merged.valid]) < 0.5 * np.median(single)


def test_saturated_everywhere_is_a_lower_bound() -> None:
    light = radiance()
    light[:, :10] = 200.0
    merged = merge_exposures([exposed(light, t, noise=Noise(0.001, 1e-4)) for t in TIMES])
    assert not merged.valid[:, :8].any()
    assert merged.valid[:, 16:].all()
    assert (merged.radiance[:, :8] <= 200 * 1.01).all()
    assert np.isinf(merged.sigma[:, :8]).all()
    with pytest.raises(InputError, match=r"0\.01\.tif: over-exposed nearly everywhere"):
        merge_exposures([exposed(light * 0 + 1e4, t, noise=Noise(0.001, 0)) for t in TIMES])


def test_a_curve_shows_in_the_linearity() -> None:
    light, noise = radiance(), Noise(0.0005, 1e-5)
    photos = [exposed(light, t, noise=noise) for t in TIMES]
    bent = [replace(photo, linear=np.clip(photo.linear, 0, 1) ** 0.8) for photo in photos]
    straight, curved = merge_exposures(photos).linearity, merge_exposures(bent).linearity
    assert straight is not None
    assert curved is not None
    assert straight.median < 0.01
    assert curved.median > 0.05
    assert "median deviation" in str(curved)


def test_what_may_not_differ() -> None:
    light, noise = radiance(), Noise(0.001, 1e-4)
    one, two = (exposed(light, t, noise=noise, name=f"{i}.tif") for i, t in enumerate(TIMES[:2]))
    for change, message in (
        ({"exposure_s": None}, r"1\.tif: no exposure time"),
        ({"settings": ShotSettings(iso=400.0)}, r"1\.tif: expected ISO 100 as in 0\.tif, got 400"),
        ({"settings": ShotSettings(f_number=8.0)}, "expected aperture f/ 4 as in 0\\.tif, got 8"),
        ({"bits": 8}, r"1\.tif: 8 bits"),
        ({"linear": one.linear[:50], "saturated": one.saturated[:50]}, "96 x 50 pixels"),
    ):
        first, second = (
            replace(p, settings=ShotSettings(iso=100.0, f_number=4.0)) for p in (one, two)
        )
        with pytest.raises(InputError, match=message):
            merge_exposures([first, replace(second, **change)])
    with pytest.raises(InputError, match="at least one"):
        merge_exposures([])


def test_dark_frames() -> None:
    light, quiet = radiance(), Noise(0.0, 0.0)
    glow = np.full(light.shape, 0.03, np.float32)
    photo = exposed(light, 0.04, noise=quiet)
    lifted = Photograph(
        photo.linear + glow, photo.saturated, photo.rounding, Path("a.tif"), 16, 0.04
    )
    dark = Photograph(glow, photo.saturated & False, photo.rounding, Path("d.tif"), 16, 0.04)
    np.testing.assert_allclose(subtract_dark(lifted, [dark]).linear, photo.linear, atol=1e-6)
    other = replace(dark, exposure_s=1.0)
    with pytest.raises(InputError, match=r"a\.tif: no dark frame of 0\.04 s \(there are 1 s\)"):
        subtract_dark(lifted, [other])
    bright = replace(dark, linear=glow + 0.5)
    with pytest.raises(InputError, match=r"d\.tif: not dark"):
        subtract_dark(lifted, [bright])


def test_flat_field() -> None:
    x = np.linspace(-1, 1, 200)
    falloff = (1 / (1 + 0.4 * (x[None] ** 2 + x[:, None] ** 2)) ** 2).astype(np.float32)[..., None]
    sheet = np.repeat(0.7 * falloff, 3, 2)
    nothing = np.zeros((200, 200), bool)
    flat = Photograph(sheet, nothing, sheet * 0, Path("flat.tif"), 16, 0.1)
    scene = Photograph(0.3 * sheet, nothing, sheet * 0, Path("a.tif"), 16, 0.1)
    even = flatten(scene, flat_field(flat)).linear[20:-20, 20:-20]
    assert even.std() / even.mean() < 0.005
    full = Photograph(sheet, ~nothing, sheet * 0, Path("flat.tif"), 16, 0.1)
    with pytest.raises(InputError, match=r"flat\.tif: a flat field that is saturated"):
        flat_field(full)
    dark = Photograph(sheet * (x > 0)[None, :, None], nothing, sheet * 0, Path("flat.tif"), 16, 0.1)
    with pytest.raises(InputError, match="an evenly lit white sheet"):
        flat_field(dark)
    small = Photograph(sheet[:50], nothing[:50], sheet[:50], Path("b.tif"), 16, 0.1)
    with pytest.raises(
        InputError,
        match=r"b\.tif: expected the flat field's size of 200 x 200 pixels, got 200 x 50",
    ):
        flatten(small, flat_field(flat))


def test_an_unknown_response_is_recovered(tmp_path: Path) -> None:
    """Rationale: Debevec. Expected: the curve that the files were made with, to 3 % in the range
    where most pixels are, and radiance from it that does not depend on the exposure."""
    light = radiance(160)
    paths = []
    for t in TIMES:
        coded = np.clip(light * t * 1.5, 0, 1) ** (1 / 2.6)
        paths.append(tmp_path / f"{t}.png")
        cv2.imwrite(str(paths[-1]), np.rint(255 * coded).astype(np.uint8)[..., ::-1])
    response = recover_response(paths, TIMES)
    known = (np.arange(256) / 255) ** 2.6
    ratio = response[40:230] / known[40:230, None]
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.05
    photos = [
        read_linear(path, coded=response, exposure_s=t)
        for path, t in zip(paths, TIMES, strict=True)
    ]
    line = merge_exposures(photos).linearity
    assert line is not None
    assert line.median < 0.02
    with pytest.raises(InputError, match="three or more different exposures"):
        recover_response(paths[:2], TIMES[:2])
    with pytest.raises(InputError, match="no rising response"):
        recover_response(paths, TIMES[::-1])


@pytest.mark.slow
def test_real_mosaics_are_linear(shared: Path) -> None:
    """The issue's figures: median deviation <= 1.5 %, weighted 95 % quantile <= 5 %, each band."""
    folder = shared / "data" / "colorchecker" / "raw_bayer"
    times_ms = (25, 50, 100, 250, 500, 2000, 3916)

    def read(name: str, ms: int) -> Photograph:
        (path,) = folder.glob(name)
        return read_linear(path, pattern="GBRG", keep_mosaic=True, exposure_s=ms / 1000)

    darks = [read(f"d2_dark_{ms}ms*-000{n}.tif", ms) for ms in times_ms for n in (3, 4)]
    for band in (400, 450, 500, 550, 600, 650, 700):
        photos = [
            subtract_dark(read(f"d2_colorChecker30cm_{band}nm_{ms}ms*.tif", ms), darks)
            for ms in times_ms
        ]
        line = merge_exposures(photos).linearity
        assert line is not None
        assert line.median <= 0.015, band
        assert line.weighted_95 <= 0.05, band
        assert line.samples > 100_000
