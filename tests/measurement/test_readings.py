"""`BrdfMeasurement`: what it refuses, its grid view, its colour."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix


def readings(n: int = 4, **changes) -> BrdfMeasurement:
    columns = {
        "incidence_deg": np.arange(n) * 5.0,
        "receiving_deg": np.arange(n) * 10.0,
        "tilt_deg": np.zeros(n),
        "values": np.arange(3 * n, dtype=float).reshape(n, 3),
    }
    return BrdfMeasurement(**(columns | changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"incidence_deg": np.array([0.0, 5, 10, 95])},
            "reading 4: incidence_deg: expected 0…90 degrees, got 95",
        ),
        (
            {"incidence_deg": np.array([0.0, -5, 10, 15])},
            "reading 2: incidence_deg: expected 0…90 degrees, got -5",
        ),
        (
            {"tilt_deg": np.array([0.0, np.nan, 0, 0])},
            "reading 2: tilt_deg: expected a finite number, got nan",
        ),
        ({"tilt_deg": np.zeros(3)}, "tilt_deg: expected shape [4], got [3]"),
        ({"values": np.zeros((4, 2))}, "values: expected shape [4, 3], got [4, 2]"),
        ({"std": np.zeros((4, 2))}, "std: expected shape [4, 3], got [4, 2]"),
        (
            {"channels": ("X", "Y", "Q")},
            "channels: expected X, Y, Z or R, G, B or spectral bands (as 550nm), got X, Y, Q",
        ),
        ({"channels": ("550nm", "450nm", "650nm")}, "ascending"),
    ],
)
def test_wrong_columns_are_named(changes, words: str) -> None:
    with pytest.raises(InputError) as error:
        readings(**changes)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_no_readings_is_an_error() -> None:
    with pytest.raises(InputError, match="expected at least one reading, got none"):
        readings(0, values=np.zeros((0, 3)))


def test_nan_is_a_gap_and_infinity_an_error() -> None:
    values = np.ones((4, 3))
    values[1, 2] = np.nan
    assert readings(values=values).valid.tolist() == [True, False, True, True]
    values[1, 2] = np.inf
    with pytest.raises(InputError, match=r"reading 2: Z: expected a finite .*, got inf"):
        readings(values=values)


def test_readings_that_disagree_are_named_unless_their_spread_explains_it() -> None:
    same = {"incidence_deg": np.array([0.0, 5, 5, 10]), "receiving_deg": np.zeros(4)}
    values = np.array([[1.0] * 3, [10.0] * 3, [20.0] * 3, [3.0] * 3])
    with pytest.raises(
        InputError,
        match=r"readings 2 and 3: .*got X = 10 and 20 at the same geometry \(5, 0, 0 deg\)",
    ):
        readings(values=values, **same)
    assert len(readings(values=values, std=np.full((4, 3), 2.0), **same)) == 4
    close = readings(values=np.array([[1.0] * 3, [10.0] * 3, [10.2] * 3, [3.0] * 3]), **same)
    assert close.grid().values[1, 0, 0].tolist() == pytest.approx([10.1] * 3)


def test_grid_is_a_view_with_gaps() -> None:
    m = readings(
        4,
        incidence_deg=np.array([5.0, 0, 0, 5]),
        receiving_deg=np.array([0.0, 10, 0, 10]),
        valid=np.array([True, True, True, False]),
    )
    grid = m.grid()
    assert grid.incidence_deg.tolist() == [0, 5]
    assert grid.receiving_deg.tolist() == [0, 10]
    assert grid.values[1, 0, 0].tolist() == [0, 1, 2]
    assert grid.measured.tolist() == [[[True], [True]], [[True], [False]]]


def test_count_weighs_repeated_readings() -> None:
    m = readings(
        2,
        incidence_deg=np.zeros(2),
        receiving_deg=np.zeros(2),
        values=np.array([[10.0] * 3, [10.4] * 3]),
        count=np.array([3, 1]),
    )
    assert m.grid().values[0, 0, 0] == pytest.approx([10.1] * 3)


def test_scattered_readings_are_not_a_grid() -> None:
    generator = np.random.default_rng(0)
    u = generator.random((3, 500)) * 60
    m = BrdfMeasurement(*u, values=np.ones((500, 3)))
    with pytest.raises(InputError, match="expected readings on a grid, got 500 scattered ones"):
        m.grid()
    turned = replace(readings(), azimuth_deg=np.array([0.0, 0, 30, 30]))
    with pytest.raises(InputError, match="expected readings of one sample azimuth, got 2"):
        turned.grid()
    assert turned.select(turned.azimuth_deg == 30).grid().values.shape == (2, 2, 1, 3)


def test_hash_follows_the_numbers_only() -> None:
    m = readings()
    assert m.sha256 == readings(metadata=Metadata("other name")).sha256
    assert m.sha256 != readings(values=m.values + 1e-12).sha256


@pytest.mark.parametrize("white", ["D65", "D50", "A"])
def test_the_white_becomes_grey_rgb(white: str) -> None:
    """Rationale: a perfect diffuser is neutral under any light. Expected: R = G = B = 100."""
    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"][white]
    m = readings(1, values=100 * colour.xy_to_XYZ(xy)[None], metadata=Metadata(white=white))
    assert m.as_rgb().values == pytest.approx(np.full((1, 3), 100.0), abs=0.02)


def test_srgb_matrix_is_the_standard_one() -> None:
    """IEC 61966-2-1, amendment 1: the red primary's XYZ is a column of the inverse."""
    red = np.linalg.inv(xyz_to_rgb_matrix())[:, 0]
    assert red == pytest.approx([0.4124, 0.2126, 0.0193], abs=1e-4)


