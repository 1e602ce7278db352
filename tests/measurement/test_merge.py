"""Several measurements become one: weights, scales, contradictions."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata, native_csv
from raden_torch.measurement.compare import compare
from raden_torch.measurement.merge import merge
from raden_torch.measurement.systematic_errors import SystematicErrors


def readings(seed: int, n: int = 40, **common) -> BrdfMeasurement:
    """The same truth for every seed; noise of 1 to 5 %, stated."""
    angles = np.random.default_rng(99).uniform(0, 70, (n, 3)).round(2)
    truth = 20 + 60 * np.exp(-(((angles[:, 1] - angles[:, 0]) / 15) ** 2))[:, None] * [0.9, 1, 1.1]
    rng = np.random.default_rng(seed)
    std = truth * rng.uniform(0.01, 0.05, truth.shape)
    return BrdfMeasurement(
        *angles.T,
        values=truth + std * rng.standard_normal(truth.shape),
        std=std,
        metadata=Metadata(f"shell {seed}", simulated=True, systematic=SystematicErrors(**common)),
    )


def scaled(m: BrdfMeasurement, factor: float) -> BrdfMeasurement:
    return replace(m, values=m.values * factor)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), scales=st.lists(st.floats(0.0, 0.05), min_size=3, max_size=3))
def test_the_order_does_not_matter(seed: int, scales: list[float]) -> None:
    rng = np.random.default_rng(seed)
    all_three = [
        readings(seed + i, scale_std=scale).select(rng.permutation(40)[:30])
        for i, scale in enumerate(scales)
    ]
    first, *others = (merge(order, robust=True).measurement for order in permutations(all_three))
    for other in others:
        np.testing.assert_allclose(other.values, first.values, rtol=1e-9)
        np.testing.assert_allclose(other.std, first.std, rtol=1e-9)
        np.testing.assert_array_equal(other.count, first.count)
        assert other.metadata.systematic.scale_std == pytest.approx(
            first.metadata.systematic.scale_std
        )
        assert other.metadata.sample == first.metadata.sample


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), copies=st.integers(2, 4))
def test_with_itself_the_variance_is_divided_by_the_copies(seed: int, copies: int) -> None:
    m = readings(seed)
    merged = merge([m] * copies)
    order = np.lexsort((m.tilt_deg, m.receiving_deg, m.incidence_deg))
    np.testing.assert_allclose(merged.measurement.values, m.values[order], rtol=1e-12)
    np.testing.assert_allclose(merged.measurement.std, m.std[order] / np.sqrt(copies), rtol=1e-12)
    assert (merged.measurement.count == copies).all()
    assert merged.chi2.value == pytest.approx(0, abs=1e-18)


def test_weights_are_inverse_variances_and_lone_cells_are_kept() -> None:
    a, b = readings(1), readings(2).select(np.arange(10, 40))
    a = a.select(np.arange(30))
    merged = merge([a, b])
    assert merged.shared == 20
    m = merged.measurement
    assert len(m) == 40
    here = {angle: row for row, angle in enumerate(m.incidence_deg.tolist())}
    for row in range(10):  # of the first alone
        at = here[a.incidence_deg[row]]
        np.testing.assert_array_equal(m.values[at], a.values[row])
        np.testing.assert_allclose(m.std[at], a.std[row])
        assert m.count[at] == 1
    weight_a, weight_b = a.std[10] ** -2, b.std[0] ** -2
    expected = (a.values[10] * weight_a + b.values[0] * weight_b) / (weight_a + weight_b)
    at = here[a.incidence_deg[10]]
    np.testing.assert_allclose(m.values[at], expected)
    np.testing.assert_allclose(m.std[at], (weight_a + weight_b) ** -0.5)
    assert m.metadata.simulated
    assert "shell 1" in dict(m.metadata.other)["merged 1"]


def test_the_result_is_as_good_as_it_says() -> None:
    """(merged − truth) / std has a mean square of 1 over 200 merges of three."""
    truth = np.mean([readings(seed).values for seed in range(3000, 5000)], axis=0)
    order = np.lexsort(readings(0).select(np.arange(40)).incidence_deg[None])
    z = []
    for run in range(200):
        m = merge([readings(3 * run + i) for i in range(3)]).measurement
        z.append((m.values - truth[order]) / m.std)
    assert np.mean(np.square(z)) == pytest.approx(1, abs=0.05)


def test_scales_meet_where_their_uncertainties_say() -> None:
    """Twice as uncertain, twice the way… squared: 4 : 1."""
    a = readings(1, n=400, scale_std=0.01)
    b = replace(scaled(a, 1.05), metadata=Metadata(systematic=SystematicErrors(scale_std=0.02)))
    merged = merge([a, b], robust=True)
    first, second = np.log(merged.scale_factors)
    assert second - first == pytest.approx(np.log(1.05), rel=0.02)
    assert -second / first == pytest.approx(4, rel=1e-3)
    left = merged.measurement.metadata.systematic.scale_std
    assert left == pytest.approx((0.01**-2 + 0.02**-2) ** -0.5, rel=0.02)


def test_one_that_states_no_scale_uncertainty_is_the_scale() -> None:
    a = readings(1, n=400)
    b = replace(scaled(a, 1.02), metadata=Metadata(systematic=SystematicErrors(scale_std=0.02)))
    merged = merge([a, b])
    assert merged.scale_factors == pytest.approx((1.0, 1.02), rel=1e-3)


def test_the_same_white_reference_is_one_error() -> None:
    tile = {"scale_std": 0.01, "scale_reference": "tile 1"}
    merged = merge([readings(1, **tile), readings(2, **tile)])
    assert merged.scale_factors == (pytest.approx(1, abs=1e-6),) * 2
    assert merged.measurement.metadata.systematic.scale_std == pytest.approx(0.01)
    assert merged.measurement.metadata.systematic.scale_reference == "tile 1"
    apart = merge([readings(1, scale_std=0.01), readings(2, scale_std=0.01)])
    assert apart.measurement.metadata.systematic.scale_std == pytest.approx(
        0.01 / np.sqrt(2), rel=0.1
    )


def test_contradictions_are_refused_by_name_or_enlarged() -> None:
    a, b = readings(1), readings(2)
    values = b.values.copy()
    values[7] *= 1.8
    b = replace(b, values=values)
    place = ", ".join(f"{x:g}" for x in (a.incidence_deg[7], a.receiving_deg[7], a.tilt_deg[7]))
    with pytest.raises(InputError) as error:
        merge([a, b])
    message = str(error.value)
    assert "\n" not in message
    assert message.index(f"({place} deg) Y = {a.values[7, 1]:.5g} and {b.values[7, 1]:.5g}")
    assert "`robust`" in message
    merged = merge([a, b], robust=True)
    assert merged.contradicting == 1
    m = merged.measurement
    row = int(np.flatnonzero(m.incidence_deg == a.incidence_deg[7])[0])
    plain = (a.std[7] ** -2 + b.std[7] ** -2) ** -0.5
    assert (m.std[row] > 4 * plain).all()
    assert "contradict" in str(merged)


def test_a_scatter_over_all_cells_is_refused_too() -> None:
    with pytest.raises(
        InputError, match=r"expected measurements that agree, got 1 and 2, which differ"
    ):
        merge([readings(1), scaled(readings(2), 1.06)])


def test_what_has_no_weight_is_refused() -> None:
    a = readings(1)
    with pytest.raises(
        InputError,
        match=r"of shell 1: expected columns std_X, std_Y, std_Z, got none",
    ):
        merge([a, replace(a, std=None)])
    gap = a.std.copy()
    gap[3, 1] = np.nan
    place = f"incidence {a.incidence_deg[3]:g}, receiving {a.receiving_deg[3]:g}"
    for b in (a, readings(2)):
        with pytest.raises(
            InputError, match=f"expected a standard deviation at {place}, .*, got none"
        ):
            merge([replace(a, std=gap), b])
        with pytest.raises(
            InputError, match=f"expected a standard deviation at {place}, .*, got none"
        ):
            compare(b, replace(a, std=gap))
    with pytest.raises(InputError, match=r"reading 1: std_X: expected at least 0, got -1"):
        replace(a, std=-np.ones_like(gap))
    with pytest.raises(InputError, match="two measurements or more"):
        merge([a])
    with pytest.raises(InputError, match="azimuth"):
        merge([a, replace(a, azimuth_deg=np.zeros(40))])


def test_what_is_common_survives_the_file(tmp_path: Path) -> None:
    common = SystematicErrors(
        0.0123456789, "tile 1234", 0.001, (0.05, 0.06, 0.07), (45.0, 0.0, -5.0)
    )
    m = readings(1)
    m = replace(m, metadata=replace(m.metadata, systematic=common))
    m.save(tmp_path / "m.csv")
    assert native_csv.read(tmp_path / "m.csv") == m


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("scale_std: much", "scale_std: expected one number, got 'much'"),
        ("scale_std: 2", "scale_std: expected 0…1, got 2"),
        ("scale_std: nan", "one number"),
        ("zero_std_deg: 1 2", "3 numbers"),
        (
            "zero_std_deg: 1 2 -3",
            "zero_std_deg: expected three numbers in 0…10 degrees, got 1.0 2.0 -3.0",
        ),
        ("white_deg: 90 0 0", "white_deg"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "m.csv"
    path.write_text(f"# {line}\nincidence_deg,receiving_deg,tilt_deg,X,Y,Z\n0,0,0,1,2,3\n")
    with pytest.raises(InputError, match=message) as error:
        native_csv.read(path)
    assert str(error.value).startswith(str(path))
