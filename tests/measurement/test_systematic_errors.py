"""Errors that all readings share: their header entries, and what a zero that is off does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.measurement.systematic_errors import SystematicErrors, zero_sensitivity

shares, zeros, angles = st.floats(0, 0.99), st.floats(0, 10), st.floats(-89.9, 89.9)


@given(
    scale=shares,
    white=shares,
    zero=st.tuples(zeros, zeros, zeros),
    at=st.none() | st.tuples(angles, angles, angles),
)
def test_entries_are_read_back_to_the_bit(scale, white, zero, at) -> None:
    stated = SystematicErrors(scale, "tile 12", white, zero, at)
    assert SystematicErrors.from_entries(dict(stated.as_entries())) == stated


def test_what_is_not_stated_is_not_written() -> None:
    assert SystematicErrors().as_entries() == ()
    assert SystematicErrors(0.01, zero_std_deg=(0, 0.1, 0)).as_entries() == (
        ("scale_std", "0.01"),
        ("zero_std_deg", "0 0.1 0"),
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale_std": 1.0}, "scale_std: expected 0…1, got 1"),
        ({"white_mean_std": -0.1}, "white_mean_std: expected 0…1, got -0.1"),
        ({"scale_std": float("nan")}, "scale_std: expected 0…1, got nan"),
        ({"zero_std_deg": (0.0, 11.0, 0.0)}, "expected three numbers in 0…10 degrees"),
        ({"white_deg": (0.0, 0.0, 90.0)}, "white_deg: expected three angles between -90 and 90"),
    ],
)
def test_numbers_out_of_their_range_are_named(changes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SystematicErrors(**changes)


@pytest.mark.parametrize("text", ["1 2", "1 2 x", "1 2 nan", ""])
def test_an_entry_that_is_not_three_numbers(text: str) -> None:
    with pytest.raises(InputError, match=r"zero_std_deg: expected 3 numbers separated by spaces"):
        SystematicErrors.from_entries({"zero_std_deg": text})


def sample(angles_deg: np.ndarray) -> np.ndarray:
    """A smooth reflectance factor of the three angles, and its slopes below."""
    a, r, t = angles_deg.T
    return 30 + 0.2 * a - 0.1 * r + 0.05 * t + 0.002 * a * r


def slopes(angles_deg: np.ndarray) -> np.ndarray:
    a, r, _ = angles_deg.T
    return np.stack([0.2 + 0.002 * r, -0.1 + 0.002 * a, np.full(len(a), 0.05)], axis=1)


def read(angles_deg: np.ndarray, zero: np.ndarray, white_deg: np.ndarray) -> np.ndarray:
    """What a scan says whose zeros are off: the sample and the white are lit and seen elsewhere
    than at the angles that the reduction takes for theirs."""

    def cosines(at: np.ndarray) -> np.ndarray:
        radians = np.radians(at)
        return np.cos(radians[..., 0]) * np.cos(radians[..., 2])

    radiance = sample(angles_deg + zero) * cosines(angles_deg + zero)
    white = cosines(white_deg + zero)
    return radiance / white * cosines(white_deg) / cosines(angles_deg)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_sensitivity_is_the_derivative_of_a_scan(axis: int) -> None:
    rng = np.random.default_rng(1)
    angles_deg = rng.uniform([5, -60, -60], [70, 60, 60], (40, 3))
    white_deg = np.array([45.0, 0.0, 10.0])
    step = np.eye(3)[axis] * 1e-4
    numeric = read(angles_deg, step, white_deg) - read(angles_deg, -step, white_deg)
    found = zero_sensitivity(
        sample(angles_deg)[:, None], angles_deg, slopes(angles_deg)[:, None], tuple(white_deg)
    )
    np.testing.assert_allclose(found[:, 0, axis], numeric / 2e-4, rtol=1e-5, atol=1e-7)


def test_without_a_white_geometry_only_the_slope_counts() -> None:
    angles_deg = np.array([[60.0, 10.0, 30.0]])
    found = zero_sensitivity(
        sample(angles_deg)[:, None], angles_deg, slopes(angles_deg)[:, None], None
    )
    np.testing.assert_array_equal(found[:, 0], slopes(angles_deg))


def test_grazing_incidence_stays_finite() -> None:
    angles_deg = np.array([[90.0, 0.0, 0.0], [0.0, 0.0, -90.0]])
    found = zero_sensitivity(np.ones((2, 3)), angles_deg, np.zeros((2, 3, 3)), (0.0, 0.0, 0.0))
    assert np.isfinite(found).all()
