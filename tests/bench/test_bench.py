"""The benchmark says what it claims to say; how fast anything is, no test asserts."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.bench import naive, run_bench, simulated_pair
from raden_torch.bench.simulated_truth import sphere_delta_e
from raden_torch.bench.timing import frame_vectors
from raden_torch.reflectance.interpolation import SCHEMES


def test_the_naive_form_is_the_same_model(analytic) -> None:
    """Inside the box; outside it has no fade."""
    model = rt.fit(analytic(), interpolation="trilinear").model
    vectors = frame_vectors(60, 90)
    degrees = torch.rad2deg(torch.cat(rt.raden_angles(*vectors), dim=1))
    inside = (degrees.abs() < 70).all(dim=1, keepdim=True).expand(1, 3, 60, 90)
    with torch.no_grad():
        difference = (naive(model, *vectors) - model(*vectors)).abs()
    assert inside.float().mean() > 0.5
    assert difference[inside].median() < 1e-6
    assert difference[inside].quantile(0.99) < 1e-3


def test_delta_e_falls_with_the_interpolators_error() -> None:
    m, off = simulated_pair()
    assert len(off) == 4000
    paper, ours = (rt.fit(m, interpolation=name).model for name in ("trilinear", "lobes"))
    found = [sphere_delta_e(model, 48) for model in (paper, ours)]
    assert found[1] < 0.6 * found[0]
    assert found[0] < 3


@pytest.mark.slow
def test_bench_writes_its_numbers_and_its_plot(tmp_path: Path, analytic, monkeypatch) -> None:
    from raden_torch.bench import timing

    monkeypatch.setattr(timing, "SCALING", (16, 32))
    m = analytic()
    off = rt.simulate_specimen("yakogai", geometries_deg=np.array([[10.0, 12.0, 3.0]] * 10))
    said: list[str] = []
    plot = run_bench(tmp_path, m, off, say=said.append, frame=(18, 32))
    about = json.loads((tmp_path / "bench.json").read_text())
    assert {row["scheme"] for row in about["rows"]} == set(SCHEMES)
    assert {"eager", "naive"} <= {row["backend"] for row in about["rows"]}
    assert all(row["times_floor"] > 0 for row in about["rows"])
    assert {row["precision"] for row in about["rows"]} == {
        *("float32", "float64", "float16", "bfloat16")
    }
    assert len(said) == len(about["rows"])
    assert [row["pixels"] for row in about["scaling"]] == [256, 1024]
    assert "eager" in about["stability"]
    for regions in about["stability"].values():
        assert all(region["finite"] for region in regions.values())
    assert cv2.imread(str(plot)).shape[1] > 800
