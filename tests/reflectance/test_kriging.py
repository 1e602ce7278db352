"""Kriging: through its readings, and the same at equivalent geometries."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.kriging import Kriging
from raden_torch.reflectance.log_readings import FLOOR, MAX_READINGS, LogReadings
from raden_torch.reflectance.symmetry import canonical


@pytest.fixture
def angles() -> np.ndarray:
    """Few enough that all of them are neighbours of all."""
    drawn = np.random.default_rng(0).random((60, 3)) * [40.0, 40.0, 40.0]
    return drawn + np.array([30.0, 0.0, -20.0])


def smooth(angles: np.ndarray) -> np.ndarray:
    a, r, t = np.radians(angles).T
    return np.stack([np.cos(a + r) + np.sin(t), 3 * np.cos(r - a)], axis=1)


def test_it_goes_through_its_readings_and_between_them(angles: np.ndarray) -> None:
    kriging = Kriging(angles, smooth(angles))
    found, std = kriging.with_std(angles)
    np.testing.assert_allclose(found, smooth(angles), atol=1e-4)
    assert std.max() < 2e-3
    inside = angles[:30] / 2 + angles[30:] / 2
    np.testing.assert_allclose(kriging(inside), smooth(inside), atol=0.02)
    assert kriging.with_std(angles + np.array([0.0, 0.0, 90.0]))[1].min() > 0.9


def test_leaving_one_out_is_fitting_without_it(angles: np.ndarray) -> None:
    values = smooth(angles)
    error, std = Kriging(angles, values, 1e-3).leave_one_out(np.arange(5))
    for row in range(5):
        others = np.arange(len(angles)) != row
        without = Kriging(angles[others], values[others], 1e-3)
        found, unit = without.with_std(angles[row : row + 1])
        np.testing.assert_allclose(error[row], found[0] - values[row], atol=1e-6)
        # what is left out has its own noise, too
        np.testing.assert_allclose(std[row] ** 2, unit[0] ** 2 + 1e-3, atol=1e-5)


def test_equivalents_at_incidence_0_are_one() -> None:
    angles = np.random.default_rng(1).random((40, 3)) * [19.0, 60.0, 60.0]
    angles -= [0.0, 30.0, 30.0]
    kriging = Kriging(angles, smooth(angles))
    at = np.stack([np.zeros(20), np.linspace(0, 30, 20), np.linspace(-20, 25, 20)], axis=1)
    np.testing.assert_allclose(kriging(at), kriging(-at), atol=1e-6)
    np.testing.assert_array_equal(canonical(-at)[1:], at[1:])
    np.testing.assert_array_equal(canonical(angles), angles)


def test_readings_of_one_geometry_become_their_mean() -> None:
    m = BrdfMeasurement(
        [0.0, 0.0, 10.0, 10.0],
        [20.0, -20.0, 5.0, 6.0],
        [5.0, -5.0, 0.0, 0.0],
        np.array([[10.0], [12.0], [50.0], [np.nan]]) * np.ones(3),
        std=np.full((4, 3), 0.2),
        count=np.array([1, 3, 1, 1]),
    )
    m = m.select(m.valid)
    found = LogReadings.of(m.angles_deg, m.values, m.std, m.count)
    np.testing.assert_array_equal(found.angles_deg, [[0, 20, 5], [10, 5, 0]])
    np.testing.assert_allclose(np.exp(found.logs[:, 1]) - FLOOR, [11.5, 50.0])
    variance = np.array([0.2**2 * 10 / 16, 0.2**2]) / (FLOOR + np.array([11.5, 50.0])) ** 2
    np.testing.assert_allclose(found.noise * found.spread, variance)


def test_more_readings_than_a_fit_can_take_are_refused() -> None:
    """Expectation: told at once, with what helps; a MERL file has a million."""
    many = np.zeros((MAX_READINGS + 1, 3))
    with pytest.raises(InputError, match=r"at most 500000 scattered readings, got 500001; `raden"):
        LogReadings.of(many, many)
