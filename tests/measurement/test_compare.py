"""Two measurements against each other: verdicts, χ², shared errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.compare import compare
from raden_torch.measurement.consistency import Chi2, Covariance
from raden_torch.measurement.error_parts import zero_effects
from raden_torch.measurement.systematic_errors import SystematicErrors
from raden_torch.reflectance.regions import REGIONS, regions
from raden_torch.reflectance.slopes import slopes_per_deg


def noisy(
    truth: BrdfMeasurement, seed: int, relative: float = 0.01, factor: float = 1.0, **common
) -> BrdfMeasurement:
    """The truth with independent noise, one factor, and what it states of its scale."""
    std = relative * abs(truth.values)
    noise = std * np.random.default_rng(seed).standard_normal(std.shape)
    return replace(
        truth,
        values=factor * truth.values + noise,
        std=std,
        metadata=replace(truth.metadata, systematic=SystematicErrors(**common)),
    )


@pytest.fixture
def small(analytic) -> BrdfMeasurement:
    m = analytic(step=10.0)
    return m.select(np.random.default_rng(0).permutation(len(m))[:300])


def test_a_measurement_agrees_with_itself(analytic) -> None:
    m = noisy(analytic(step=10.0), 0)
    c = compare(m, m)
    assert [chi2.value for chi2 in c.by_channel] == [0.0] * 3
    assert c.agrees
    assert c.scale.factor == pytest.approx(1)
    assert c.without_partner == (0, 0)
    assert "they agree within" in str(c)


def test_p_values_are_calibrated(small) -> None:
    """Rationale: where the stated errors are the true ones, p is even between 0 and 1.

    Expected: of 1000 pairs, 5 % ± 2 % have p < 0.05 in one channel, with and without a scale that
    errs as stated; 1 % ± 1 % of the verdicts are wrong.
    """
    rng = np.random.default_rng(1)
    p_values, p_free, refused = [], [], 0
    for run in range(1000):
        scale = 0.02
        pair = [
            noisy(
                small, 2 * run + i, factor=float(1 + scale * rng.standard_normal()), scale_std=scale
            )
            for i in range(2)
        ]
        c = compare(*pair)
        p_values.append(c.regions[-1].chi2.p)
        p_free.append(c.scale.chi2.p)
        refused += not c.agrees
    for p in (np.array(p_values), np.array(p_free)):
        assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.02)
        assert np.mean(p < 0.5) == pytest.approx(0.5, abs=0.05)
    assert refused <= 20


def test_zeros_that_are_off_as_stated_are_no_contradiction(analytic) -> None:
    """One zero for all readings: added to each cell's variance, χ² would be far from its dof."""
    truth, rng = analytic(step=7.0), np.random.default_rng(2)
    common = SystematicErrors(zero_std_deg=(0.2, 0.2, 0.2), white_deg=(45.0, 0.0, 0.0))
    stated = replace(truth, metadata=replace(truth.metadata, systematic=common))
    effects = zero_effects(stated)

    def measured() -> BrdfMeasurement:
        own = 0.01 * truth.values
        noise = own * rng.standard_normal(own.shape)
        m = replace(stated, values=truth.values + effects @ rng.standard_normal(3) + noise)
        known = (zero_effects(m) ** 2).sum(axis=-1)  # by the measured slopes, as a scan has it
        return replace(m, std=np.sqrt(own**2 + known))

    p_values = []
    for _ in range(25):
        c = compare(measured(), measured())
        assert c.agrees
        p_values.append(c.regions[-1].chi2.p)
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.2)


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_known_factor_is_found_and_judged(analytic, factor: float) -> None:
    truth = analytic(step=10.0)
    plain = compare(noisy(truth, 0), noisy(truth, 1, factor=factor))
    assert plain.scale.factor == pytest.approx(factor, abs=4 * plain.scale.std)
    assert not plain.agrees
    assert "apart from one factor they agree" in str(plain)
    stated = compare(
        noisy(truth, 0, scale_std=0.02), noisy(truth, 1, factor=factor, scale_std=0.02)
    )
    assert stated.agrees
    assert stated.scale.stated_std == pytest.approx(np.hypot(0.02, 0.02))
    assert stated.scale.deviations == pytest.approx(0.03 / np.hypot(0.02, 0.02), rel=0.05)
    same_tile = {"scale_std": 0.02, "scale_reference": "tile 1"}
    assert not compare(
        noisy(truth, 0, **same_tile), noisy(truth, 1, factor=factor, **same_tile)
    ).agrees


def test_a_small_factor_in_many_readings_is_seen(analytic) -> None:
    """0.5 % between readings of 1 % hides in χ² per degree of freedom, not in the factor."""
    truth = analytic(step=5.0)
    c = compare(noisy(truth, 0), noisy(truth, 1, factor=1.005))
    assert c.birge < 1.2
    assert not c.agrees
    assert "disagree in scale" in str(c)


def test_an_offset_in_one_region_is_found_there(analytic) -> None:
    truth = analytic(step=5.0)
    ridge = regions(truth.angles_deg)["ridge"]
    off = replace(truth, values=truth.values * np.where(ridge, 1.05, 1.0)[:, None])
    c = compare(noisy(truth, 0), noisy(off, 1))
    by_name = {region.name: region for region in c.regions}
    assert by_name["ridge"].bias == pytest.approx(0.05, abs=0.005)
    assert by_name["ridge"].chi2.p < 1e-6
    assert by_name["body"].chi2.p > 1e-3
    assert not c.agrees


