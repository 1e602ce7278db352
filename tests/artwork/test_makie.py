"""The maki-e lid: its maps, its gold, and that they hold at any resolution."""

from __future__ import annotations

import math

import pytest
import torch

from raden_torch.artwork.gold import Stroke, drawn, powder
from raden_torch.artwork.makie import LID, lid, lid_pieces
from raden_torch.optics import SPECIMENS


def window(n: int, left: float, top: float, side: float):
    at = (torch.arange(n, dtype=torch.float64) + 0.5) / n * side
    y, x = torch.meshgrid(top - at, left + at, indexing="ij")
    return x, y, side / n


def test_pieces_lie_on_the_lid_and_are_of_known_shells() -> None:
    shells = set()
    for piece in lid_pieces():
        assert abs(piece.x) < LID[0]
        assert abs(piece.y) < LID[1]
        shells.add(piece.shell)
    assert shells <= set(SPECIMENS)
    assert len(shells) >= 2


def test_the_lid_s_maps() -> None:
    maps = lid(*window(160, -1.4, 1.0, 2.0))
    assert maps.gold.shape == maps.shell.coverage.shape == (1, 160, 160)
    assert 0 <= maps.gold.min() <= maps.gold.max() <= 1
    assert 0.1 < maps.shell.coverage.mean() < 0.5
    low, high = maps.gold[0, -40:, :40].mean(), maps.gold[0, :40, -40:].mean()
    assert low > 4 * high  # gold from the lower left
    again = lid(*window(160, -1.4, 1.0, 2.0))
    assert again.gold.equal(maps.gold)
    other = lid(*window(160, -1.4, 1.0, 2.0), seed=8)
    assert not other.shell.tablets.equal(maps.shell.tablets)


def test_gold_holds_its_density_at_any_resolution() -> None:
    coarse = lid(*window(40, -1.3, -0.5, 0.4)).gold
    fine = lid(*window(320, -1.3, -0.5, 0.4)).gold
    other = lid(*window(320, -1.3, -0.5, 0.4), seed=8).gold
    assert not other.equal(fine)
    assert fine.mean() == pytest.approx(float(coarse.mean()), abs=0.04)


@pytest.mark.parametrize("density", [0.02, 0.2, 0.5, 0.8])
@pytest.mark.parametrize("pixel", [0.05, 0.3, 1.0, 3.0])
def test_powder_covers_what_is_asked_for(density: float, pixel: float) -> None:
    """The mean over many flakes is the density, whatever the sample's size."""
    n = 400
    x, y, _ = window(n, 3.0, 5.0, n * pixel)
    covered = powder(torch.full_like(x, density), x, y, pixel, flake=1.0, seed=1)
    flakes = (n * pixel) ** 2
    allowed = 0.02 + 2 / math.sqrt(flakes)
    assert covered.mean() == pytest.approx(density, abs=allowed)
    assert 0 <= covered.min() <= covered.max() <= 1


def test_no_powder_where_none_is_asked_for() -> None:
    x, y, pixel = window(100, 0.0, 0.0, 1.0)
    density = (x > 0.5).double() * 0.6
    covered = powder(density, x, y, pixel, flake=0.02, seed=1)
    assert (covered[x < 0.5] == 0).all()
    assert covered[x > 0.5].max() > 0.85


@pytest.mark.parametrize("n", [50, 400])
def test_a_stroke_s_area(n: int) -> None:
    """A straight stroke from width 0.02 to 0.06, and half a disc at each end."""
    x, y, pixel = window(n, -0.5, 0.5, 1.0)
    line = Stroke([(-0.3, 0.1), (0.3, 0.1)], 0.02, 0.06)
    area = drawn([line], x, y, pixel).sum() * pixel**2
    ends = math.pi / 8 * (0.02**2 + 0.06**2)
    assert area == pytest.approx(0.6 * 0.04 + ends, rel=0.02)
    assert drawn([], x, y, pixel).abs().max() == 0
