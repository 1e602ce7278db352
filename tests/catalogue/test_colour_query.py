"""Lab against colour-science, and rankings against what follows from the formula by hand."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from raden_torch.catalogue import ColourQuery, Geometry
from raden_torch.catalogue.colour_query import HUES, chroma_and_hue
from raden_torch.catalogue.lab_grid import lab_of_f_r, rgb_of_lab
from raden_torch.colorimetry import D65_XYZ, lab_of, xyz_of
from raden_torch.errors import InputError


def test_lab_is_colour_sciences_and_turns_back() -> None:
    """From black and values below it (noise) to five times the white."""
    xyz = np.random.default_rng(0).uniform(-0.02, 5, (200, 3)) * D65_XYZ
    lab = lab_of(xyz, D65_XYZ)
    white = D65_XYZ / D65_XYZ.sum()
    bright = (xyz > 0.01 * D65_XYZ).all(axis=1)
    np.testing.assert_allclose(
        lab[bright], colour.XYZ_to_Lab(xyz[bright] / 100, white[:2]), atol=1e-6
    )
    np.testing.assert_allclose(xyz_of(lab, D65_XYZ), xyz, atol=1e-9)


def test_the_perfect_diffuser_is_white() -> None:
    np.testing.assert_allclose(lab_of_f_r(np.full(3, 1 / np.pi)), [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(rgb_of_lab(np.array([100.0, 0, 0])), 1, atol=1e-9)


def test_the_greenest_reaches_furthest_towards_green() -> None:
    """Each colour by lightness, chroma and hue: at the hue itself its whole chroma counts, beside
    it the cosine, across from it less than nothing."""
    green = ColourQuery.read("green")
    assert green.hue_deg == 162
    colours = [(50, 30, 162), (90, 40, 222), (20, 10, 342)]
    hue = np.deg2rad([h for *_, h in colours])
    lightness, chroma = np.array([(x, c) for x, c, _ in colours], float).T
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)
    np.testing.assert_allclose(green.scores(lab), [30, 20, -10], atol=1e-9)
    saturation = ColourQuery.read("green", "saturation").scores(lab)
    np.testing.assert_allclose(
        saturation, np.array([30, 20, -10]) / np.hypot(chroma, lightness), atol=1e-9
    )


@pytest.mark.parametrize(
    ("text", "hue"), [("緑", 162), ("Green", 162), ("青", 246), ("24", 24), ("300°", 300)]
)
def test_hues(text: str, hue: float) -> None:
    assert ColourQuery.read(text).hue_deg == hue


def test_hues_between_two_unique_ones_stand_at_equal_steps() -> None:
    steps = np.diff([*HUES.values(), 24.0 + 360])
    np.testing.assert_allclose(steps, [33, 33, 36, 36, 42, 42, 34.5, 34.5, 34.5, 34.5])


def test_a_colour_is_ranked_by_ciede2000() -> None:
    """A pair of Sharma, Wu and Dalal's test data: 2.0425."""
    query = ColourQuery.read("lab:50,2.6772,-79.7751")
    lab = np.array([[50, 0, -82.7485], [50, 2.6772, -79.7751]])
    np.testing.assert_allclose(query.scores(lab), [2.0425, 0], atol=1e-4)
    assert query.best_is_least


def test_a_colour_in_hexadecimal_is_srgb() -> None:
    rgb = np.array([0x3F, 0xA2, 0x7C]) / 255
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    expected = colour.XYZ_to_Lab(colour.sRGB_to_XYZ(rgb), white)
    np.testing.assert_allclose(ColourQuery.read("#3FA27C").lab, expected, atol=0.05)
    assert ColourQuery.read("white").lab == ColourQuery.read("白").lab == (100, 0, 0)


@pytest.mark.parametrize("text", ["", "grean", "361", "-1", "#12345", "lab:1,2", "lab:1,2,nan"])
def test_no_colour(text: str) -> None:
    with pytest.raises(InputError, match="colour`: expected a name"):
        ColourQuery.read(text)


def test_chroma_and_hue() -> None:
    np.testing.assert_allclose(chroma_and_hue((50, -3.0, -4.0)), (5, 233.1301), atol=1e-4)


@pytest.mark.parametrize(
    "angles", [(81.0,), (-1.0,), (40.0, 90.0), (40.0, 0.0, 61.0), (float("nan"),)]
)
def test_angles_beyond_the_index(angles: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"expected .*degrees, got"):
        Geometry(*angles)
