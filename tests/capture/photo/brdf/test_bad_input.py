"""What a person may do wrong with a series of photographs, and what they are told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.brdf.capture_settings import (
    SampleSpec,
    WhiteFactorSpec,
    WhiteSpec,
)
from raden_torch.capture.photo.brdf.chart_white import chart_white
from raden_torch.capture.photo.capture_brdf import capture_brdf
from raden_torch.errors import InputError


def test_a_sample_that_moved_is_named(sphere: Any) -> None:
    with pytest.raises(InputError, match=r"photo3\.png: the sample moved: .* 3\.[0-9] pixels") as e:
        sphere.run(8, radius=100.0, moved={3: (2.0, -2.5)})
    assert "\n" not in str(e.value)


def test_half_a_pixel_is_no_movement(sphere: Any) -> None:
    found = sphere.run(8, radius=100.0, moved={3: (0.4, -0.3)})
    assert found.coverage.share > 0.4


def test_a_photograph_that_is_brighter_than_the_others_is_named(sphere: Any) -> None:
    """As by a shadow on the white: the sample's light is 25 % up, the white's is not."""
    with pytest.raises(InputError, match=r"photo2\.png: it contradicts .* brighter by 2[0-9] %"):
        sphere.run(lamps=sphere.triples, radius=70.0, sample_only={2: 1.25})


def test_going_on_all_the_same_warns_and_notes(sphere: Any) -> None:
    with pytest.warns(UserWarning, match=r"photo2\.png: it contradicts"):
        found = sphere.run(lamps=sphere.triples, radius=70.0, sample_only={2: 1.25}, go_on=True)
    assert any("contradicts" in note for note in found.notes)
    assert found.agreement.worst() == 2


def test_a_lamp_in_the_wrong_place_is_named(sphere: Any) -> None:
    with pytest.raises(
        InputError, match=r"photo4\.png: it contradicts .* its lamp or the sample moved"
    ):
        sphere.run(lamps=sphere.triples, radius=70.0, wrong_lamp={4: 25.0})


def test_too_little_coverage_says_what_would_help(sphere: Any) -> None:
    one = np.array([[0.2, 0.1, 1.0]]) / np.sqrt(1.05)
    with pytest.raises(
        InputError,
        match=r"expected readings in at least 5 % of the grid, got 0?[0-4]\.\d %\. "
        r".*would help most: the lamp \d+ deg",
    ):
        sphere.run(lamps=one, radius=40.0)


def test_fit_refuses_a_nearly_empty_grid_with_the_advice_of_its_file(sphere: Any) -> None:
    import raden_torch as rt

    found = sphere.run(8, radius=60.0).measurement
    rows = np.flatnonzero(found.valid)[::40]
    kept = np.zeros(len(found), bool)
    kept[rows] = True
    with pytest.raises(
        InputError, match=r"5 % of its 12615 cells, .*, got 0\.7 %.* with the lamp \d+ deg towards"
    ):
        rt.fit(replace(found, valid=kept))


def test_lamps_and_photographs_that_do_not_fit(sphere: Any) -> None:
    series = sphere.series(8, radius=40.0)
    arguments = sphere.arguments(series)
    photos = arguments.pop("photographs")
    setup = arguments.pop("setup")
    with pytest.raises(
        InputError,
        match=r"photo7\.png: lamp: expected .* 1 to 8 \(.*lights\.json has 8 lamps\), got 9",
    ):
        capture_brdf(photos, replace(setup, lamps=(1, 2, 3, 4, 5, 6, 7, 9)), **arguments)
    with pytest.raises(InputError, match=r"photo0\.png: its lamp is not in"):
        capture_brdf([*photos, photos[0]], setup, **arguments)
    with pytest.raises(InputError, match="got 8 lamps for 7 photographs"):
        capture_brdf(photos[:7], setup, **arguments)
    with pytest.raises(InputError, match=r"photo\d\.png: it is photograph 1, but lamp 1"):
        capture_brdf(photos[::-1], setup, **arguments)
    with pytest.raises(InputError, match=r"expected a whole number of stacks of 3, got 8 files"):
        capture_brdf(photos, replace(setup, stack=3), **arguments)


def test_no_white_and_over_exposed(sphere: Any) -> None:
    with pytest.raises(InputError, match="the white reference was not found: dark, over-exposed"):
        sphere.run(4, radius=60.0, exposure=2.0)
    series = sphere.series(4, radius=60.0, name="w")
    arguments = sphere.arguments(series)
    black = series.folder / "black.png"
    cv2.imwrite(str(black), np.zeros(cv2.imread(str(series.white)).shape[:2], np.uint8))
    with pytest.raises(
        InputError, match="expected a mask that is white on the object, got an empty one"
    ):
        capture_brdf(**(arguments | {"white": WhiteSpec(black)}))
    with pytest.raises(InputError, match=r"white reference: expected one place .*, got 0"):
        WhiteSpec()


def test_shapes_that_lack_something(sphere: Any, board: Any) -> None:
    with pytest.raises(InputError, match="cylinder: expected a mask that is white on it, got none"):
        SampleSpec("cylinder")
    with pytest.raises(
        InputError, match="plane: expected its corners on the board, or a mask, got neither"
    ):
        SampleSpec("plane")
    with pytest.raises(InputError, match="shape: expected sphere, plane or cylinder, got 'cube'"):
        SampleSpec("cube")
    series = sphere.series(4, radius=60.0)
    with pytest.raises(InputError, match="the board's pose in it is not known"):
        capture_brdf(**(sphere.arguments(series) | {"sample": SampleSpec("plane", series.mask)}))
    with pytest.raises(InputError, match=r"got no two long straight edges|not straight"):
        capture_brdf(**(sphere.arguments(series) | {"sample": SampleSpec("cylinder", series.mask)}))
    lights = json.loads(Path(series.lights).read_text())
    for lamp in lights["lamps"]:
        lamp["position_mm"] = [0.0, 0.0, 500.0]
    lights["unit"] = "mm"
    Path(series.lights).write_text(json.dumps(lights))
    with pytest.raises(InputError, match=r"positions are in mm; give the camera file"):
        capture_brdf(**sphere.arguments(series))


@pytest.mark.parametrize(
    ("factor", "file", "std", "said"),
    [
        (None, None, 0.0, "white: expected its reflectance factor, got none"),
        ("98", "x.csv", 0.0, "expected a factor or a file, got both"),
        ("zwei", None, 0.0, "reflectance factor: expected .*, got zwei"),
        ("0", None, 0.0, "above 0"),
        ("95,100", None, 0.0, "one number or X,Y,Z"),
        (None, "x.csv", 0.0, "no such file"),
        ("98", None, 120.0, "standard uncertainty: expected .*, got 120"),
    ],
)
def test_the_white_has_a_factor(factor: str, file: str, std: float, said: str) -> None:
    with pytest.raises(InputError, match=said):
        chart_white(None, WhiteFactorSpec(factor, None if file is None else Path(file), std))
