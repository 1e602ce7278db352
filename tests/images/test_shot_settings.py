"""What EXIF says of how photographs were taken: what may differ within a set, and what may not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from raden_torch.capture.photo.photo_set import read_set
from raden_torch.errors import InputError
from raden_torch.images.shot_settings import (
    ShotSettings,
    check_alike,
    relative_exposures,
    settings_in_words,
    settings_of,
)

USUAL = {33434: 0.01, 33437: 4.0, 34855: 100, 37386: 50.0, 42036: "50mm", 42033: "77", 41987: 1}


def photograph(path: Path, level: int, **changed: Any) -> Path:
    """An even sRGB picture whose EXIF is `USUAL`, but for tags named `_number`."""
    tags = USUAL | {int(name[1:]): value for name, value in changed.items()}
    exif = Image.Exif()
    exif[271], exif[272] = "Maker", "Maker One"
    if 272 in tags:
        exif[272] = tags.pop(272)
    exif.get_ifd(0x8769).update(tags)
    pixels = np.full((24, 32, 3), level, np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)
    return path


def linear(level: int) -> float:
    return float(((level / 255 + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"_272": "Maker Two"}, "camera: expected Maker One as in {}, got Maker Two"),
        ({"_42033": "78"}, "serial number of the camera: expected 77 as in {}, got 78"),
        ({"_42036": "24-70mm"}, "lens: expected 50mm as in {}, got 24-70mm"),
        ({"_37386": 70.0}, "focal length in mm: expected 50 as in {}, got 70"),
        ({"_41987": 0}, "white balance: expected manual as in {}, got automatic"),
        ({"_274": 3}, "orientation by EXIF: expected 1 as in {}, got 3"),
    ],
)
def test_what_may_not_differ(tmp_path: Path, changed: dict[str, Any], said: str) -> None:
    first = photograph(tmp_path / "0.png", 90)
    second = photograph(tmp_path / "1.png", 90)
    third = photograph(tmp_path / "2.png", 90, **changed)
    with pytest.raises(InputError) as caught:
        read_set([first, second, third])
    assert str(caught.value).startswith(f"{third}: {said.format(first)}; photographs that belong")


def test_nothing_is_compared_with_nothing(tmp_path: Path) -> None:
    path = photograph(tmp_path / "0.png", 90)
    Image.fromarray(np.full((24, 32, 3), 90, np.uint8)).save(tmp_path / "1.png")
    images = read_set([path, tmp_path / "1.png"]).images
    np.testing.assert_allclose(images, linear(90), rtol=1e-5)


@pytest.mark.parametrize(
    ("changed", "times", "words"),
    [
        ({"_34855": 200}, 2.0, "ISO"),
        ({"_33437": 8.0}, 0.25, "aperture"),
        ({"_33434": 0.02, "_34855": 50}, 1.0, "exposure time, ISO"),
        ({"_33434": 0.04}, 4.0, "exposure time"),
    ],
)
def test_other_exposures_are_scaled(
    tmp_path: Path, changed: dict[str, Any], times: float, words: str
) -> None:
    """Expected: light at the first one's exposure, t · ISO / f-number²; a warning says so."""
    paths = [photograph(tmp_path / "0.png", 90), photograph(tmp_path / "1.png", 90, **changed)]
    with pytest.warns(UserWarning, match=rf"1\.png: {words} differ from .*0\.png: .* {times:.3g} "):
        images = read_set(paths).images
    np.testing.assert_allclose(images[0], linear(90), rtol=1e-5)
    np.testing.assert_allclose(images[1], linear(90) / times, rtol=1e-5)


def test_a_tag_that_one_file_lacks_does_not_scale() -> None:
    shots = [(Path("a"), ShotSettings(iso=100.0)), (Path("b"), ShotSettings())]
    assert relative_exposures(shots) is None
    with pytest.raises(InputError, match=r"b: expected its ISO in its EXIF"):
        relative_exposures([*shots, (Path("c"), ShotSettings(iso=200.0))])
    check_alike([(Path("a"), ShotSettings(camera="A")), *shots])


def test_strange_tags() -> None:
    said = settings_of({33434: (0, 0), 34855: (200, 100), 33437: "x", 271: b"Ma\0ker", 37386: -1})
    assert said == ShotSettings(iso=200.0, camera="Ma")
    assert settings_in_words(ShotSettings()) == []
    words = settings_in_words(ShotSettings(2.5, 100, 5.6, None, "A B", "7", "L", "manual"))
    assert words == [
        "camera: A B, number 7, L",
        "exposure: 2.5 s, f/5.6, ISO 100, white balance manual",
    ]
