"""XYZ, RGB, f_r and bands: against colour-science and by hand."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import (
    as_rgb,
    as_xyz,
    bands_to_xyz_matrix,
    f_r_of_xyz,
    matrix_to,
    why_no_colour,
    xyz_of_f_r,
    xyz_to_rgb_matrix,
)

TWO, TEN = "CIE 1931 2 Degree Standard Observer", "CIE 1964 10 Degree Standard Observer"
BANDS = tuple(f"{nm}nm" for nm in range(380, 781, 10))


def reading(values: np.ndarray, channels=("X", "Y", "Z"), **metadata) -> BrdfMeasurement:
    rows = np.atleast_2d(values)
    n = len(rows)
    at = np.arange(float(n))
    return BrdfMeasurement(
        at, np.zeros(n), np.zeros(n), rows, tuple(channels), metadata=Metadata(**metadata)
    )


@pytest.mark.parametrize("white", ["D65", "D50", "A", "E", "D55"])
@pytest.mark.parametrize(("observer", "name"), [("CIE 1931 2 deg", TWO), ("CIE 1964 10 deg", TEN)])
def test_the_matrix_is_colour_sciences(white: str, observer: str, name: str) -> None:
    """Bradford from the white to D65 (2°), then the sRGB matrix. The tolerance is that of the
    standard's primaries, which are rounded."""
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    source = colour.xy_to_XYZ(colour.CCS_ILLUMINANTS[name][white])
    target = colour.xy_to_XYZ(colour.CCS_ILLUMINANTS[TWO]["D65"])
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(source, target, "Bradford")
    expected = srgb.matrix_XYZ_to_RGB @ adapt
    np.testing.assert_allclose(xyz_to_rgb_matrix(white, observer), expected, atol=2e-3)
    np.testing.assert_allclose(xyz_to_rgb_matrix(white, observer) @ source, 1.0, atol=1e-3)


def test_f_r_of_the_perfect_diffuser_is_1_over_pi() -> None:
    white = 100 * colour.xy_to_XYZ(colour.CCS_ILLUMINANTS[TWO]["D65"])
    np.testing.assert_allclose(f_r_of_xyz(white), 1 / np.pi, rtol=1e-3)
    xyz = np.random.default_rng(0).uniform(-5, 300, (4, 5, 3))
    np.testing.assert_allclose(xyz_of_f_r(f_r_of_xyz(xyz)), xyz, rtol=1e-12, atol=1e-10)


def test_iridescent_colours_keep_their_negative_values() -> None:
    """A spectral green lies outside sRGB: its red is below 0, and comes back."""
    green = 100 * colour.wavelength_to_XYZ(520)
    rgb = as_rgb(reading(green)).values[0]
    assert rgb[0] < 0 < rgb[1]
    np.testing.assert_allclose(as_xyz(as_rgb(reading(green))).values[0], green, rtol=1e-12)


@pytest.mark.parametrize("white", ["D65", "D50", "A"])
@pytest.mark.parametrize(("observer", "name"), [("CIE 1931 2 deg", TWO), ("CIE 1964 10 deg", TEN)])
def test_a_flat_spectrum_is_the_white(white: str, observer: str, name: str) -> None:
    """The sum of each row is the white's, whatever the bands are."""
    for bands in (BANDS, tuple(f"{nm}nm" for nm in range(400, 701, 20))):
        m = reading(np.full(len(bands), 100.0), bands, white=white, observer=observer)
        expected = 100 * colour.xy_to_XYZ(colour.CCS_ILLUMINANTS[name][white])
        np.testing.assert_allclose(as_xyz(m).values[0], expected, atol=0.05)
        np.testing.assert_allclose(bands_to_xyz_matrix(m).sum(axis=1), expected / 100, atol=5e-4)


def test_bands_are_joined_linearly() -> None:
    """Of a spectrum that is linear in the wavelength, coarse bands make the XYZ of fine ones."""
    slope = lambda nm: 20 + 0.1 * (nm - 380.0)  # noqa: E731
    fine, coarse = np.arange(380, 781, 5.0), np.arange(380, 781, 40.0)
    xyz = [as_xyz(reading(slope(nm), [f"{n:g}nm" for n in nm])).values[0] for nm in (fine, coarse)]
    np.testing.assert_allclose(xyz[1], xyz[0], rtol=1e-9)


def test_matrices_join() -> None:
    """From bands to RGB is from bands to XYZ to RGB; to its own channels it is the identity."""
    m = reading(np.full(len(BANDS), 50.0), BANDS, white="D50")
    rgb, xyz = matrix_to(m, ("R", "G", "B")), matrix_to(m, ("X", "Y", "Z"))
    np.testing.assert_allclose(rgb, xyz_to_rgb_matrix("D50") @ xyz, rtol=1e-12)
    np.testing.assert_array_equal(matrix_to(m, BANDS), np.eye(len(BANDS)))
    pairs = (("XYZ", "RGB"), ("RGB", "XYZ"))
    to_rgb, back = (matrix_to(reading(np.ones(3), c), tuple(d)) for c, d in pairs)
    np.testing.assert_allclose(back @ to_rgb, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("bands", "why"),
    [
        ((400, 440, 480, 520, 560, 600, 640, 680, 700), None),
        ((420, 460, 500, 540, 580, 620, 660, 680), None),
        (
            (421, 460, 500, 540, 580, 620, 660, 700),
            "expected bands that span 400…700 nm, to make a colour, got 421…700 nm",
        ),
        (
            (400, 440, 480, 520, 560, 600, 640, 679),
            "expected bands that span 400…700 nm, to make a colour, got 400…679 nm",
        ),
        (
            (400, 441, 480, 520, 560, 600, 640, 680),
            "expected bands at most 40 nm apart, to make a colour, got ",
        ),
        ((550,), "expected bands that span 400…700 nm, to make a colour, got 550…550 nm"),
    ],
)
def test_which_bands_make_a_colour(bands: tuple[int, ...], why: str | None) -> None:
    m = reading(np.full(len(bands), 50.0), [f"{nm}nm" for nm in bands])
    said = why_no_colour(m)
    assert (said is None) == (why is None) == m.has_colour
    if why is not None:
        assert said is not None
        assert said.startswith(why)
        with pytest.raises(InputError, match=r"^measurement: expected bands "):
            as_xyz(m)


def test_a_white_without_a_spectrum_is_refused_for_bands() -> None:
    m = reading(np.full(len(BANDS), 50.0), BANDS, white="ICC D50")
    with pytest.raises(InputError, match=r"expected a white whose spectrum is known.*got ICC D50"):
        as_xyz(m)
