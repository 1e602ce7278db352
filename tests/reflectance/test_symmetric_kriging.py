"""Few readings become a hemisphere: symmetries hold exactly, and errors are as stated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.capture.photo.guide.choice import hemisphere_deg
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.few_readings import GRID, all_around, from_few
from raden_torch.reflectance.log_readings import FLOOR, LogReadings
from raden_torch.reflectance.symmetric_kriging import (
    ISOTROPIC,
    MOST,
    RECIPROCAL,
    Lengths,
    SymmetricKriging,
    symmetric_images,
)
from raden_torch.reflectance.symmetry import reciprocal

FEW = hemisphere_deg(60, seed=3)


def shell(angles: np.ndarray, noise: float = 0.0) -> BrdfMeasurement:
    return rt.simulate_specimen("yakogai", geometries_deg=angles, noise=noise)


def process(assume: str | None, angles: np.ndarray = FEW) -> SymmetricKriging:
    readings = LogReadings.of(angles, shell(angles).values)
    return SymmetricKriging.of(readings, assume, Lengths(noise=1e-6))


angle = st.floats(-79, 79)


@settings(deadline=None, max_examples=60)
@given(st.floats(0, 79), angle, angle)
def test_declared_symmetries_hold_exactly(a: float, r: float, t: float) -> None:
    """Rationale: the covariance is a sum over a group. Expectation: equal to rounding, and the two
    names of one geometry, (a, r, t) and (−a, −r, −t), always."""
    here = np.array([[a, r, t]])
    for assume, images in (
        (None, -here),
        (ISOTROPIC, here * [1, 1, -1]),
        (RECIPROCAL, np.concatenate([here * [1, 1, -1], reciprocal(here), -here])),
    ):
        both = _PROCESSES[assume](np.concatenate([here, images]))
        np.testing.assert_allclose(both, np.broadcast_to(both[:1], both.shape), atol=1e-7)


_PROCESSES = {assume: process(assume) for assume in (None, ISOTROPIC, RECIPROCAL)}


def test_it_goes_through_its_readings_and_knows_them() -> None:
    found = _PROCESSES[RECIPROCAL]
    truth = np.log(FLOOR + shell(FEW).values)
    np.testing.assert_allclose(found(FEW), truth, atol=2e-3)
    assert found.std(FEW).max() < 0.05 * found.std(np.array([[0.0, 0.0, 0.0]]) + 79).max()


def test_images_are_the_names_of_one_geometry() -> None:
    here = np.array([[40.0, 10.0, 5.0]])
    names = {tuple(image) for image in symmetric_images(here, RECIPROCAL)}
    assert {(40.0, 10.0, -5.0), (10.0, 40.0, -5.0), (-40.0, -10.0, -5.0)} <= names
    assert len(names) == 8
    assert len(symmetric_images(here, None)) == 2


def test_few_readings_give_a_shell_and_the_stated_error_is_the_real_one() -> None:
    """A hundred single geometries of a simulated shell: within 5 % over the hemisphere, which no
    neighbour-by-neighbour interpolation gives; the expected error is right to a factor of two."""
    angles, asked = hemisphere_deg(100, seed=1), hemisphere_deg(1000, seed=2)
    read = shell(angles, noise=0.01)
    found = SymmetricKriging.of(LogReadings.of(angles, read.values, read.std), RECIPROCAL)
    truth = np.log(FLOOR + shell(asked).values[:, 1])
    missed, said = abs(found(asked)[:, 1] - truth), found.std(asked)
    assert np.median(np.expm1(missed)) < 0.05
    assert 0.5 < np.sqrt(np.mean((missed / said) ** 2)) < 2


def test_a_fit_takes_them_and_says_what_is_known() -> None:
    """Less than 2 % of the cells: refused or guessed before, derived now."""
    angles = hemisphere_deg(80, seed=4)
    result = rt.fit(shell(angles), assume=RECIPROCAL)
    shares = result.report.hemisphere
    assert shares.measured < 0.02
    assert shares.expected_error < 0.1
    assert 0 < shares.guessed < shares.filled
    assert "expected error" in str(result.report)
    assert "light and view exchanged" in result.report.assumption
    box = dict(zip("art", result.report.box_deg, strict=True))
    assert box["a"] == (0.0, 80.0)


def test_a_grid_as_encoders_read_it_stays_a_grid() -> None:
    """Angles up to 0.05 degrees beside the nodes are taken as on them, also under an assumption."""
    deg = np.mgrid[0:71:10, -70:71:10, -70:71:10].reshape(3, -1).T
    beside = deg + np.random.default_rng(3).uniform(-0.03, 0.03, deg.shape)
    beside[:, 0] = abs(beside[:, 0])
    values = np.full((len(deg), 3), 90.0)
    report = rt.fit(rt.BrdfMeasurement(*beside.T, values), assume=ISOTROPIC).report
    assert np.isnan(report.hemisphere.expected_error)
    assert any("off a grid were taken as on it" in warning for warning in report.warnings)


def test_a_plane_or_a_view_is_not_all_around() -> None:
    plane = np.stack([*np.meshgrid(np.arange(0, 70, 10.0), np.arange(-70, 71, 10.0))], -1)
    plane = np.c_[plane.reshape(-1, 2), np.zeros(plane[..., 0].size)]
    assert not all_around(plane)
    assert all_around(FEW)


def test_many_readings_are_thinned_and_too_few_refused() -> None:
    dense = hemisphere_deg(MOST + 500, seed=6)
    logs = LogReadings.of(dense, np.full((len(dense), 3), 50.0))
    assert len(SymmetricKriging.of(logs, RECIPROCAL, Lengths()).angles_deg) <= MOST
    with pytest.raises(InputError, match="expected at least 6 readings at different angles, got 3"):
        SymmetricKriging.of(LogReadings.of(FEW[:3], np.ones((3, 3))), RECIPROCAL)


def test_a_perfect_diffuser_stays_one() -> None:
    found = from_few(FEW, np.full((len(FEW), 3), 90.0), assume=ISOTROPIC)
    np.testing.assert_allclose(found.values, 90, rtol=1e-6)
    assert found.values.shape == (*GRID.shape, 3)
