"""What stands in the cells of a grid."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.measurement.reading_grid import ReadingGrid, is_filled

C = ("550nm",)


def test_cells_are_weighed_means_and_gaps_are_nan() -> None:
    angles = np.array([[0, 10, 0], [0, 10, 0], [5, 20, -5], [5, 10, 0]], float)
    values = np.array([[1.0], [4.0], [7.0], [np.nan]])
    grid = ReadingGrid.of(angles, values, np.array([2.0, 1.0, 1.0, 1.0]), C)
    assert grid.values.shape == (2, 2, 2, 1)
    np.testing.assert_array_equal(grid.incidence_deg, [0, 5])
    np.testing.assert_array_equal(grid.tilt_deg, [-5, 0])
    assert grid.values[0, 0, 1, 0] == pytest.approx(2.0)
    assert grid.values[1, 1, 0, 0] == 7.0
    assert grid.measured.sum() == 2
    assert grid.axes_deg.shape == (2, 2, 2)


def test_a_lone_reading_is_kept_to_the_bit() -> None:
    """v · w / w is not always v."""
    rng = np.random.default_rng(0)
    values, weight = rng.uniform(0, 1, (500, 1)), rng.uniform(0.1, 1, 500)
    angles = np.stack([np.zeros(500), np.linspace(-90, 90, 500), np.zeros(500)], axis=1)
    grid = ReadingGrid.of(angles, values, weight, C)
    np.testing.assert_array_equal(grid.values[0, :, 0], values)


@pytest.mark.parametrize(("n", "filled"), [(10, True), (15, False)])
def test_a_grid_is_filled_or_not_by_its_cells(n: int, filled: bool) -> None:
    """n readings, each with angles of its own: n³ cells against 50 n + 1000."""
    diagonal = np.linspace(0, 40, n)[:, None] * np.ones(3)
    assert is_filled(diagonal) is filled
