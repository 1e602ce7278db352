"""A reading's own error and the one that all share: what is taken out of `std`, what is added."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.error_parts import error_parts, stated_variance, zero_effects
from raden_torch.measurement.systematic_errors import SystematicErrors

XYZ = ("X", "Y", "Z")
SLOPE = np.array([0.3, -0.2, 0.1])  # per degree of incidence, receiving and tilt


def plane(std: float, zero_std_deg=(0.0, 0.0, 0.0), white_deg=None) -> BrdfMeasurement:
    """A grid of readings of a plane in the three angles, with this deviation everywhere."""
    nodes = np.meshgrid(np.arange(0, 45, 5.0), *[np.arange(-20, 25, 5.0)] * 2, indexing="ij")
    angles = np.stack([axis.ravel() for axis in nodes], axis=1)
    values = (100 + angles @ SLOPE)[:, None] * np.ones(3)
    common = SystematicErrors(zero_std_deg=zero_std_deg, white_deg=white_deg)
    return BrdfMeasurement(
        *angles.T,
        values=values,
        std=np.full(values.shape, std),
        metadata=Metadata("plane", systematic=common),
    )


def test_zeros_do_what_the_slopes_say() -> None:
    m = plane(1.0, (0.1, 0.2, 0.0))
    found = zero_effects(m)
    inner = (m.incidence_deg > 5) & (m.incidence_deg < 35) & (abs(m.angles_deg[:, 1:]) < 15).all(1)
    expected = SLOPE * [0.1, 0.2, 0.0]
    np.testing.assert_allclose(found[inner, 1], expected * np.ones((inner.sum(), 3)), rtol=0.02)


def test_own_and_shared_part_make_up_the_stated_variance() -> None:
    m = plane(0.5, (0.1, 0.1, 0.1), (45.0, 0.0, 0.0))
    parts = error_parts(m, XYZ)
    np.testing.assert_allclose(parts.variance + (parts.zeros**2).sum(axis=-1), 0.25, rtol=1e-12)
    assert (parts.variance < 0.25).all()


def test_a_third_of_the_deviation_stays_the_readings_own() -> None:
    """Where slopes explain more than was stated, they are not believed altogether."""
    parts = error_parts(plane(0.03, (1.0, 1.0, 1.0)), XYZ)
    np.testing.assert_allclose(parts.variance, (0.03 / 3) ** 2, rtol=1e-12)


def test_without_deviations_there_is_rounding() -> None:
    m = BrdfMeasurement([0.0, 1.0], [0.0, 0.0], [0.0, 0.0], values=[[50.0] * 3, [200.0] * 3])
    parts = error_parts(m, XYZ)
    np.testing.assert_allclose(parts.variance, (1e-9 * 200) ** 2)
    assert not parts.zeros.any()


def test_other_channels_by_the_matrix() -> None:
    m = plane(0.5, (0.2, 0.0, 0.0))
    matrix = xyz_to_rgb_matrix()
    own, rgb = error_parts(m, XYZ), error_parts(m, ("R", "G", "B"))
    np.testing.assert_allclose(rgb.values, own.values @ matrix.T)
    np.testing.assert_allclose(rgb.variance, own.variance @ (matrix**2).T)
    np.testing.assert_allclose(rgb.zeros[..., 0], own.zeros[..., 0] @ matrix.T)


def test_interpolation_adds_weights_squared_and_its_own_error() -> None:
    """Half of each of two readings: the mean, half the variance, and the shared part in full."""
    parts = error_parts(plane(0.5, (0.2, 0.0, 0.0)), XYZ)
    weights, rows = np.array([[0.5, 0.5]]), np.array([[3, 8]])
    mixed = parts.interpolated(weights, rows, np.full((1, 3), 0.1))
    np.testing.assert_allclose(mixed.values[0], parts.values[[3, 8]].mean(axis=0))
    own = parts.variance[[3, 8]].sum(axis=0) / 4 + 0.01
    np.testing.assert_allclose(mixed.variance[0], own)
    np.testing.assert_allclose(mixed.zeros[0], parts.zeros[[3, 8]].mean(axis=0))
    np.testing.assert_array_equal(parts.at(np.array([8])).values, parts.values[[8]])


def test_a_reading_without_a_deviation_is_named() -> None:
    m = plane(0.5)
    std = m.std.copy()
    std[7, 1] = np.nan
    wanting = BrdfMeasurement(*m.angles_deg.T, values=m.values, std=std)
    a, r, t = m.angles_deg[7]
    where = f"an unnamed sample: .* at incidence {a:g}, receiving {r:g}, tilt {t:g} deg"
    with pytest.raises(InputError, match=where):
        stated_variance(wanting)
