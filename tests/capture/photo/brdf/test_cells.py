"""Cells, the reservoir and the fit within a cell, on made samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raden_torch.capture.photo.brdf.cell_fit import FEWEST, robust_fit
from raden_torch.capture.photo.brdf.cell_sums import CellSums
from raden_torch.capture.photo.brdf.photo_cells import MAX_CELLS, CellGrid, basis
from raden_torch.capture.photo.brdf.reservoir import Reservoir, rank_in_group
from raden_torch.errors import InputError

ANGLES = st.tuples(
    st.floats(0, 90, width=32), st.floats(-90, 90, width=32), st.floats(-90, 90, width=32)
)


@given(angles=st.lists(ANGLES, max_size=20), step=st.sampled_from([2.5, 5.0, 10.0]))
def test_a_sample_lies_within_half_a_step_of_its_node(angles: list, step: float) -> None:
    grid = CellGrid(step)
    given_ = np.array(angles, np.float32).reshape(-1, 3)
    rows, cell, x = grid.sort(given_)
    assert (np.abs(x) <= 0.5 + 1e-5).all()
    place = grid.nodes_deg()[cell] + step * x
    mirrored = np.abs(place - given_[rows]).max(axis=1, initial=0) > 1e-3
    np.testing.assert_allclose(place[~mirrored], given_[rows][~mirrored], atol=1e-3)
    np.testing.assert_allclose(-place[mirrored], given_[rows][mirrored], atol=1e-3)
    assert set(rows) == set(np.flatnonzero((np.rint(np.abs(given_ / step)) <= grid.side).all(1)))


def test_at_incidence_0_a_sample_stands_on_both_sides() -> None:
    rows, cell, x = CellGrid().sort(np.array([[1.0, 20.0, 10.0]], np.float32))
    assert rows.tolist() == [0, 0]
    nodes = CellGrid().nodes_deg()[cell]
    assert nodes.tolist() == [[0, 20, 10], [0, -20, -10]]
    np.testing.assert_allclose(x, [[0.2, 0, 0], [-0.2, 0, 0]], atol=1e-6)


def test_grids_that_cannot_be() -> None:
    with pytest.raises(InputError, match="whole number of steps"):
        CellGrid(3.0)
    with pytest.raises(InputError, match=f"at most {MAX_CELLS}"):
        CellGrid(0.5)
    with pytest.raises(InputError, match="a limit below 90 degrees, got steps of 5 up to 90"):
        CellGrid(5.0, 90.0)
    with pytest.raises(InputError, match="whole number"):
        CellGrid(0.0)


@given(sizes=st.lists(st.integers(1, 5), max_size=8))
def test_ranks_start_anew_in_each_group(sizes: list[int]) -> None:
    group = np.repeat(np.arange(len(sizes)), sizes)
    assert rank_in_group(group).tolist() == [k for size in sizes for k in range(size)]


def test_a_reservoir_is_bounded_and_fair() -> None:
    """However the samples come, each has the same chance; the number kept is bounded."""
    kept = Reservoir.of(4)
    for batch in range(50):
        cell = np.repeat(np.arange(3), [400, 40, 1])
        y = np.full((len(cell), 3), batch, np.float32)
        kept.add(cell, batch, np.zeros((len(cell), 3), np.float32), y, cell + 7 * batch)
    counts = np.bincount(kept.cell, minlength=4)
    assert counts.tolist() == [kept.size, kept.size, 50, 0]
    assert (np.diff(kept.cell) >= 0).all()
    for cell in (0, 1):
        batches = kept.y[kept.cell == cell, 0]
        assert 18 < batches.mean() < 31  # 24.5 ± 1.5 by chance
    np.testing.assert_array_equal(kept.shot, kept.y[:, 0])
    np.testing.assert_array_equal(kept.pixel, kept.cell + 7 * kept.shot)


def fitted(x: np.ndarray, y: np.ndarray, neighbour: float = 2.0):
    """One cell's samples, and a neighbouring cell that tells how steep it may be."""
    grid = CellGrid()
    cell = grid.cells // 2
    kept = Reservoir.of(grid.cells)
    other = np.repeat(np.float32(neighbour), 30)[:, None] * np.ones(3, np.float32)
    kept.add(np.full(len(x), cell), 0, x, y, np.arange(len(x)))
    kept.add(np.full(30, cell + 1), 0, np.zeros((30, 3), np.float32), other, np.arange(30))
    fit = robust_fit(kept, grid)
    sums = CellSums(fit)
    sums.add(np.full(len(x), cell), x, y)
    nodes = sums.nodes(grid)
    return nodes.value[cell], np.hypot(nodes.noise, nodes.place)[cell], nodes.count[cell]


@pytest.mark.parametrize("outliers", [0.0, 0.1, 0.3])
def test_the_node_s_value_whatever_the_samples_mean(outliers: float) -> None:
    """A curved surface, samples in one corner of the cell: their mean is 30 % off, the node's
    value is not; gross outliers, all to one side, change nothing up to a third of the samples."""
    random = np.random.default_rng(3)
    x = (random.random((500, 3)) * [0.9, 0.7, 1.0] - [0.3, 0.5, 0.5]).astype(np.float32)
    truth = np.array([1.0, 0.8, 1.2])
    slopes = np.r_[1.0, 0.5, -1.2, 0.3, -0.4, -0.6, 0.2, 0.1, 0.0, 0.2]
    y = (basis(x) @ slopes)[:, None] * truth + 0.01 * random.normal(size=(500, 3))
    bad = random.random(500) < outliers
    y[bad] = 25.0
    value, std, count = fitted(x, y.astype(np.float32))
    np.testing.assert_allclose(value, truth, rtol=0.02)
    assert (np.abs(value - truth) < 4 * std).all()
    assert (std < 0.02).all()
    assert abs(count - (~bad).sum()) < 10


def test_what_no_sample_tells_of_is_in_the_standard_deviation() -> None:
    """Samples on one sheet, 0.4 steps off the node: the slope towards it is not known."""
    random = np.random.default_rng(4)
    x = (random.random((300, 3)) - 0.5).astype(np.float32)
    x[:, 2] = 0.4
    y = (1 + 0.5 * x[:, 2:] + 0.002 * random.normal(size=(300, 3))).astype(np.float32)
    value, std, _ = fitted(x, y)
    assert (np.abs(value - 1) > 0.1).all()
    assert (np.abs(value - 1) < 2 * std).all()


def test_too_few_samples_are_no_value() -> None:
    x = np.zeros((FEWEST - 1, 3), np.float32)
    value, _, count = fitted(x, np.ones_like(x))
    assert np.isnan(value).all()
    assert count == 0
