"""Eqs (3)–(6) and the fit of their parameters."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters, angle_from_mirror, fit_diffuse
from raden_torch.brdf.model.diffuse import diffuse
from raden_torch.errors import InputError
from raden_torch.geometry import raden_angles, vectors_from_angles


def at(a: float, r: float, t: float, scale: list[float], exponent: list[float]) -> list[float]:
    angles = [torch.tensor([[[math.radians(x)]]], dtype=torch.float64) for x in (a, r, t)]
    parameters = [torch.tensor(x, dtype=torch.float64) for x in (scale, exponent)]
    return diffuse(*angles, *parameters).flatten().tolist()


def test_the_formula_by_hand() -> None:
    assert at(60, 60, 60, [1, 2, 3], [1, 2, 0.5]) == pytest.approx(
        [0.5 * 0.25, 2 * 0.25 * 0.25, 3 * 0.25 * math.sqrt(0.5)]
    )
    assert at(0, 10, 20, [1, 1, 1], [0.01, 1, 50]) == [0, 0, 0]


@pytest.mark.parametrize("n", [0.01, 0.5, 1.0, 2.0, 50.0])
def test_gradient_is_finite_everywhere_and_zero_at_perpendicular(
    n: float, dtype: torch.dtype
) -> None:
    a = torch.tensor([0.0, 1e-20, 1e-12, 1e-8, 1e-4, 0.5, 1.5], dtype=dtype).view(1, -1, 1)
    a.requires_grad_()
    exponent = torch.full((3,), n, dtype=dtype, requires_grad=True)
    zero = torch.zeros_like(a)
    value = diffuse(a, zero, zero, torch.ones(3, dtype=dtype), exponent)
    value.sum().backward()
    assert torch.isfinite(a.grad).all()
    assert torch.isfinite(exponent.grad).all()
    assert a.grad[0, 0, 0] == 0


def test_float32_keeps_its_digits_at_small_incidence() -> None:
    a = torch.logspace(-6, 0, 50, dtype=torch.float64).view(1, -1, 1).float()
    zero, one = torch.zeros_like(a), torch.ones(3)
    got = diffuse(a, zero, zero, one, one).double()
    truth = diffuse(a.double(), zero.double(), zero.double(), one.double(), one.double())
    assert ((got - truth).abs() / truth).max() < 1e-6


def grid_angles(seed: int = 0, n: int = 6000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    u = np.random.default_rng(seed).random((3, n))
    return u[0] * 1.2, (2 * u[1] - 1) * 1.2, (2 * u[2] - 1) * 1.2


@pytest.mark.parametrize(
    ("scale", "exponent"),
    [((0.1, 0.2, 0.3), (0.7, 1.0, 2.0)), ((0.05, 0.01, 0.4), (5.0, 20.0, 0.6))],
)
def test_fit_finds_the_parameters_under_ridge_and_noise(scale, exponent) -> None:
    """Rationale: the low envelope is what the formula made; everything else lies above it."""
    a, r, t = grid_angles()
    true = [
        s * np.cos(t) * np.cos(r) * (2 * np.sin(a / 2) ** 2) ** n
        for s, n in zip(scale, exponent, strict=True)
    ]
    generator = np.random.default_rng(1)
    ridge = 5.0 * np.exp(-((angle_from_mirror(a, r, t) / 0.15) ** 2))
    # a tenth of the readings is lifted far up, as by glints
    glints = (generator.random(len(a)) < 0.1) * generator.random(len(a))
    f_r = np.stack(true, axis=1) + (ridge + glints)[:, None]
    found = fit_diffuse((a, r, t), f_r)
    assert found.scale == pytest.approx(scale, rel=0.02)
    assert found.exponent == pytest.approx(exponent, rel=0.02)


def test_fit_stays_within_its_bounds_and_above_zero() -> None:
    a, r, t = grid_angles()
    flat = fit_diffuse((a, r, t), np.full((len(a), 3), 0.3))
    assert flat.exponent == pytest.approx((0.5, 0.5, 0.5))
    assert fit_diffuse((a, r, t), np.full((len(a), 3), -0.3)).scale == (0, 0, 0)
    only_ridge = angle_from_mirror(a, r, t) < 0.1
    angles = tuple(x[only_ridge] for x in (a, r, t))
    assert fit_diffuse(angles, np.ones((int(only_ridge.sum()), 3))).scale == (0, 0, 0)


def test_angle_from_mirror_is_the_angle_between_vectors() -> None:
    a, r, t = (torch.from_numpy(x)[None, :, None] for x in grid_angles(n=500))
    normal, light, view = vectors_from_angles(a, r, t)
    mirror = 2 * (normal * light).sum(0, keepdim=True) * normal - light
    between = torch.acos((mirror * view).sum(0).clamp(-1, 1)).flatten().numpy()
    found = angle_from_mirror(*(x.flatten().numpy() for x in raden_angles(normal, light, view)))
    assert found == pytest.approx(between, abs=1e-6)


@pytest.mark.parametrize(
    ("scale", "exponent"),
    [
        ((1, 1), (1, 1, 1)),
        ((1, 1, -1), (1, 1, 1)),
        ((1, 1, 1), (1, 0, 1)),
        ((1, 1, np.nan), (1, 1, 1)),
    ],
)
def test_wrong_parameters_are_refused(scale, exponent) -> None:
    with pytest.raises(InputError, match="diffuse"):
        DiffuseParameters(scale, exponent)
