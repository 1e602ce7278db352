"""Which readings of two measurements are of one geometry, and what lies between readings."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.error_parts import error_parts
from raden_torch.measurement.matching import geometries_deg, interpolated_at, same_geometries

XYZ = ("X", "Y", "Z")


def measurement(angles: np.ndarray, values: np.ndarray | None = None, **more) -> BrdfMeasurement:
    angles = np.asarray(angles, float)
    values = np.full(len(angles), 10.0) if values is None else values
    return BrdfMeasurement(*angles.T, values=values[:, None] * np.ones(3), **more)


def test_the_same_geometries_are_found_in_any_order() -> None:
    first = measurement([[10, 20, 0], [0, -0.0, 5], [30, 0, 0]])
    second = measurement([[0, 0, 5], [40, 0, 0], [10, 20, 1e-8]])
    found = same_geometries(first, second)
    assert dict(zip(found.first.tolist(), found.second.tolist(), strict=True)) == {0: 2, 1: 0}


def test_rows_are_counted_among_the_valid_ones() -> None:
    values = np.array([np.nan, 10.0, 10.0])
    first = measurement([[10, 0, 0], [20, 0, 0], [30, 0, 0]], values)
    second = measurement([[10, 0, 0], [30, 0, 0]])
    found = same_geometries(first, second)
    assert (found.first.tolist(), found.second.tolist()) == ([1], [1])


def test_another_azimuth_is_another_geometry() -> None:
    at = [[10.0, 0.0, 0.0]]
    first, second = measurement(at, azimuth_deg=[0.0]), measurement(at, azimuth_deg=[90.0])
    assert not len(same_geometries(first, second).first)
    assert len(same_geometries(first, measurement(at)).first) == 1
    np.testing.assert_array_equal(geometries_deg(second), [[10, 0, 0, 90]])


def quadratic(angles: np.ndarray) -> np.ndarray:
    a, r, t = angles.T
    return 40 + 0.5 * a - 0.3 * r + 0.1 * t + 0.01 * a * r - 0.004 * t**2 + 0.002 * r**2


@pytest.fixture(scope="module")
def scattered() -> BrdfMeasurement:
    angles = np.random.default_rng(3).uniform([0, -30, -30], [40, 30, 30], (2000, 3))
    return measurement(angles, quadratic(angles), std=np.full((2000, 3), 0.2))


def test_a_quadratic_is_interpolated_exactly(scattered: BrdfMeasurement) -> None:
    """Expected: its value, a deviation mostly below the readings' own, and nothing added."""
    places = np.random.default_rng(4).uniform([5, -25, -25], [35, 25, 25], (200, 3))
    rows, parts = interpolated_at(measurement(places), scattered, error_parts(scattered, XYZ))
    np.testing.assert_array_equal(rows, np.arange(200))
    np.testing.assert_allclose(parts.values[:, 1], quadratic(places), rtol=1e-7)
    assert (parts.variance > 0.2**2 / 32).all()  # 32 readings say no more
    assert np.median(parts.variance) < 0.2**2 / 2


def test_beyond_the_readings_nothing_is_said(scattered: BrdfMeasurement) -> None:
    places = np.array([[20.0, 0.0, 0.0], [20.0, 75.0, 0.0], [85.0, 0.0, 0.0]])
    rows, parts = interpolated_at(measurement(places), scattered, error_parts(scattered, XYZ))
    assert rows.tolist() == [0]
    assert parts.values.shape == (1, 3)


@pytest.mark.parametrize("count", [1, 11])
def test_fewer_readings_than_a_quadratic_needs(count: int) -> None:
    few = measurement(np.random.default_rng(0).uniform(0, 5, (count, 3)))
    rows, parts = interpolated_at(measurement([[2.0, 2.0, 2.0]]), few, error_parts(few, XYZ))
    assert len(rows) == len(parts.values) == 0
