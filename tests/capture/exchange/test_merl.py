"""MERL's `.binary`: what is wrong with a file is said before its values are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.exchange import load_measurement, merl
from raden_torch.capture.exchange.directions import raden_degrees
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement


def header(*sizes: int, order: str = "<i4") -> bytes:
    return np.array(sizes, order).tobytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            header(90, 90, 180),
            "expected 34992012 bytes of 3 x 1458000 .*, got 12: .* truncated",
        ),
        (header(90, 90, 180) + bytes(5000), "got 5012: the file is truncated"),
        (header(90, 90, 180, order=">i4"), "expected little-endian numbers, got big-endian ones"),
        (
            header(4096, 4096, 4096),
            "of 90 x 90 x 180 cells, got 4096 x 4096 x 4096",
        ),
        (header(90, 90, 360) + bytes(100), "of 90 x 90 x 180 cells, got 90 x 90 x 360"),
    ],
)
def test_another_size_is_refused_in_a_line(tmp_path: Path, content: bytes, message: str) -> None:
    """Expectation: from 12 bytes; nothing of what they claim is asked of the memory."""
    path = tmp_path / "a.binary"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_measurement(path)


@pytest.mark.slow
def test_numbers_that_are_none_are_refused_and_too_many_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.binary"
    values = np.ones((3, merl.CELLS))
    path.write_bytes(header(90, 90, 180) + values.tobytes() + b"\0")
    with pytest.raises(InputError, match=r"at most 35 MB, got 34992013 bytes"):
        load_measurement(path)
    values[1, 7] = np.nan
    path.write_bytes(header(90, 90, 180) + values.tobytes())
    with pytest.raises(InputError, match="cell 8: expected finite numbers"):
        load_measurement(path)
    path.write_bytes(header(90, 90, 180) + np.full((3, merl.CELLS), -1.0).tobytes())
    assert not load_measurement(path).valid.any()


def test_positions_are_those_of_the_cells() -> None:
    """Expectation: the middle of cell (i, j, k) lies at (i, j, k), from our angles, too."""
    light, view = merl.cell_directions()
    some = np.random.default_rng(0).choice(merl.CELLS, 3000, replace=False)
    some = some[(light[2, some] > 0.01) & (view[2, some] > 0.01)]
    angles = np.stack(raden_degrees(light[:, some], view[:, some]), axis=1)
    wanted = np.array(np.unravel_index(some, merl.SHAPE), float)
    found = merl.positions(angles)
    np.testing.assert_allclose(found[:2], wanted[:2], atol=2e-4)
    sharp = wanted[0] > 3  # near the pole the azimuth means little
    np.testing.assert_allclose(found[2, sharp], wanted[2, sharp], atol=2e-3)


def test_what_lies_between_cells_is_linear_in_their_coordinates() -> None:
    """Rationale: a table that is linear in i and j, and a cosine in φ_d, which goes round."""
    i, j, k = np.indices(merl.SHAPE)
    known = np.stack([i + 2.0 * j + np.cos(2 * np.deg2rad(k + 0.5))] * 3, axis=-1)
    known[40] = np.nan
    cells = merl.Cells(known)
    a, r, t = np.random.default_rng(1).uniform([5, -60, -60], [60, 60, 60], (500, 3)).T
    angles = np.stack([a, r, t], axis=1)
    x, y, z = merl.positions(angles)
    expected = x + 2 * y + np.cos(2 * np.deg2rad(z + 0.5))
    whole = (abs(x - 40) > 1) & (y > 0)
    np.testing.assert_allclose(cells(angles)[whole, 0], expected[whole], atol=2e-4)
    beside = abs(cells(angles)[~whole, 0] - expected[~whole])[y[~whole] > 0]
    assert beside.max() < 1.001  # the nearest rows stand for the hole
    assert merl.Cells.of(BrdfMeasurement(a, r, t, np.ones((500, 3)))) is None
