"""Do values contradict beyond their uncertainty? Against SciPy's distributions and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from raden_torch.measurement.budget_terms import BudgetTerms
from raden_torch.measurement.consistency import Chi2, Covariance, pair_contradicts


@pytest.mark.parametrize(("value", "dof"), [(0.5, 1), (3.84, 1), (12.0, 12), (40.0, 12)])
def test_p_is_the_chi_squared_distributions(value: float, dof: int) -> None:
    found = Chi2(value, dof)
    assert found.p == pytest.approx(stats.chi2.sf(value, dof), rel=1e-12)
    assert found.birge == pytest.approx(np.sqrt(value / dof))


@pytest.mark.parametrize(
    ("value", "dof", "agrees"),
    [
        (6.6, 1, True),  # p just above 1 %
        (6.7, 1, False),
        (1.3e4, 10_000, True),  # improbable, but 1.14 times the uncertainty: not known better
        (1.5e4, 10_000, False),
    ],
)
def test_what_agrees(value: float, dof: int, agrees: bool) -> None:
    assert Chi2(value, dof).agrees is agrees


def test_shared_errors_are_in_the_deviation_of_each_difference() -> None:
    shared = np.array([[3.0], [0.0]])
    found = Covariance(np.array([16.0, 4.0]), shared)
    np.testing.assert_allclose(found.std, [5.0, 2.0])
    whole = np.diag([16.0, 4.0]) + shared @ shared.T
    d = np.array([5.0, -2.0])
    assert found.chi2(d).value == pytest.approx(d @ np.linalg.solve(whole, d))


def test_a_difference_that_all_share_is_one_deviation() -> None:
    """1000 readings that are off by one common deviation are not 1000 contradictions."""
    n = 1000
    covariance = Covariance(np.full(n, 1e-4), np.ones((n, 1)))
    assert covariance.chi2(np.ones(n)).value == pytest.approx(1.0, rel=1e-4)
    assert covariance.chi2(np.ones(n)).agrees


@pytest.mark.parametrize(
    ("second", "std", "contradicts"),
    [
        (104.9, None, False),  # within 5 % of the larger
        (105.4, None, True),
        (125.0, 5.0, False),  # five standard deviations
        (131.0, 5.0, True),
        (104.0, 0.01, False),  # below 5 %, whatever is stated
        (104.0, np.nan, False),
        (110.0, np.nan, True),
    ],
)
def test_two_readings_of_one_geometry(second: float, std: float | None, contradicts: bool) -> None:
    rows = np.array([[100.0, 100.0, 100.0]]), np.array([[100.0, second, 100.0]])
    deviation = None if std is None else np.full((1, 3), std)
    assert pair_contradicts(*rows, deviation).tolist() == [contradicts]


def test_a_budgets_total_leaves_the_scale_out() -> None:
    from dataclasses import dataclass

    @dataclass(frozen=True, eq=False)
    class Terms(BudgetTerms):
        noise: np.ndarray
        zero: np.ndarray

    terms = Terms(scale=np.full((2, 3), 9.0), noise=np.full((2, 3), 3.0), zero=np.full((2, 3), 4.0))
    np.testing.assert_array_equal(terms.total, np.full((2, 3), 5.0))
    assert list(terms.terms()) == ["noise", "zero", "scale"]
