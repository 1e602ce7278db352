"""Maps of cut pieces: their ranges, their seeds, and that they are the same at any resolution."""

from __future__ import annotations

import math

import pytest
import torch

from raden_torch.artwork.cutting import GAP, PieceMaps, cut
from raden_torch.artwork.flowers import (
    butterfly,
    cherry_blossom,
    chrysanthemum,
    leaf,
    plum_blossom,
    sideways_chrysanthemum,
)
from raden_torch.artwork.layers import HABITS, sheet
from raden_torch.artwork.pieces import ShellPiece, box, ellipse, polygon
from raden_torch.errors import InputError

SCALES = {name: (0.9, 1.0, 1.1) for name in HABITS}


def grid(n: int, half: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, float]:
    at = ((torch.arange(n, dtype=torch.float64) + 0.5) / n * 2 - 1) * half
    y, x = torch.meshgrid(-at, at, indexing="ij")
    return x, y, 2 * half / n


def bouquet() -> list[ShellPiece]:
    return [
        *butterfly(0.5, 0.5, 0.35, 2.0),
        *chrysanthemum(-0.3, 0.2, 0.5, 15),
        *leaf(0.1, -0.3, 0.5, -0.6),
        *cherry_blossom(0.6, -0.1, 0.2),
        *plum_blossom(-0.6, -0.6, 0.2),
        *sideways_chrysanthemum(0.0, -0.8, 0.3, 1.5),
    ]


def cut_at(n: int, seed: int = 3) -> PieceMaps:
    return cut(bouquet(), *grid(n), seed=seed)


def test_ranges() -> None:
    maps = cut_at(200)
    covered = maps.coverage > 0
    assert 0 <= maps.coverage.min() <= maps.coverage.max() <= 1
    assert (maps.piece >= 0).equal(covered)
    assert maps.piece.max() < len(bouquet())
    assert maps.shell.max() == len(maps.shells) - 1 == 3
    slopes = maps.layer_slope.norm(dim=0)
    assert (slopes[~covered[0]] == 0).all()
    assert 0.02 < slopes[covered[0]].mean() < math.tan(math.radians(15))
    assert (maps.tablets[~covered] == 1).all()
    assert 0.7 <= maps.tablets.min() < 0.95 < 1.05 < maps.tablets.max() <= 1.4


