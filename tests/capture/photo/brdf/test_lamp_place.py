"""A lamp that stands elsewhere than the lights file says is told by its photograph alone."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from raden_torch.capture.photo.capture_brdf import CapturedBrdf, capture_brdf
from tests.capture.photo.brdf.conftest import Series, anywhere


def leaning(series: Series, lamp: int, by_deg: float) -> np.ndarray:
    """Writes a lights file in which a lamp is off along the great circle through the camera's axis:
    its photograph then fills other cells than it saw. Returns the offset `[3]` back to the truth,
    degrees."""
    content = json.loads(series.lights.read_text())
    entry = content["lamps"][lamp]
    way = np.array(entry["direction_to_lamp"])
    across = np.cross(way, [0, 0, 1.0])
    across /= np.linalg.norm(across)
    turn = np.radians(by_deg)
    said = way * np.cos(turn) + np.cross(across, way) * np.sin(turn)
    entry["direction_to_lamp"] = said.tolist()
    series.lights.write_text(json.dumps(content))
    off = way - said * (way @ said)
    return np.asarray(abs(by_deg) * off / np.linalg.norm(off))


def measured(sphere: Any, series: Series) -> tuple[CapturedBrdf, list[str]]:
    arguments = sphere.arguments(series)
    arguments["setup"] = replace(arguments["setup"], lamp_std_deg=0.1)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = capture_brdf(**arguments, go_on=True)
    return found, [str(w.message) for w in said if "seems to stand" in str(w.message)]


@pytest.mark.parametrize("by_deg", [2.0, -5.0, 10.0])
def test_a_lamp_that_is_off_is_named_with_its_offset(
    sphere: Any, sphere_series: Callable[..., Series], by_deg: float
) -> None:
    lamps = anywhere(sphere.triples, 3)
    series = sphere_series(
        lamps=lamps, radius=60.0, noise=0.005, lamp_error_deg=0.1, outline_error_px=0.1, seed=3
    )
    truth = leaning(series, 4, by_deg)
    found, said = measured(sphere, series)
    assert len(said) == 1
    assert said[0].startswith("photo4.png: lamp 5 seems to stand ")
    assert said[0] in found.notes
    at = found.places.lean_deg[4] @ found.lamps[4].across
    np.testing.assert_allclose(at, truth, atol=0.7)
    assert found.places.offset_deg[4] == pytest.approx(abs(by_deg), abs=0.5)


def test_a_rod_says_nothing_of_its_lamps(board: Any) -> None:
    """It has few of the geometries that ought to be alike: lamps that are right were named."""
    series = board.series(board.lamps(4), [(15.0, 25.0)] * 4, rod=True)
    found = capture_brdf(**board.arguments(series, rod=True), go_on=True)
    assert np.isnan(found.places.lean_deg).all()


def test_a_matt_sphere_tells_by_its_shading(
    sphere: Any, sphere_series: Callable[..., Series]
) -> None:
    def matt(normal: np.ndarray, light: np.ndarray, view: np.ndarray) -> np.ndarray:
        return np.full((len(normal), 3), 0.4 / np.pi)

    series = sphere_series(
        lamps=anywhere(sphere.triples, 1), radius=60.0, noise=0.003, brdf=matt, seed=1
    )
    leaning(series, 7, 4.0)
    found, said = measured(sphere, series)
    assert [line.split(":")[0] for line in said] == ["photo7.png"]
    assert found.places.offset_deg[7] == pytest.approx(4.0, abs=0.5)
