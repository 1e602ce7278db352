"""The figures that check a capture: lamps, normals and coverage stand where they were found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.highlight import Highlight
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.capture.photo.photo_set import PhotoSet
from raden_torch.capture.photo.photometric_stereo import SurfaceNormals
from raden_torch.plots.capture_figures import draw_lamps, draw_normals
from raden_torch.plots.coverage_figure import draw_coverage


@pytest.fixture(scope="module")
def lamps() -> Lamps:
    """On the right at 30° from the axis, above at 45°, on the left at 60°."""
    away, turn = np.radians([30, 45, 60]), np.radians([0, 90, 180])
    flat = np.stack([np.cos(turn), np.sin(turn)], axis=1) * np.sin(away)[:, None]
    return Lamps(np.column_stack([flat, np.cos(away)]), np.array([0.5, 1.0, 1.5]))


def titled(figure: Figure, title: str) -> Any:
    (found,) = [ax for ax in figure.axes if ax.get_title().startswith(title)]
    return found


def check_dial(ax: Any, lamps: Lamps) -> None:
    (points,) = ax.collections
    turn, away = np.transpose(points.get_offsets())
    np.testing.assert_allclose(np.degrees(turn), [0, 90, 180], atol=1e-9)
    np.testing.assert_allclose(away, [30, 45, 60])
    sizes = points.get_sizes()
    np.testing.assert_allclose(sizes / sizes.max(), lamps.intensity / 1.5)
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["right", "up", "left", "down"]


def test_lamps_their_images_and_the_dial(lamps: Lamps) -> None:
    images = torch.rand(3, 3, 40, 60, generator=torch.Generator().manual_seed(0))
    photos = PhotoSet(images, images[:, :1] > 2, tuple(Path(f"{k}.png") for k in "abc"))
    ball = Ball(30.0, 20.0, 12.0, 0.1, np.zeros(3), 12.0, None, "ball.png")
    spots = [(36.0, 20.0), (30.0, 14.0), (22.0, 20.0)]
    figure = draw_lamps(photos, [ball], [[Highlight(*spot, 9, "a.png")] for spot in spots], lamps)
    ax = titled(figure, "The balls")
    brightest = images.amax(dim=0).movedim(0, -1).numpy() ** (1 / 2.2)
    np.testing.assert_allclose(ax.images[0].get_array(), brightest, rtol=1e-6)
    outline = np.transpose(ax.lines[0].get_data())
    np.testing.assert_allclose(np.hypot(*(outline - [30, 20]).T), 12.0)
    np.testing.assert_array_equal(ax.collections[0].get_offsets(), spots)
    numbered = {text.get_text(): text.xy for text in ax.texts}
    assert numbered == {"1": spots[0], "2": spots[1], "3": spots[2]}
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (pixels)", "y (pixels)")
    low, high = ax.get_ylim()
    assert low > high  # rows go down
    check_dial(titled(figure, "Directions to the lamps"), lamps)


@pytest.fixture(scope="module")
def found() -> tuple[SurfaceNormals, np.ndarray]:
    """Normals that lean to the right in the left half of a masked rectangle, up in the other."""
    mask = np.zeros((30, 40))
    mask[10:20, 12:28] = 1.0
    normal = torch.zeros(1, 3, 30, 40)
    normal[:, :, 10:20, 12:20] = torch.tensor([0.6, 0.0, 0.8]).view(1, 3, 1, 1)
    normal[:, :, 10:20, 20:28] = torch.tensor([0.0, 0.6, 0.8]).view(1, 3, 1, 1)
    inside = torch.as_tensor(mask, dtype=torch.float32)[None, None]
    return SurfaceNormals(
        normal=normal,
        albedo=0.25 * inside,
        confidence=0.5 * inside,
        error_deg=inside,
        lamps_used=3 * inside,
        lamp_residual=torch.tensor([0.01, 0.02, 0.09]),
        intensity=torch.ones(3),
    ), mask


def test_normals_albedo_confidence_and_residuals(found, lamps: Lamps) -> None:
    surface, mask = found
    names = [Path("north.png"), Path("east $1.png"), Path("west.png")]
    figure = draw_normals(surface, lamps, names, mask)
    window = slice(2, 28), slice(4, 36)  # eight pixels around the mask
    expected = (surface.normal[0].movedim(0, -1).numpy() + 1) / 2 * mask[..., None]
    shown = titled(figure, "normals").images[0].get_array()
    np.testing.assert_allclose(shown, expected[window], atol=1e-6)
    albedo = titled(figure, "albedo").images[0].get_array()
    np.testing.assert_allclose(albedo[8:18, 8:24], 1.0)  # of the brightest
    confidence = titled(figure, "confidence").images[0]
    np.testing.assert_allclose(confidence.get_array(), 0.5 * mask[window])
    assert confidence.get_clim() == (0, 1)
    bars = titled(figure, "How each photograph disagrees")
    np.testing.assert_allclose([bar.get_height() for bar in bars.patches], [1, 2, 9], rtol=1e-6)
    colours = [bar.get_facecolor() for bar in bars.patches]
    assert colours[0] == colours[1] != colours[2]  # one is far from the median
    assert bars.get_ylabel() == "residual (% of the albedo)"
    of_material = draw_normals(surface, lamps, names, mask, by_material=True)
    titled(of_material, "factor on the material")
    label = titled(of_material, "How each photograph disagrees").get_ylabel()
    assert label == "residual (% of a pixel's mean light\nover all lamps)"
    assert [tick.get_text() for tick in bars.get_xticklabels()] == ["north", "east $1", "west"]
    check_dial(titled(figure, "Directions to the lamps"), lamps)


def test_coverage_shows_each_slab_with_receiving_across() -> None:
    """Expected: a cell's number of samples at (receiving, tilt), what would be added beside it."""
    count = np.zeros((3, 5, 5), int)
    count[1, 4, 0] = 7  # incidence 10, receiving 20, tilt −20
    added = np.zeros(count.shape, bool)
    added[1, 4, 0] = added[1, 0, 2] = True
    figure = draw_coverage(count, added, 10.0, 20.0, "a shell", simulated=True)
    titles = [f"incidence {incidence}°" for incidence in (0, 10, 20)]
    assert [ax.get_title() for ax in figure.axes[:3]] == titles
    fresh, there = (image.get_array() for image in figure.axes[1].images)
    rows, columns = np.nonzero(~np.ma.getmaskarray(there))
    assert (rows.tolist(), columns.tolist()) == ([0], [4])  # the lowest tilt is the first row
    assert there[0, 4] == 7
    # what is covered is not called new
    rows, columns = np.nonzero(~np.ma.getmaskarray(fresh))
    assert (rows.tolist(), columns.tolist()) == ([2], [0])
    assert figure.axes[1].images[1].get_extent() == [-25, 25, -25, 25]
    assert figure.axes[1].images[1].origin == "lower"
    assert figure.axes[1].lines[0].get_xdata()[0] == 10  # the mirror
    assert figure.axes[0].get_xlabel() == "receiving (°)"
    assert figure.axes[0].get_ylabel() == "tilt (°)"
    assert figure.axes[-1].get_ylabel() == "samples in a cell"
    assert figure.get_suptitle().startswith("a shell\ngrey: nothing; orange:")
