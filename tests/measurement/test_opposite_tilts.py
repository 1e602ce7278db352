"""An isotropic sample's tilts t and −t are one geometry."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.opposite_tilts import with_opposite_tilts


def measurement(tilts: list[float], values: list[float], **more) -> BrdfMeasurement:
    n = len(tilts)
    column = np.array(values)[:, None] * [1.0, 2.0, 3.0]
    return BrdfMeasurement(
        np.full(n, 20.0), np.full(n, 5.0), np.array(tilts), values=column, **more
    )


def at(m: BrdfMeasurement, tilt: float) -> int:
    (row,) = np.flatnonzero(m.tilt_deg == tilt)
    return int(row)


def test_one_side_is_copied_to_the_other() -> None:
    whole, _ = with_opposite_tilts(measurement([0.0, 10.0, -30.0], [1.0, 2.0, 4.0]))
    assert sorted(whole.tilt_deg) == [-30, -10, 0, 10, 30]
    for tilt, value in ((0, 1.0), (10, 2.0), (-10, 2.0), (30, 4.0), (-30, 4.0)):
        np.testing.assert_array_equal(whole.values[at(whole, tilt)], [value, 2 * value, 3 * value])
    assert (whole.incidence_deg == 20).all()
    assert (whole.receiving_deg == 5).all()


def test_both_sides_are_averaged_by_their_counts() -> None:
    """Expected: (3 · 2 + 1 · 6) / 4 = 3, and √(3² 0.1² + 1² 0.2²) / 4 for its deviation."""
    m = measurement([10.0, -10.0], [2.0, 6.0], count=[3, 1], std=np.array([[0.1] * 3, [0.2] * 3]))
    whole, said = with_opposite_tilts(m)
    for tilt in (10.0, -10.0):
        np.testing.assert_allclose(whole.values[at(whole, tilt)], [3, 6, 9])
        np.testing.assert_allclose(whole.std[at(whole, tilt)], np.hypot(0.3, 0.2) / 4)
    np.testing.assert_array_equal(whole.count, [4, 4])
    # |2 − 3| + |6 − 3| = 4 over 3 + 3, in each channel
    assert said == "tilts t and -t are one geometry (readings lie 67 % off their mean)"


def test_a_symmetric_sample_lies_on_its_mean() -> None:
    whole, said = with_opposite_tilts(measurement([10.0, -10.0, 0.0], [2.0, 2.0, 7.0]))
    assert len(whole) == 3
    assert whole.std is None
    assert whole.count is None
    assert said.endswith("(readings lie 0 % off their mean)")


def test_only_valid_readings_and_no_azimuth() -> None:
    m = measurement([10.0, -20.0], [2.0, np.nan], azimuth_deg=[0.0, 90.0])
    whole, _ = with_opposite_tilts(m)
    assert sorted(whole.tilt_deg) == [-10, 10]
    assert whole.azimuth_deg is None
    assert whole.valid.all()


@pytest.mark.parametrize("factor", [1.0, 7.5])
def test_it_is_its_own_result(factor: float) -> None:
    once, _ = with_opposite_tilts(measurement([10.0, 30.0], [2.0, factor]))
    twice, _ = with_opposite_tilts(once)
    order = [np.lexsort((m.values[:, 0], m.tilt_deg)) for m in (once, twice)]
    np.testing.assert_array_equal(once.tilt_deg[order[0]], twice.tilt_deg[order[1]])
    np.testing.assert_array_equal(once.values[order[0]], twice.values[order[1]])
