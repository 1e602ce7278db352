"""True colour, channels and letters."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest

from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.plot_style import brightest, curves, families, printable, true_colour
from raden_torch.plots.view import view_of


def test_true_colour_is_srgb_of_the_exposed_value() -> None:
    rgb = np.random.default_rng(0).uniform(-0.2, 3.0, (4, 5, 3))
    shown = true_colour(rgb, 2.0)
    expected = colour.cctf_encoding(np.clip(rgb / 2.0, 0, 1), "sRGB")
    np.testing.assert_allclose(shown[..., :3], expected, atol=1e-5)
    assert (shown[..., 3] == 1).all()


def test_without_a_white_the_largest_value_is_1() -> None:
    rgb = np.array([[0.5, 4.0, 1.0], [np.nan, 1.0, 1.0]])
    shown = true_colour(rgb)
    assert shown[0, 1] == pytest.approx(1.0)
    assert shown[:, 3].tolist() == [1.0, 0.0]  # what was not measured is transparent
    np.testing.assert_array_equal(true_colour(rgb[:1], np.array([4.0])), shown[:1])


@pytest.mark.parametrize(
    ("rgb", "largest"), [([1.0, 3.0], 3.0), ([np.nan, 2.0], 2.0), ([-1.0, 0.0], 1.0), ([], 1.0)]
)
def test_the_largest_value_or_1(rgb: list[float], largest: float) -> None:
    assert brightest(np.array(rgb)) == largest


def test_channels_differ_in_colour_and_marker() -> None:
    m = BrdfMeasurement([0.0, 5.0], [0.0, 5.0], [0.0, 0.0], values=np.full((2, 3), 50.0))
    found = curves(view_of(m))
    assert [(curve.channel, curve.name) for curve in found] == [(0, "R"), (1, "G"), (2, "B")]
    assert len({curve.colour for curve in found}) == len({curve.marker for curve in found}) == 3
    band = replace(m, values=m.values[:, :1], channels=("550nm",))
    assert [curve.name for curve in curves(view_of(band))] == ["550 nm"]


def test_letters_that_no_font_has_become_question_marks() -> None:
    assert printable("shell 12 µm") == "shell 12 µm"
    assert printable("a\U000f0000b") == "a?b"
    assert families("shell")[0] in families("shell µ")