def test_rgb_goes_back_to_xyz() -> None:
    m = readings()
    back = m.as_rgb().as_xyz()
    assert back.values == pytest.approx(m.values, abs=1e-9)
    assert m.as_rgb().as_rgb() is not None


def test_spectra_become_xyz_as_colour_science_integrates_them() -> None:
    bands = np.arange(380, 781, 10)
    reflectance = 50 + 40 * np.sin(bands / 60.0)
    m = readings(1, values=reflectance[None], channels=tuple(f"{b}nm" for b in bands))
    sd = colour.SpectralDistribution(dict(zip(bands, reflectance / 100, strict=True)))
    shape = colour.SpectralShape(360, 780, 1)
    sd = sd.copy().align(shape, interpolator=colour.LinearInterpolator)
    expected = colour.sd_to_XYZ(
        sd,
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape),
        colour.SDS_ILLUMINANTS["D65"].copy().align(shape),
        method="Integration",
    )
    assert m.as_xyz().values[0] == pytest.approx(expected, rel=1e-6)
    flat = readings(1, values=np.full((1, 41), 100.0), channels=m.channels)
    assert flat.as_rgb().values == pytest.approx(np.full((1, 3), 100.0), abs=0.05)


def test_standard_deviations_follow_the_matrix() -> None:
    m = readings(1, std=np.array([[1.0, 0.0, 0.0]]))
    assert m.as_rgb().std[0] == pytest.approx(abs(xyz_to_rgb_matrix()[:, 0]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"channels": ("600nm", "620nm", "640nm")},
            "bands that span 400…700 nm, to make a colour, got 600…640 nm",
        ),
        (
            {"channels": ("400nm", "550nm", "700nm")},
            "expected bands at most .* nm apart, .* got 150 nm",
        ),
        ({"metadata": Metadata(white="D99")}, "white: .*got 'D99'"),
        ({"metadata": Metadata(observer="mine")}, "observer: .*got 'mine'"),
    ],
)
def test_what_has_no_colour_says_so(changes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        readings(**changes).as_rgb()