def test_every_reading_is_in_one_region(analytic) -> None:
    masks = regions(analytic(step=5.0).angles_deg)
    assert tuple(masks) == REGIONS
    assert (np.sum(list(masks.values()), axis=0) == 1).all()
    assert all(mask.sum() > 100 for mask in masks.values())


def test_other_geometries_are_interpolated(analytic) -> None:
    from raden_torch.optics import simulate_specimen

    cells = np.random.default_rng(3).random((400, 3)) * [65, 130, 130] - [0, 65, 65]
    grid, off = simulate_specimen(), simulate_specimen(geometries_deg=cells)
    for pair in ((noisy(grid, 0, 0.003), noisy(off, 1, 0.003)), (noisy(off, 1), noisy(grid, 0))):
        c = compare(*pair)
        assert c.interpolated
        assert c.regions[-1].count == 400
        assert c.agrees
        assert "simulated" in str(c)
    assert not compare(noisy(grid, 0, 0.003), noisy(off, 1, 0.003, factor=1.1)).agrees


def test_channels_that_differ_are_compared_in_xyz(analytic) -> None:
    truth = analytic(step=10.0)
    c = compare(noisy(truth, 0).as_rgb(), noisy(truth, 1))
    assert c.channels == ("X", "Y", "Z")
    assert c.judged == "Y"
    assert abs(c.scale.factor - 1) < 0.01


def test_what_cannot_be_compared_is_refused(analytic) -> None:
    m = analytic(step=35.0)
    other = replace(m, metadata=Metadata(white="D50"))
    with pytest.raises(InputError, match="white: expected the same in both, got D65 and D50"):
        compare(m, other)
    far = BrdfMeasurement([85.0], [85.0], [80.0], np.ones((1, 3)))
    with pytest.raises(InputError, match="expected geometries in common"):
        compare(m, far)
    assert "neither states a standard deviation" in str(compare(m, m))


@settings(max_examples=50, deadline=None)
@given(n=st.integers(2, 12), shared=st.integers(0, 3), seed=st.integers(0, 10**6))
def test_a_shared_error_is_solved_as_the_whole_matrix(n: int, shared: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    variance, common = rng.uniform(0.1, 2.0, n), rng.standard_normal((n, shared))
    difference = rng.standard_normal(n)
    whole = np.diag(variance) + common @ common.T
    covariance = Covariance(variance, common)
    np.testing.assert_allclose(covariance.solve(difference), np.linalg.solve(whole, difference))
    np.testing.assert_allclose(covariance.std, np.sqrt(np.diag(whole)))
    assert covariance.chi2(difference).value == pytest.approx(
        difference @ np.linalg.solve(whole, difference)
    )


def test_chi2_of_nothing() -> None:
    none = Chi2(0.0, 0)
    assert (none.p, none.per_dof, none.birge, none.agrees) == (1.0, 0.0, 0.0, True)
    assert Chi2(3.841, 1).p == pytest.approx(0.05, abs=1e-4)


def test_slopes_are_those_of_the_sample(analytic) -> None:
    """On the grid within 2 %, with a gap in it, and through scattered readings."""
    h = 1e-3

    def near(m: BrdfMeasurement, dim: int, step: float) -> np.ndarray:
        a, r, t = (
            np.array(x) + (step if i == dim else 0.0)
            for i, x in enumerate((m.incidence_deg, m.receiving_deg, m.tilt_deg))
        )
        cosine = np.cos(np.deg2rad(r - a) / 2) * np.cos(np.deg2rad(t))
        angle = 2 * np.arctan2(np.sqrt(np.maximum(1 - cosine, 0)), np.sqrt(1 + cosine))
        return 20.0 + 80.0 * np.exp(-(angle**2) / (2 * 0.2**2))[:, None] * [0.8, 1.0, 1.2]

    m = analytic(step=5.0)
    inner = (m.incidence_deg < 65) & (abs(m.receiving_deg) < 60) & (abs(m.tilt_deg) < 60)
    gap = ~((m.incidence_deg == 20) & (abs(m.receiving_deg + 20) < 8))
    true = np.stack([near(m, i, h) - near(m, i, -h) for i in range(3)], axis=-1) / (2 * h)
    holed = replace(m, valid=gap)
    for one in (m, holed):
        found = slopes_per_deg(one.angles_deg, one.values, one.valid)
        use = inner & one.valid & (m.incidence_deg > 0)
        assert abs(found - true)[use].max() < 0.1 * abs(true).max()
        assert np.sqrt(np.mean(found[use] ** 2)) == pytest.approx(
            np.sqrt(np.mean(true[use] ** 2)), rel=0.02
        )
        assert (found[~one.valid] == 0).all()
    few = m.select(np.random.default_rng(0).permutation(len(m))[:3000])
    slopes = slopes_per_deg(few.angles_deg, few.values, few.valid)
    assert np.sqrt(np.mean(slopes**2)) == pytest.approx(np.sqrt(np.mean(true**2)), rel=0.3)
    assert (slopes_per_deg(m.angles_deg[:1], m.values[:1]) == 0).all()
