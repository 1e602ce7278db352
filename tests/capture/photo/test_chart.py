"""Charts are found however they lie; what is no chart is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from raden_torch.capture.photo.chart import read_patches
from raden_torch.capture.photo.chart_reference import PATCH_NAMES, reference_xyz
from raden_torch.capture.photo.chart_search import chart_at, find_charts
from raden_torch.capture.photo.photograph import Photograph, read_stored
from raden_torch.errors import InputError

CENTRES = np.stack([np.arange(24) % 6 + 0.5, np.arange(24) // 6 + 0.5], -1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        {"turn_deg": 0},
        {"turn_deg": 37},
        {"turn_deg": 90, "exposure": 0.15},
        {"turn_deg": 143, "tilt": 0.4},
        {"turn_deg": 180, "noise": 0.03},
        {"turn_deg": -110, "width": 120},
        {"turn_deg": 20, "mirrored": True},
        {"turn_deg": -75, "mirrored": True, "tilt": 0.3},
        {"turn_deg": 10, "blur": 2.0},
        {"turn_deg": 5, "background": 0.02},
        {"turn_deg": 5, "background": 0.95},
        {"camera": np.array([[0.6, 0.3, 0.05], [0.2, 0.9, 0.1], [0.02, 0.3, 0.6]])},
    ],
)
def test_any_rotation_mirrored_or_not(chart_scene: Callable, how: dict) -> None:
    scene = chart_scene(**how)
    (chart,) = find_charts(scene.srgb, "a.png")
    off = np.linalg.norm(chart.pixels(CENTRES) - scene.at(CENTRES), axis=1)
    assert off.max() < 0.2 * chart.patch_px
    assert chart.mirrored == how.get("mirrored", False)
    turned = (chart.rotation_deg - how.get("turn_deg", 0) + 180) % 360 - 180
    if not chart.mirrored:
        assert abs(turned) < (15 if "tilt" in how else 2)


def test_large_photographs(chart_scene: Callable) -> None:
    """They are searched at a smaller size; the places are those of the whole photograph."""
    scene = chart_scene(turn_deg=30)
    large = cv2.resize(scene.srgb, None, fx=6.25, fy=6.25, interpolation=cv2.INTER_LINEAR)
    (chart,) = find_charts(large, "large.png")
    wanted = (scene.at(CENTRES) + 0.5) * 6.25 - 0.5
    assert np.linalg.norm(chart.pixels(CENTRES) - wanted, axis=1).max() < 0.2 * chart.patch_px


def test_several_charts(chart_scene: Callable) -> None:
    left = chart_scene(size=(480, 800), width=330, centre=(0.25, 0.45), noise=0.0)
    both = chart_scene(
        size=(480, 800),
        width=260,
        centre=(0.76, 0.5),
        turn_deg=90,
        onto=left.linear / 0.9,
        blur=0.4,
    )
    charts = find_charts(both.srgb, "two.png")
    assert len(charts) == 2
    assert charts[0].patch_px > charts[1].patch_px
    centres = [chart.corners.mean(axis=0) for chart in charts]
    np.testing.assert_allclose(centres, [[200, 216], [608, 240]], atol=10)


def test_cut_by_the_frame(chart_scene: Callable) -> None:
    scene = chart_scene(centre=(0.82, 0.5))
    with pytest.raises(
        InputError, match=r"cut\.png: (.*got a chart cut off by the frame|.*got no colour chart)"
    ):
        find_charts(scene.srgb, "cut.png")


@pytest.mark.parametrize("kind", ["nothing", "noise", "board", "swatches"])
def test_no_chart_is_an_error(kind: str) -> None:
    rng = np.random.default_rng(3)
    picture = np.full((300, 400, 3), 128, np.uint8)
    if kind == "noise":
        picture = rng.integers(0, 256, (300, 400, 3)).astype(np.uint8)
    if kind == "board":
        squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((50, 50)))
        picture = np.repeat(np.rint(255 * squares).astype(np.uint8)[..., None], 3, 2)
    if kind == "swatches":  # a grid of 24 colours that are not a ColorChecker's
        colours = rng.integers(20, 236, (4, 6, 3)).astype(np.uint8)
        for row in range(4):
            for column in range(6):
                y, x = 30 + 60 * row, 20 + 60 * column
                picture[y : y + 48, x : x + 48] = colours[row, column]
    with pytest.raises(InputError, match=r"x\.png: .*, got no colour chart.*give its four corners"):
        find_charts(picture, "x.png")


def test_by_hand(chart_scene: Callable) -> None:
    scene = chart_scene(turn_deg=25)
    corners = scene.at(np.array([[6, 0], [6, 4], [0, 4], [0, 0]], float))  # starting anywhere
    rough = corners + np.random.default_rng(4).normal(size=(4, 2)) * 3
    chart = chart_at(scene.srgb, rough, "a.png")
    assert np.abs(chart.pixels(CENTRES) - scene.at(CENTRES)).max() < 0.2 * chart.patch_px
    with pytest.raises(InputError, match="no chart's colours at the given corners"):
        chart_at(scene.srgb, [[5, 5], [90, 5], [90, 60], [5, 60]], "a.png")
    with pytest.raises(InputError, match="four points"):
        chart_at(scene.srgb, [[5, 5]], "a.png")


def test_patches_are_measured_in_linear_light(chart_scene: Callable) -> None:
    scene = chart_scene(noise=0.01, exposure=0.8)
    linear = scene.linear.astype(np.float32)
    saturated = np.zeros(linear.shape[:2], bool)
    x, y = scene.at(CENTRES)[18].astype(int)
    saturated[y - 8 : y + 8, x - 8 : x + 8] = True
    photo = Photograph(linear, saturated, linear * 0, Path("a.tif"))
    chart = find_charts(scene.srgb, "a.tif")[0]
    patches = read_patches(photo, chart)
    wanted = scene.linear[tuple(scene.at(CENTRES).round().astype(int)[:, ::-1].T)]
    assert np.abs(patches.rgb - wanted).max() < 0.04
    assert np.median(patches.spread) == pytest.approx(0.008, rel=0.4)
    assert np.flatnonzero(~patches.usable).tolist() == [PATCH_NAMES.index("white 9.5")]


def test_reference_under_d65() -> None:
    """Rationale: the published sRGB values of another source. Expected: the same colours."""
    from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

    rgb = reference_xyz("2014") @ xyz_to_rgb_matrix().T
    assert rgb[18] == pytest.approx([0.87, 0.89, 0.84], abs=0.03)
    assert reference_xyz("2005")[18, 1] == pytest.approx(0.913, abs=0.01)
    with pytest.raises(InputError, match="2014 or 2005"):
        reference_xyz("1976")


@pytest.mark.slow
def test_real_photographs(shared: Path) -> None:
    folder = shared / "data" / "colorchecker" / "photos"
    turned = {
        "calibrite-passport.png": -90,
        "classic.png": 90,
        "colorchecker-classic-mini.jpg": -90,
        "source_img_plant.jpg": 180,
    }
    for name, degrees in turned.items():
        picture = read_stored(folder / name)
        (chart,) = find_charts(picture, name)
        assert not chart.mirrored
        assert abs((chart.rotation_deg - degrees + 180) % 360 - 180) < 5, name
        (mirrored,) = find_charts(np.ascontiguousarray(picture[:, ::-1]), name)
        assert mirrored.mirrored, name
    for name in ("choriginal.jpg", "charucodefinition.png"):
        with pytest.raises(InputError, match="got no colour chart"):
            find_charts(read_stored(shared / "data" / "charuco" / name), name)


@pytest.mark.slow
def test_patches_of_the_real_mosaics(shared: Path) -> None:
    """The chart's patches were labelled by hand there: all that is measured lies within them."""
    from raden_torch.capture.photo.photograph import read_linear, shown

    folder = shared / "data" / "colorchecker" / "raw_bayer"
    bands = [
        read_linear(next(folder.glob(f"d2_colorChecker30cm_{name}*.tif")), pattern="GBRG").linear
        for name in ("650nm_100ms", "550nm_25ms", "450nm_50ms")
    ]
    picture = shown(np.stack([band[..., i] / band.max() for i, band in enumerate(bands)], -1))
    (chart,) = find_charts(picture, "bands")
    labels = cv2.imread(str(folder / "d2_colorChecker30cm_550nm_labels.png"), cv2.IMREAD_UNCHANGED)
    for i, square in enumerate(chart.squares()):
        inside = cv2.fillConvexPoly(np.zeros_like(labels), np.rint(square).astype(np.int32), 1)
        assert (labels[inside > 0] == i + 1).mean() > 0.98, PATCH_NAMES[i]
