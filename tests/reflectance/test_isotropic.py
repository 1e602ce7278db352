"""Readings of one plane, one view or one side, of a sample that is assumed to be isotropic."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.opposite_tilts import with_opposite_tilts
from raden_torch.reflectance.isotropic import GRID, Derived, Reach, half_and_difference_deg
from raden_torch.reflectance.isotropic import derive as derive_from

PLANE = np.array([(a, r, 0.0) for a in range(0, 71, 10) for r in range(-80, 81, 5)], float)
VIEW = np.array([(a, 0.0, 0.0) for a in range(0, 90)], float)


def measured(angles: np.ndarray, y: np.ndarray) -> BrdfMeasurement:
    return BrdfMeasurement(*angles.T, y[:, None] * [0.95, 1.0, 1.09])


def derive(m: BrdfMeasurement) -> Derived:
    return derive_from(m.angles_deg, m.values)


def lobe(angles: np.ndarray) -> np.ndarray:
    """A body and a lobe of the half angle, higher where the difference angle is large."""
    half, difference = np.radians(half_and_difference_deg(angles))
    return 20 + 200 * np.exp(-((np.degrees(half) / 12) ** 2)) * (1 + np.sin(difference) ** 2)


def test_half_and_difference_are_those_of_the_vectors() -> None:
    rng = np.random.default_rng(0)
    light, view = rng.normal(size=(2, 200, 3))
    light[:, 2], view[:, 2] = abs(light[:, 2]), abs(view[:, 2])

    maps = [
        torch.tensor(v.T[None, :, :, None]) for v in (np.tile([0, 0, 1.0], (200, 1)), light, view)
    ]
    angles = np.stack([np.degrees(a.numpy().ravel()) for a in rt.raden_angles(*maps)], axis=1)
    unit = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in (light, view)]
    bisector = sum(unit) / np.linalg.norm(sum(unit), axis=1, keepdims=True)
    half, difference = half_and_difference_deg(angles)
    np.testing.assert_allclose(np.cos(np.radians(half)), bisector[:, 2], atol=1e-6)
    np.testing.assert_allclose(
        np.cos(np.radians(difference)), (bisector * unit[0]).sum(axis=1), atol=1e-6
    )


@pytest.mark.parametrize("angles", [PLANE, VIEW, PLANE[PLANE[:, 0] == 30]])
def test_a_perfect_diffuser_stays_one(angles: np.ndarray) -> None:
    found = derive(measured(angles, np.full(len(angles), 100.0)))
    np.testing.assert_allclose(found.values[..., 1], 100.0, rtol=1e-6)
    assert "0 % off" in found.why or "e-" in found.why


def test_one_plane_tells_of_a_lobe_everywhere_that_it_reaches() -> None:
    found = derive(measured(PLANE, lobe(PLANE)))
    nodes = GRID.nodes_deg().reshape(-1, 3)
    half, difference = half_and_difference_deg(nodes)
    reached = half + difference < 75
    assert reached.mean() > 0.5
    truth = lobe(nodes)[reached]
    np.testing.assert_allclose(found.values[..., 1].ravel()[reached], truth, rtol=0.03)
    assert int(found.measured.sum()) == 8 * 29
    assert "half angle 0…75 deg and difference angle 0…75 deg" in found.why


def test_one_view_tells_of_the_half_angle() -> None:
    found = derive(measured(VIEW, 20 + 200 * np.exp(-((VIEW[:, 0] / 24) ** 2))))
    nodes = GRID.nodes_deg().reshape(-1, 3)
    half = np.minimum(half_and_difference_deg(nodes)[0], 44.5)
    truth = 20 + 200 * np.exp(-((half / 12) ** 2))
    np.testing.assert_allclose(found.values[..., 1].ravel(), truth, rtol=0.01)


def test_beyond_its_reach_the_nearest_value_is_held() -> None:
    reach = Reach(np.array([0.0, 40.0, 40.0, 20.0]), np.array([10.0, 10.0, 50.0, 25.0]))
    half, difference = reach.nearest(np.array([20.0, 20.0, 60.0]), np.array([0.0, 80.0, 30.0]))
    np.testing.assert_allclose(half, [20, 20, 40])
    np.testing.assert_allclose(difference, [10, 30, 30])


def test_one_side_is_as_good_as_two() -> None:
    whole = rt.simulate_specimen("yakogai", step_deg=10.0)
    both = with_opposite_tilts(whole)[0]  # it is isotropic, so that this changes nothing
    np.testing.assert_allclose(both.grid().values, whole.grid().values, rtol=1e-9)
    side = whole.select(whole.tilt_deg >= 0)
    result = rt.fit(side, interpolation="trilinear", assume="isotropic")
    expected = rt.fit(whole, interpolation="trilinear")
    torch.testing.assert_close(result.model.table.values, expected.model.table.values)
    report = result.report
    assert 0 < report.from_assumption < report.measured
    assert "tilts t and -t are one geometry (readings lie 0 % off their mean)" in str(report)


def test_a_reading_past_the_last_node_is_that_node_s() -> None:
    """Encoders read a little past it; it is not the geometry on the other side."""
    forward = PLANE[PLANE[:, 1] >= 0]
    past = forward + [0.04, 0, 0] * (forward[:, :1] == 70)
    found, wanted = (derive(measured(angles, lobe(angles))) for angles in (past, forward))
    assert (found.measured == wanted.measured).all()
    assert found.measured[-1].any()


def test_readings_that_contradict_the_assumption_say_so() -> None:
    m = BrdfMeasurement(
        [30.0, 30.0], [20.0, 20.0], [10.0, -10.0], np.array([[90.0], [110.0]]) * np.ones(3)
    )
    both, why = with_opposite_tilts(m)
    np.testing.assert_allclose(both.values, 100.0)
    assert "readings lie 10 % off their mean" in why


def test_the_report_tells_what_was_measured_and_what_follows() -> None:
    report = rt.fit(measured(PLANE, lobe(PLANE)), assume="isotropic").report
    assert report.measured + report.from_assumption == report.cells
    assert report.measured == 8 * 29
    assert "assumed isotropic: reflectance depends on the half" in str(report)
    assert np.isnan(report.reciprocity_mean)


@pytest.mark.parametrize(
    ("angles", "wanted"),
    [
        (PLANE[PLANE[:, 0] == PLANE[:, 1]], "half angles.*got 0…0 deg"),
        (np.array([[20.0, 10.0, 0.0]]), "half angles.*got 5…5 deg"),
    ],
)
def test_what_stays_undetermined_is_refused(angles: np.ndarray, wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        rt.fit(measured(angles, np.full(len(angles), 50.0)), assume="isotropic")


def test_other_symmetries_are_refused() -> None:
    with pytest.raises(
        InputError, match=r"expected 'isotropic' or 'isotropic\+reciprocal', got 'round'"
    ):
        rt.fit(measured(PLANE, lobe(PLANE)), assume="round")


@pytest.mark.parametrize("name", ["in_plane_only", "fixed_view_1d"])
def test_files_of_one_plane_and_of_one_view(
    raden: Callable[..., subprocess.CompletedProcess[str]], shared: Path, tmp_path: Path, name: str
) -> None:
    words = ["fit", str(shared / f"data/cases/{name}.csv"), "-o", str(tmp_path / "m.safetensors")]
    refused = raden(*words)
    assert refused.returncode == 2
    assert "--assume isotropic" in refused.stderr
    done = raden(*words, "--assume", "isotropic", warn="default")
    assert done.returncode == 0, done.stderr
    assert "assumed isotropic" in done.stdout
    model = rt.load_model(tmp_path / "m.safetensors")
    assert model.provenance.fit["from_assumption"] > 12000


def test_real_paint_from_one_plane(shared: Path) -> None:
    """Against 12,000 directions of the same paint, those within the table's box."""
    folder = shared / "data/whole_hemisphere"
    plane = rt.load_measurement(folder / "pearl-paint.csv")
    truth = rt.load_measurement(folder / "pearl-paint.hemisphere.csv")
    model = rt.fit(plane.select(plane.tilt_deg == 0), assume="isotropic").model
    inside = (truth.incidence_deg <= 70) & (
        np.maximum(abs(truth.receiving_deg), abs(truth.tilt_deg)) <= 70
    )
    from raden_torch.brdf.fitting.score import reflectance_factors
    from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

    truth = truth.select(inside)
    found = reflectance_factors(model, truth) @ np.linalg.inv(xyz_to_rgb_matrix())[1]
    y = truth.as_xyz().values[:, 1]
    assert np.median(abs(found - y) / y) < 0.02
