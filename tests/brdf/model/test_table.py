"""Trilinear reading: against SciPy, at nodes, outside the box, and its gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.errors import InputError

FIRST, STEP, SHAPE = (0.0, -30.0, -20.0), (5.0, 10.0, 4.0), (4, 7, 11)


def make(dtype: torch.dtype = torch.float64) -> ReflectanceTable:
    generator = torch.Generator().manual_seed(0)
    return ReflectanceTable(torch.rand(*SHAPE, 3, generator=generator, dtype=dtype), FIRST, STEP)


def radians(degrees: np.ndarray, dtype: torch.dtype = torch.float64) -> list[torch.Tensor]:
    return [torch.from_numpy(np.deg2rad(column))[None, :, None].to(dtype) for column in degrees.T]


def axes() -> list[np.ndarray]:
    return [f + s * np.arange(n) for f, s, n in zip(FIRST, STEP, SHAPE, strict=True)]


def test_agrees_with_scipy(dtype: torch.dtype, tolerance: float) -> None:
    table = make(dtype)
    inside = np.random.default_rng(1).random((1000, 3)) * [15, 60, 40] + FIRST
    expected = RegularGridInterpolator(axes(), table.values.detach().double().numpy())(inside)
    value, weight = table(*radians(inside, dtype))
    assert value[:, :, 0].T.detach().numpy() == pytest.approx(expected, abs=10 * tolerance)
    assert (weight == 1).all()


def test_nodes_are_exact() -> None:
    table = make()
    nodes = np.stack(np.meshgrid(*axes(), indexing="ij"), axis=-1).reshape(-1, 3)
    value, _ = table(*radians(nodes))
    expected = table.values.reshape(-1, 3)
    torch.testing.assert_close(value[:, :, 0].T, expected, atol=1e-13, rtol=0)


def test_outside_the_edge_fades_over_one_step() -> None:
    table = make()
    edge = table.values[-1, 3, 5]
    degrees = np.array([[x, 0.0, 0.0] for x in (15, 16, 17.5, 19, 20, 60)])
    value, weight = table(*radians(degrees))
    torch.testing.assert_close(value[:, :, 0].T, edge.expand(6, 3))
    assert weight.flatten().tolist() == pytest.approx([1, 0.8, 0.5, 0.2, 0, 0])
    corner = np.array([[17.5, 35.0, 22.0]])
    assert table(*radians(corner))[1].item() == pytest.approx(0.125)


def test_gradient_in_angles_and_values() -> None:
    table = make()
    generator = torch.Generator().manual_seed(2)
    u = torch.rand(3, 1, 10, 1, generator=generator, dtype=torch.float64)
    angles = [(0.2 * x).requires_grad_() for x in u]

    def read(values: torch.Tensor, *angles: torch.Tensor) -> torch.Tensor:
        value, weight = torch.func.functional_call(table, {"values": values}, angles)
        return value * weight

    assert torch.autograd.gradcheck(read, (table.values, *angles))


def test_wrong_tables_are_refused() -> None:
    with pytest.raises(InputError, match=r"\[1, 2, 2, 3\]"):
        ReflectanceTable(torch.ones(1, 2, 2, 3), FIRST, STEP)
    with pytest.raises(InputError, match="positive steps"):
        ReflectanceTable(torch.ones(2, 2, 2, 3), FIRST, (5.0, 0.0, 5.0))


PIECES = ((1, 2, 4), (1,) * 4 + (4,) + (2,) * 4, (1, 8) + (1,) * 8)


def baked() -> ReflectanceTable:
    """A baked table of f = 1 + a + 2 r + 3 t (linear, so that reading it is exact)."""
    first, step = (0.0, -15.0, -20.0), (5.0, 5.0, 4.0)
    axes = [
        np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(cuts))])
        for cuts in PIECES
    ]
    a, across, t = np.meshgrid(*axes, indexing="ij")
    a, d, t = a * 5, across * 5 + (-15.0 - 15.0), t * 4 - 20
    values = torch.from_numpy(1 + a + 2 * (a + d) + 3 * t)[..., None].expand(-1, -1, -1, 3)
    return ReflectanceTable(values.clone(), first, step, PIECES)


def test_a_baked_table_is_read_along_the_ridge(dtype: torch.dtype, tolerance: float) -> None:
    table = baked().to(dtype)
    assert table.cells == (3, 6, 10)
    assert table.last_deg == (15.0, 15.0, 20.0)
    points = np.random.default_rng(3).random((2000, 3)) * [15, 30, 40] - [0, 15, 20]
    value, weight = table(*radians(points, dtype))
    expected = 1 + points @ [1.0, 2.0, 3.0]
    assert value[0, :, 0].detach().double().numpy() == pytest.approx(expected, abs=300 * tolerance)
    assert (weight == 1).all()
    outside = np.array([[17.5, 15.0, 0.0], [15.0, 17.5, 0.0], [15.0, -17.5, 0.0], [5.0, 0, 24.0]])
    value, weight = table(*radians(outside, dtype))
    assert weight.flatten().tolist() == pytest.approx([0.5, 0.5, 0.5, 0.0], abs=1e-5)
    edge = 1 + np.clip(outside, [0, -15, -20], [15, 15, 20]) @ [1.0, 2.0, 3.0]
    assert value[0, :, 0].detach().numpy() == pytest.approx(edge, abs=300 * tolerance)


def test_wrong_pieces_are_refused() -> None:
    values = torch.ones(3, 4, 5, 3)
    with pytest.raises(InputError, match="axis 0: expected 4 nodes for its pieces, got 3"):
        ReflectanceTable(values, FIRST, STEP, ((1, 2), (1, 1, 1), (1, 1, 1, 1)))
    with pytest.raises(InputError, match="more cells along"):
        ReflectanceTable(torch.ones(3, 3, 5, 3), FIRST, STEP, ((1, 1), (1, 1), (1, 1, 1, 1)))
