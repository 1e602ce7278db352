"""The maps of the unit square: their densities, their inverses, and Mitsuba's own."""

from __future__ import annotations

import numpy as np
import pytest

from raden_torch.export.measured.warp import Warp, bilinear

PARAMETERS = np.array([0.0, 0.3, 1.0])


@pytest.fixture
def warp() -> Warp:
    values = np.random.default_rng(0).gamma(0.7, size=(3, 9, 12))
    values[:, :, -3:] = 0  # nothing there, as beyond the horizon
    return Warp.of(PARAMETERS, values)


def test_the_inverse_takes_points_back(warp: Warp) -> None:
    points = np.random.default_rng(1).random((400, 2))
    for t, parameter in enumerate(PARAMETERS):
        places = warp.forward(t, points)
        back = warp.inverse(np.full(400, parameter), places)
        np.testing.assert_allclose(back, points, atol=1e-9)


def test_points_are_as_dense_as_the_density(warp: Warp) -> None:
    """The inverse's Jacobian determinant is the density, between the parameters, too."""
    draw = np.random.default_rng(2)
    places, parameter = draw.random((300, 2)) * (0.7, 0.98) + 0.01, draw.random(300)
    step = 1e-7
    columns = [
        (warp.inverse(parameter, places + d) - warp.inverse(parameter, places - d)) / (2 * step)
        for d in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    (a, b), (c, d) = (column.T for column in columns)
    low = (np.searchsorted(PARAMETERS, parameter) - 1).clip(0)
    share = (parameter - PARAMETERS[low]) / (PARAMETERS[low + 1] - PARAMETERS[low])
    each = np.stack([bilinear(density, places) for density in warp.density])
    rows = np.arange(300)
    wanted = each[low, rows] * (1 - share) + each[low + 1, rows] * share
    np.testing.assert_allclose(abs(a * d - b * c), wanted, rtol=1e-4, atol=1e-6)


def test_mitsuba_maps_alike(warp: Warp) -> None:
    mi = pytest.importorskip("mitsuba", reason="needs the extra simulate")
    mi.set_variant("scalar_rgb")
    own = mi.MarginalContinuous2D1(warp.density.astype(np.float32), [PARAMETERS.tolist()])
    points = np.random.default_rng(3).random((100, 2)) * (0.7, 1)
    inverse = warp.inverse(np.full(100, 0.45), points)
    for point, wanted in zip(points.tolist(), inverse, strict=True):
        found, _ = own.invert(mi.Point2f(point), [0.45])
        np.testing.assert_allclose([*found], wanted, atol=1e-4)
    for point, wanted in zip(points.tolist(), warp.forward(1, points), strict=True):
        found, _ = own.sample(mi.Point2f(point), [0.3])
        np.testing.assert_allclose([*found], wanted, atol=1e-4)
