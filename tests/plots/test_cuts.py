"""Cuts through grids, scattered readings and models hold the values that lie there."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots.cuts import (
    GridSamples,
    ModelSamples,
    NotMeasuredError,
    ScatteredSamples,
    in_words,
    model_factors,
)

RGB = ("R", "G", "B")


def value(a, r, t) -> np.ndarray:
    """A different number at every geometry."""
    return np.stack([1000 + 7 * a + 0.1 * r + 0.001 * t] * 3, axis=-1)


@pytest.fixture
def grid() -> GridSamples:
    axes = np.meshgrid([0, 20, 40.0], [-20, 0, 20, 40.0], [-10, 0, 10.0], indexing="ij")
    a, r, t = (axis.ravel() for axis in axes)
    return GridSamples(BrdfMeasurement(a, r, t, value(a, r, t), RGB).grid())


def test_a_line_of_a_grid(grid: GridSamples) -> None:
    cut = grid.cut(("receiving",), {"incidence": 23.0, "tilt": -8.0})
    np.testing.assert_array_equal(cut.deg["receiving"], [-20, 0, 20, 40])
    np.testing.assert_array_equal(cut.values, value(20.0, cut.deg["receiving"], -10.0))
    assert cut.held == "incidence 20°, tilt −10°"
    assert cut.joined


def test_a_plane_of_a_grid(grid: GridSamples) -> None:
    """Its first index is the angle that comes first in `ANGLES`, however it is asked for."""
    cut = grid.cut(("receiving", "incidence"), {"tilt": 2.0})
    assert cut.values.shape == (3, 4, 3)
    a, r, _ = cut.deg.values()
    np.testing.assert_array_equal(cut.values, value(a, r, 0.0))
    np.testing.assert_array_equal(cut.deg["incidence"][:, 0], [0, 20, 40])


def test_the_mirror_direction_of_a_grid(grid: GridSamples) -> None:
    cut = grid.mirror()
    np.testing.assert_array_equal(cut.deg["incidence"], cut.deg["receiving"])
    np.testing.assert_array_equal(cut.deg["incidence"][:, 0], [0, 20, 40])
    np.testing.assert_array_equal(cut.values, value(*cut.deg.values()))
    assert grid.limits("receiving") == (-20, 40)


def test_a_grid_without_receiving_equal_to_incidence() -> None:
    a, r, t = (x.ravel() for x in np.meshgrid([10.0, 20], [0.0, 5], [0.0, 5], indexing="ij"))
    beside = GridSamples(BrdfMeasurement(a, r, t, value(a, r, t), RGB).grid())
    with pytest.raises(NotMeasuredError, match="needs readings at receiving = incidence"):
        beside.mirror()


@pytest.fixture(scope="module")
def scattered() -> ScatteredSamples:
    a, r, t = np.random.default_rng(0).uniform([0, -60, -60], [60, 60, 60], (5000, 3)).T
    return ScatteredSamples(BrdfMeasurement(a, r, t, value(a, r, t), RGB))


def test_a_slab_of_scattered_readings(scattered: ScatteredSamples) -> None:
    cut = scattered.cut(("receiving",), {"incidence": 30.0, "tilt": 10.0})
    m = scattered.readings
    near = (abs(m.incidence_deg - 30) <= 2.5) & (abs(m.tilt_deg - 10) <= 2.5)
    np.testing.assert_array_equal(cut.values, m.values[near])
    np.testing.assert_array_equal(cut.deg["receiving"], m.receiving_deg[near])
    assert not cut.joined
    assert cut.held.startswith("incidence ≈ ")


def test_a_slab_moves_to_where_readings_are(scattered: ScatteredSamples) -> None:
    """Asked for incidence 80°, where none is: the slab around the nearest, below 60°."""
    cut = scattered.cut(("receiving",), {"incidence": 80.0, "tilt": 0.0})
    assert 57 < cut.deg["incidence"].min() < cut.deg["incidence"].max() < 60


def test_the_mirror_direction_of_scattered_readings(scattered: ScatteredSamples) -> None:
    cut = scattered.mirror()
    assert len(cut.values) > 50
    assert abs(cut.deg["incidence"] - cut.deg["receiving"]).max() <= 2.5
    np.testing.assert_array_equal(cut.values, value(*cut.deg.values()))


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    """Eq. (6) alone, S = 0.2 and n = 0 in green: f_r = 0.2 cos t cos r."""
    scale = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    return rt.RadenBrdf(CosineDiffuse(scale, torch.zeros_like(scale)), None)


def test_a_models_factors_are_100_pi_f_r(model: rt.RadenBrdf) -> None:
    r, t = np.meshgrid(np.linspace(-60, 60, 5), np.linspace(-40, 40, 3), indexing="ij")
    factors = model_factors(model, {"incidence": np.full(r.shape, 30.0), "receiving": r, "tilt": t})
    body = np.cos(np.radians(t)) * np.cos(np.radians(r))
    np.testing.assert_allclose(factors[..., 1], 100 * np.pi * 0.2 * body, rtol=1e-12)


def test_a_models_lines_are_fine_and_its_planes_coarse(model: rt.RadenBrdf) -> None:
    samples = ModelSamples(model)
    line = samples.cut(("tilt",), {"incidence": 20.0, "receiving": 0.0})
    assert (line.deg["tilt"][0], line.deg["tilt"][-1]) == (-90, 90)
    np.testing.assert_allclose(np.diff(line.deg["tilt"]), 1.0)
    plane = samples.cut(("receiving", "tilt"), {"incidence": 20.0})
    assert plane.values.shape == (65, 65, 3)
    np.testing.assert_allclose(np.diff(plane.deg["receiving"][:, 0]), 2.5)
    mirror = samples.mirror()
    np.testing.assert_array_equal(mirror.deg["incidence"], mirror.deg["receiving"])


@pytest.mark.parametrize(
    ("held", "words"),
    [
        ({"incidence": 20.0}, "incidence 20°"),
        ({"incidence": 12.34, "tilt": -10.0}, "incidence 12.3°, tilt −10°"),
        ({"tilt": -0.01}, "tilt 0°"),
    ],
)
def test_angles_in_words(held, words: str) -> None:
    assert in_words(held) == words
