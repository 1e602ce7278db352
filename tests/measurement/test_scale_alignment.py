"""Scales move towards each other as far as their uncertainties explain: against a minimiser."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.scale_alignment import aligned_scales
from raden_torch.measurement.stack import Stack
from raden_torch.measurement.systematic_errors import SystematicErrors


def measurement(values: np.ndarray, relative_std: float, first: int = 0) -> BrdfMeasurement:
    """Readings `[N, 3]` at receiving `first`, and every tenth of a degree from there."""
    n = len(values)
    return BrdfMeasurement(
        np.full(n, 10.0),
        first + 0.1 * np.arange(n),
        np.zeros(n),
        values=values,
        std=relative_std * abs(values),
    )


def closed_form(apart: float, u: tuple[float, float], noise: float) -> tuple[float, float]:
    """Of two scales that are `apart` in logarithm: each takes its share of the prior variance."""
    variance = np.square(u)
    shares = variance / (variance.sum() + noise**2)
    return apart * shares[0], -apart * shares[1]


@pytest.mark.parametrize("u", [(0.01, 0.01), (0.01, 0.03), (0.02, 0.0)])
def test_two_scales_share_their_difference_by_their_variances(u: tuple[float, float]) -> None:
    values = np.full((400, 3), 40.0)
    pair = [measurement(values * np.exp(0.002), 1e-3), measurement(values, 1e-3)]
    common = [SystematicErrors(scale_std=std) for std in u]
    found = aligned_scales(Stack.of(pair), common)
    noise = 1e-3 * np.sqrt(2 / (400 * 3))
    np.testing.assert_allclose(found.errors, closed_form(0.002, u, noise), rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(found.share, 0.5, atol=2e-3)


def test_what_remains_is_the_weighted_means_uncertainty() -> None:
    """Two independent scales of 1 % and 2 %, known against each other by many readings: what is
    left is 1/√(1/u₁² + 1/u₂²)."""
    values = np.full((400, 3), 40.0)
    stack = Stack.of([measurement(values, 1e-4), measurement(values, 1e-4)])
    found = aligned_scales(stack, [SystematicErrors(scale_std=u) for u in (0.01, 0.02)])
    assert found.remaining == pytest.approx((0.01**-2 + 0.02**-2) ** -0.5, rel=1e-3)


def test_scales_of_one_reference_move_together() -> None:
    """Expected: no move, and the reference's whole uncertainty remains; the noise of the two
    means of the white is each one's own."""
    values = np.full((400, 3), 40.0)
    stack = Stack.of([measurement(values * 1.001, 1e-4), measurement(values, 1e-4)])
    tile = SystematicErrors(scale_std=0.02, scale_reference="tile 1")
    found = aligned_scales(stack, [tile, tile])
    np.testing.assert_allclose(found.errors, 0.0, atol=1e-7)
    assert found.remaining == pytest.approx(0.02)
    noisy = SystematicErrors(scale_std=0.02, scale_reference="tile 1", white_mean_std=0.003)
    found = aligned_scales(stack, [noisy, noisy])
    assert found.errors[0] - found.errors[1] == pytest.approx(np.log(1.001), rel=1e-3)
    assert found.remaining == pytest.approx(np.hypot(0.02, 0.003 / np.sqrt(2)), rel=1e-3)


def test_without_shared_cells_nothing_moves() -> None:
    values = np.full((5, 3), 40.0)
    stack = Stack.of([measurement(2 * values, 0.01), measurement(values, 0.01, first=50)])
    found = aligned_scales(stack, [SystematicErrors(scale_std=0.05)] * 2)
    np.testing.assert_allclose(found.errors, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_least_of_the_objective(seed: int) -> None:
    """Σ (v − c exp(u z))² / std² + Σ z², minimised over z and all c by a general minimiser."""
    rng = np.random.default_rng(seed)
    u = np.array([0.01, 0.03, 0.02])
    truth = rng.uniform(5, 80, (12, 3))
    parts = []
    for factor in np.exp(rng.normal(0, 0.03, 3)):
        rows = np.sort(rng.permutation(12)[:9])
        noisy = truth[rows] * factor * rng.normal(1, 0.01, (9, 3))
        m = measurement(noisy, 0.01)
        parts.append(
            BrdfMeasurement(m.incidence_deg, 1.0 + rows, m.tilt_deg, values=noisy, std=m.std)
        )
    stack = Stack.of(parts)

    def objective(z: np.ndarray) -> float:
        scale = np.exp(u * z)[stack.source, None]
        weight = stack.weight * scale**2
        c = stack.total(weight * stack.values / scale) / stack.total(weight)
        chi2 = (stack.weight * (stack.values - c[stack.cell] * scale) ** 2).sum()
        return float(chi2 + (z**2).sum())

    best = minimize(objective, np.zeros(3), method="BFGS", options={"gtol": 1e-6})
    found = aligned_scales(stack, [SystematicErrors(scale_std=std) for std in u])
    np.testing.assert_allclose(found.errors, u * best.x, atol=1e-6)
