"""Every degenerate case: float32 against float64, half precision, and finite gradients."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
from raden_torch.brdf.shading.stress_geometries import Vectors, regions, worst_errors

NOISY = {"L near V, too near", "L near V, not unit"}


def invalid_vectors() -> Vectors:
    """Every triple in which at least one vector is zero or not finite: the value must be 0."""
    bad = [
        (0.0, 0.0, 0.0),
        (math.nan, 0.0, 1.0),
        (0.0, math.inf, 1.0),
        (-math.inf, math.nan, 0.0),
    ]
    good = [(0.0, 0.0, 1.0), (0.3, -0.2, 0.9)]
    triples = [
        (a, b, c)
        for a in bad + good
        for b in bad + good
        for c in bad + good
        if {a, b, c} & set(bad)
    ]
    maps = torch.tensor(triples, dtype=torch.float64).permute(1, 2, 0)[:, None, :, :, None]
    return maps[0], maps[1], maps[2]


@pytest.fixture(scope="module", params=["trilinear", "lobes"])
def shell(request: pytest.FixtureRequest) -> rt.RadenBrdf:
    """The paper's table, and a baked one."""
    return rt.fit(rt.simulate_specimen("yakogai"), interpolation=request.param).model


@torch.no_grad()
def test_float32_against_float64_in_every_region(shell) -> None:
    for name, error in worst_errors(shell, shell).items():
        assert error.finite, name
        if name not in NOISY:
            assert error.worst < 5e-6, name
    sets = regions()
    for name in NOISY:
        f = shell(*(v.float() for v in sets[name]))
        assert f.abs().max() <= shell.table.values.abs().max() * 1.001, name


@torch.no_grad()
def test_there_is_no_seam_at_perpendicular_incidence(shell) -> None:
    """(0, r, t) ≡ (0, −r, −t), between the nodes too."""
    generator = torch.Generator().manual_seed(0)
    r, t = (2 * torch.rand(2, 1, 2000, 1, generator=generator, dtype=torch.float64) - 1) * 1.2
    zero = torch.zeros_like(r)
    torch.testing.assert_close(
        shell.at_angles(zero, r, t), shell.at_angles(zero, -r, -t), rtol=1e-5, atol=1e-7
    )


@torch.no_grad()
def test_invalid_input_gives_zero(shell) -> None:
    vectors = invalid_vectors()
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        assert (shell(*(v.to(dtype) for v in vectors)) == 0).all()


@torch.no_grad()
@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_precision_maps_are_finite_everywhere(shell, half: torch.dtype) -> None:
    for name, vectors in regions(500).items():
        f = shell(*(v.to(half) for v in vectors))
        assert f.dtype == torch.float32
        assert torch.isfinite(f).all(), name


@pytest.mark.parametrize("exponent", [0.01, 0.5, 1.0, 50.0])
def test_gradients_are_finite_in_every_region(shell, exponent: float) -> None:
    from raden_torch.brdf.model.model import CosineDiffuse

    diffuse = CosineDiffuse(torch.ones(3), torch.full((3,), exponent))
    model = rt.RadenBrdf(diffuse, shell.table, diffuse_gain=0.7)
    for name, vectors in regions(300).items():
        maps = [v.float().requires_grad_() for v in vectors]
        f = model(*maps)
        assert torch.isfinite(f).all(), name
        f.sum().backward()
        for m in (*maps, *model.parameters()):
            assert torch.isfinite(m.grad).all(), name
        model.zero_grad()


def test_gradients_agree_with_differences_inside_cells(shell) -> None:
    generator = torch.Generator().manual_seed(3)
    u = torch.rand(3, 1, 8, 1, generator=generator, dtype=torch.float64)
    # the middle of a cell, away from its kinks
    a, r, t = ((5 * (2 + (8 * x).floor()) + 1.3 + 1.5 * x).deg2rad() for x in u)
    vectors = [v.requires_grad_() for v in rt.vectors_from_angles(a, r, t)]
    assert torch.autograd.gradcheck(shell, vectors, atol=1e-4)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@torch.no_grad()
def test_tables_of_any_dynamic_range(analytic, scale: float) -> None:
    """Values from 1 to 1e6 times the scale, and an a = 0 plane that is not symmetric."""
    m = analytic()
    generator = np.random.default_rng(0)
    values = scale * 10 ** (6 * generator.random(m.values.shape))
    for by_hand in (None, DiffuseParameters((scale,) * 3, (0.01,) * 3)):
        result = rt.fit(replace(m, values=values), diffuse=by_hand, interpolation="trilinear")
        assert result.report.asymmetry > 0.1
        for name, error in worst_errors(result.model, result.model, 500).items():
            assert error.finite, name
            if name not in NOISY:
                assert error.worst < 1e-4, name
        assert math.isfinite(result.report.reading_rms)
