"""The readings of several measurements, by cell."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.stack import Stack


def measurement(receiving_deg: list[float], values: list[float], **more) -> BrdfMeasurement:
    n = len(values)
    column = np.array(values)[:, None] * np.ones(3)
    defaults = {"std": np.ones((n, 3))}
    return BrdfMeasurement(
        np.zeros(n), np.array(receiving_deg), np.zeros(n), values=column, **defaults | more
    )


def test_readings_meet_in_their_cells() -> None:
    first = measurement([10.0, 0.0], [1.0, 2.0], std=np.full((2, 3), 0.5))
    second = measurement([-0.0, 20.0], [4.0, 8.0], count=[3, 5])
    stack = Stack.of([first, second])
    np.testing.assert_array_equal(stack.angles[:, 1], [0, 10, 20])
    np.testing.assert_array_equal(stack.angles[stack.cell, 1], [10, 0, 0, 20])
    np.testing.assert_array_equal(stack.source, [0, 0, 1, 1])
    np.testing.assert_array_equal(stack.several, [True, False, False])
    np.testing.assert_array_equal(stack.weight[:, 0], [4, 4, 1, 1])
    np.testing.assert_array_equal(stack.count, [1, 1, 3, 5])
    np.testing.assert_array_equal(stack.total(stack.values)[:, 0], [6, 1, 8])


def test_the_mean_is_weighed_and_a_lone_reading_is_kept_to_the_bit() -> None:
    lone = 1 / 3
    stack = Stack.of(
        [
            measurement([0.0, 10.0], [2.0, lone], std=np.full((2, 3), 0.5)),
            measurement([0.0], [4.0]),
        ]
    )
    mean = stack.mean(stack.values, stack.weight)
    np.testing.assert_allclose(mean[0], (4 * 2 + 1 * 4) / 5)
    assert (mean[1] == lone).all()


def test_two_readings_of_one_measurement_are_no_overlap() -> None:
    stack = Stack.of([measurement([0.0, 0.0], [2.0, 2.01]), measurement([5.0], [1.0])])
    assert not stack.several.any()


def test_rescaling_divides_values_and_their_deviations() -> None:
    stack = Stack.of([measurement([0.0], [2.0]), measurement([0.0], [3.0])])
    values, weight = stack.rescaled(np.log([2.0, 1.0]))
    np.testing.assert_allclose(values[:, 0], [1, 3])
    np.testing.assert_allclose(weight[:, 0] ** -0.5, [0.5, 1])


def test_rows_that_are_not_valid_are_left_out() -> None:
    stack = Stack.of([measurement([0.0, 5.0], [1.0, np.nan]), measurement([5.0], [1.0])])
    np.testing.assert_array_equal(stack.cell, [0, 1])


def test_other_channels_become_xyz_with_their_variances() -> None:
    grey = measurement([0.0], [50.0])
    rgb = measurement([0.0], [50.0], channels=("R", "G", "B"))
    stack = Stack.of([grey, rgb])
    assert stack.channels == ("X", "Y", "Z")
    to_xyz = np.linalg.inv(xyz_to_rgb_matrix())
    np.testing.assert_allclose(stack.values[1], to_xyz @ np.full(3, 50.0))
    np.testing.assert_allclose(stack.weight[1], 1 / (to_xyz**2).sum(axis=1))


def test_a_deviation_of_0_is_rounding_and_none_is_refused() -> None:
    stack = Stack.of([measurement([0.0], [50.0], std=np.zeros((1, 3)))] * 2)
    np.testing.assert_allclose(stack.weight, (50e-9) ** -2)
    with pytest.raises(InputError, match="expected columns std_X, std_Y, std_Z, got none"):
        Stack.of([measurement([0.0], [50.0]), measurement([0.0], [50.0], std=None)])