def test_pieces_keep_their_distance() -> None:
    """Two pieces that overlap: the lower is cut back to leave the gap, the upper stays whole."""
    x, y, pixel = grid(1000, 0.5)
    pieces = [box(0, 0, 0.1, 0.3), box(0.1, 0, 0.3, 0.1, shell="akoya")]
    maps = cut(pieces, x, y, pixel)
    row = maps.coverage[0, 500]
    gap = row[(x[500] > 0.09) & (x[500] < 0.15)]
    assert (1 - gap).sum() * pixel == pytest.approx(GAP, abs=0.1 * pixel)
    areas = [(maps.coverage * (maps.piece == k)).sum() * pixel**2 for k in (0, 1)]
    assert areas[0] == pytest.approx(0.2 * 0.6, rel=1e-3)
    assert areas[1] == pytest.approx((0.4 - 2 * GAP) * 0.2, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_anti_aliased_areas(angle: float) -> None:
    """Coverage is an area, whatever the sample's size."""
    corners = [(-0.31, -0.2), (0.4, -0.1), (0.05, 0.45)]
    triangle = 0.5 * abs(0.71 * 0.65 - 0.36 * 0.10)
    for n in (64, 256):
        x, y, pixel = grid(n)
        area = cut([ellipse(0, 0, 0.5, 0.3, angle)], x, y, pixel).coverage.sum() * pixel**2
        assert area == pytest.approx(math.pi * 0.15, rel=3e-3)
        area = cut([polygon(corners)], x, y, pixel).coverage.sum() * pixel**2
        assert area == pytest.approx(triangle, rel=1e-2)


def test_the_same_at_any_resolution() -> None:
    """A map is a finer one averaged, as far as pieces' edges let it."""
    coarse, fine = cut_at(100), cut_at(800)
    average = torch.nn.functional.avg_pool2d
    torch.testing.assert_close(
        average(fine.coverage, 8).mean(), coarse.coverage.mean(), rtol=0.03, atol=0
    )
    assert (average(fine.coverage, 8) - coarse.coverage).abs().mean() < 0.02
    whole = (average(fine.coverage, 8) > 0.999) & (coarse.coverage > 0.999)
    assert whole.sum() > 500
    for name, allowed in (("tablets", 0.004), ("layer_slope", 0.006)):
        small, large = getattr(coarse, name), average(getattr(fine, name), 8)
        error = (small - large)[whole.expand_as(small)]
        assert error.square().mean().sqrt() < allowed


def test_a_part_is_the_whole_s_part() -> None:
    x, y, pixel = grid(200)
    whole = cut(bouquet(), x, y, pixel, seed=1)
    part = cut(bouquet(), x[40:90, 30:150], y[40:90, 30:150], pixel, seed=1)
    for name in ("coverage", "piece", "shell", "layer_slope", "tablets"):
        torch.testing.assert_close(getattr(part, name), getattr(whole, name)[:, 40:90, 30:150])


def test_seeds() -> None:
    one, again, other = cut_at(80), cut_at(80), cut_at(80, seed=4)
    for name in ("coverage", "piece", "shell"):
        assert getattr(one, name).equal(getattr(again, name))
        assert getattr(one, name).equal(getattr(other, name))  # the drawing is the caller's
    for name in ("layer_slope", "tablets"):
        assert getattr(one, name).equal(getattr(again, name))
        assert not getattr(one, name).equal(getattr(other, name))


def test_pieces_differ_and_vary_within() -> None:
    maps = cut([box(x, 0, 0.12, 0.4, shell="mexican") for x in (-0.6, -0.2, 0.2, 0.6)], *grid(300))
    means, spreads = [], []
    for k in range(4):
        own = maps.tablets[maps.piece == k]
        means.append(own.mean())
        spreads.append(own.std())
    assert torch.stack(means).std() > 0.01
    assert torch.stack(spreads).min() > 0.01


@pytest.mark.parametrize("shell", HABITS)
def test_a_sheet_has_the_statistics_of_its_habit(shell: str) -> None:
    habit = HABITS[shell]
    generator = torch.Generator().manual_seed(0)
    u, v = 40 * torch.rand(2, 40_000, generator=generator, dtype=torch.float64)
    slope, tablets = sheet(habit, u, v, 1e-4, seed=5)
    lean = math.tan(math.radians(habit.lean_deg))
    line = math.tan(math.radians(habit.line_deg))
    expected = math.sqrt(lean**2 + line**2 / 4)
    assert slope.norm(dim=0).square().mean().sqrt() == pytest.approx(expected, rel=0.4)
    assert tablets.std() == pytest.approx(habit.tablets, rel=0.3)
    assert tablets.mean() == pytest.approx(1, abs=0.02)


def test_slopes_are_those_of_a_height() -> None:
    """Without growth lines the slopes have no curl: layers are surfaces."""
    habit = HABITS["awabi"]
    flat = type(habit)(**{**vars(habit), "line_deg": 0.0})
    u, v = torch.rand(2, 200, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    u.requires_grad_()
    v.requires_grad_()
    (along_u, along_v), _ = sheet(flat, u, v, 1e-4, seed=2)
    (crossed,) = torch.autograd.grad(along_u.sum(), v, retain_graph=True)
    (back,) = torch.autograd.grad(along_v.sum(), u)
    torch.testing.assert_close(crossed, back)


def test_weights_interpolate() -> None:
    maps = cut_at(120)
    weights = maps.weights(SCALES)
    assert weights.shape == (3 * len(HABITS), 120, 120)
    assert 0 <= weights.min() <= weights.max() <= 1
    torch.testing.assert_close(weights.sum(0), torch.ones(120, 120, dtype=torch.float64))
    scale = torch.tensor([0.9, 1.0, 1.1] * len(HABITS), dtype=torch.float64).view(-1, 1, 1)
    seen = maps.coverage[0] > 0
    meant = maps.tablets[0].clamp(0.9, 1.1)
    torch.testing.assert_close((weights * scale).sum(0)[seen], meant[seen])
    single = maps.weights({name: (1.0,) for name in maps.shells})
    assert single.argmax(0).equal(maps.shell[0])


def test_single_precision_will_do(dtype: torch.dtype) -> None:
    x, y, pixel = grid(100)
    maps = cut(bouquet(), x.to(dtype), y.to(dtype), pixel, seed=3)
    exact = cut_at(100)
    assert maps.coverage.dtype == maps.layer_slope.dtype == dtype
    assert (maps.coverage.double() - exact.coverage).abs().mean() < 1e-3
    same = (maps.piece == exact.piece) & (exact.coverage > 0.5)
    error = (maps.tablets.double() - exact.tablets)[same].abs()
    assert error.quantile(0.99) < 2e-3


def test_bad_input() -> None:
    x, y, pixel = grid(8)
    one = [ellipse(0, 0, 0.5, 0.5, 0.0)]
    with pytest.raises(InputError, match="at least one piece"):
        cut([], x, y, pixel)
    with pytest.raises(InputError, match="floating-point x and y"):
        cut(one, x, y[:4], pixel)
    with pytest.raises(InputError, match="positive pixel"):
        cut(one, x, y, 0.0)
    with pytest.raises(InputError, match=r"expected shells of yakogai.*got oyster"):
        cut([ellipse(0, 0, 0.5, 0.5, 0.0, "oyster")], x, y, pixel)
    maps = cut(one, x, y, pixel)
    with pytest.raises(InputError, match=r"none for .*yakogai"):
        maps.weights({"mexican": (1.0,)})
    with pytest.raises(InputError, match="rising"):
        maps.weights({"yakogai": (1.0, 0.9)})
