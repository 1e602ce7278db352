"""The benchmark says what it claims to say; how fast anything is, no test asserts."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.bench import forms, naive, run_bench, simulated_pair, timing
from raden_torch.bench.forms import (
    FIT,
    NAIVE,
    NODE_COUNTS,
    PAPER,
    RUNTIME,
    Form,
    by_fit_form,
    with_nodes,
    without_gradients,
)
from raden_torch.bench.region_errors import by_region, shader_score
from raden_torch.bench.simulated_truth import sphere_delta_e
from raden_torch.bench.timing import frame_vectors, time_ratios
from raden_torch.brdf.fitting.score import fit_form_factors, score, score_of
from raden_torch.brdf.model import simd
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix


@pytest.fixture(scope="module")
def shell() -> tuple[BrdfMeasurement, BrdfMeasurement]:
    """A coarse grid, and every tenth of the readings off it."""
    _, readings = simulated_pair()
    return rt.simulate_specimen("yakogai", step_deg=10), readings.select(np.arange(0, 8000, 10))


@pytest.fixture(scope="module")
def written(
    shell: tuple[BrdfMeasurement, BrdfMeasurement], tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, Any], Path, list[str]]:
    """What `run_bench` wrote: its numbers, its plot, and what it said."""
    folder, said = tmp_path_factory.mktemp("bench"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "SCALING", (16, 32))
        patch.setattr(timing, "_LEAST_S", 0.0001)
        picture = run_bench(folder, *shell, say=said.append, frame=(18, 32), runs=1)
    return json.loads((folder / "bench.json").read_text()), picture, said


def test_the_naive_form_is_the_same_model(analytic) -> None:
    """Inside the box; outside it has no fade."""
    model = rt.fit(analytic(), interpolation="trilinear", outside="diffuse").model
    vectors = frame_vectors(60, 90)
    degrees = torch.rad2deg(torch.cat(rt.raden_angles(*vectors), dim=1))
    inside = (degrees.abs() < 70).all(dim=1, keepdim=True).expand(1, 3, 60, 90)
    difference = (naive(model, *vectors) - by_fit_form(model)(*vectors)).abs()
    assert inside.float().mean() > 0.5
    assert difference[inside].median() < 1e-6
    assert difference[inside].quantile(0.99) < 1e-4


def test_the_fit_form_by_vectors_is_the_one_by_angles(shell) -> None:
    model = rt.fit(shell[0]).model
    readings = by_region(shell[1], model)["hemisphere"]
    expected = score_of(fit_form_factors(model, readings), readings)
    found = shader_score(by_fit_form(model), readings, torch.float64)
    assert found.rms == pytest.approx(expected.rms, rel=1e-4)
    assert found.log_error == pytest.approx(expected.log_error, rel=1e-4)
    down = torch.tensor([0.0, 0.0, -1.0]).view(1, 3, 1, 1)
    assert by_fit_form(model)(-down, -down, down).eq(0).all()


def test_delta_e_falls_with_the_interpolators_error() -> None:
    m = rt.simulate_specimen("yakogai", step_deg=7)
    paper, ours = (rt.fit(m, interpolation=name).model for name in ("trilinear", "lobes"))
    found = [sphere_delta_e(by_fit_form(model), 48) for model in (paper, ours)]
    assert found[1] < 0.6 * found[0]
    assert found[0] < 3


def test_half_of_the_readings_lie_outside_the_box() -> None:
    _, readings = simulated_pair()
    angles = abs(readings.angles_deg)
    outside = (angles > 70).any(axis=1)
    assert (outside == (np.arange(8000) >= 4000)).all()
    cosines = np.cos(np.radians(angles))
    # of light and viewer: cos a cos t and cos r cos t
    assert (cosines[:, :2] * cosines[:, 2:])[outside].min() >= np.cos(np.radians(80)) - 1e-9
    assert readings.valid.all()


def test_readings_by_the_models_own_box(shell) -> None:
    small = shell[0].select((abs(shell[0].angles_deg) <= 50).all(axis=1))
    model = rt.fit(small).model
    readings = rt.simulate_specimen(
        "yakogai",
        geometries_deg=[[10, 50, 3], [10, 50.1, 3], [50, -50, -50], [60, 0, 0], [0, 0, 0]],
    )
    found = by_region(readings, model)
    assert list(found) == ["inside", "outside", "hemisphere"]
    assert found["inside"].incidence_deg.tolist() == [10, 50, 0]
    assert found["outside"].incidence_deg.tolist() == [10, 60]
    assert len(found["hemisphere"]) == 5
    assert list(by_region(found["inside"], model)) == ["inside", "hemisphere"]


def test_times_are_over_the_copy_and_the_naive_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that the forms turn themselves."""
    now = [0.0]

    def lasting(seconds: float) -> Any:
        def work(*_: object) -> None:
            now[0] += seconds

        return work

    class Clock:
        perf_counter = staticmethod(lambda: now[0])

    monkeypatch.setattr(timing, "time", Clock)
    monkeypatch.setattr(timing, "_copy", lambda vectors: lasting(0.25))
    found = [
        Form(PAPER, 1, False, NAIVE, "float32", lasting(8.0)),
        Form(RUNTIME, 1, True, "eager", "float16", lasting(2.0)),
    ]
    assert time_ratios(found, frame_vectors(2, 3), 3) == [(32, 1), (8, 0.25)]


def test_rows(written) -> None:
    about, picture, said = written
    rows = about["rows"]
    assert len(said) == len(rows)
    by_form = {form: [row for row in rows if row["form"] == form] for form in (PAPER, FIT, RUNTIME)}
    assert [row["backend"] for row in by_form[PAPER]] == [NAIVE, "eager"]
    assert [row["backend"] for row in by_form[FIT]] == ["eager"]
    assert {row["backend"] for row in by_form[RUNTIME]} == {*simd.LEVELS, "eager"}
    assert all(row["times_floor"] > 0 and row["times_naive"] > 0 for row in rows)
    assert by_form[PAPER][0]["times_naive"] == 1
    default = [row for row in rows if row["default"]]
    assert {row["precision"] for row in default} == {*forms.PRECISIONS}
    assert {row["nodes"] for row in default} == {about["default_nodes"]}
    others = [row for row in by_form[RUNTIME] if not row["default"]]
    assert {row["precision"] for row in others} == {"float32"}
    assert cv2.imread(str(picture)).shape[1] > 800


def test_every_backend_reads_the_same_table(written) -> None:
    rows = [row for row in written[0]["rows"] if row["form"] == RUNTIME]
    for row in rows:
        if row["precision"] == "float32":
            (eager,) = (
                r
                for r in rows
                if (r["backend"], r["precision"], r["nodes"]) == ("eager", "float32", row["nodes"])
            )
            for region, error in row["errors"].items():
                assert error["rms"] == pytest.approx(eager["errors"][region]["rms"], rel=1e-3)


def test_a_row_for_each_size(written) -> None:
    sizes = [
        row["nodes"]
        for row in written[0]["rows"]
        if (row["form"], row["backend"], row["precision"]) == (RUNTIME, "eager", "float32")
    ]
    assert len(sizes) == len(NODE_COUNTS)
    assert all(0.7 * most <= n <= most for n, most in zip(sizes, NODE_COUNTS, strict=True))


def test_errors_fall_with_the_nodes(shell) -> None:
    """Against the fit form itself as the truth."""
    model = rt.fit(shell[0]).model
    inside = by_region(shell[1], model)["inside"]
    xyz = fit_form_factors(model, inside) @ np.linalg.inv(xyz_to_rgb_matrix()).T
    angles = (inside.incidence_deg, inside.receiving_deg, inside.tilt_deg)
    truth = BrdfMeasurement(*angles, xyz)
    assert shader_score(by_fit_form(model), truth, torch.float64).rms < 1e-5
    found = [
        shader_score(without_gradients(with_nodes(model, n)), truth, torch.float64)
        for n in (20_000, 75_000, 600_000)
    ]
    for coarse, fine in pairwise(found):
        assert fine.rms < 0.8 * coarse.rms
        assert fine.log_error < 0.8 * coarse.log_error


def test_the_default_row_is_the_score_of_the_model(shell, written) -> None:
    model = rt.fit(shell[0]).model
    (row,) = (
        row
        for row in written[0]["rows"]
        if row["default"] and (row["backend"], row["precision"]) == ("eager", "float64")
    )
    assert set(row["errors"]) == {"inside", "outside", "hemisphere"}
    for region, readings in by_region(shell[1], model).items():
        expected = score(model, readings)
        assert row["errors"][region]["readings"] == expected.readings
        assert row["errors"][region]["rms"] == pytest.approx(expected.rms, rel=1e-6)
        assert row["errors"][region]["log_error"] == pytest.approx(expected.log_error, rel=1e-6)
    assert model.layout.nodes == row["nodes"]


def test_the_continuation_beats_the_papers_rule_outside(written) -> None:
    rows = written[0]["rows"]
    paper = next(row for row in rows if (row["form"], row["backend"]) == (PAPER, "eager"))
    default = next(row for row in rows if row["default"])
    for kind in ("rms", "log_error"):
        assert default["errors"]["outside"][kind] < 0.5 * paper["errors"]["outside"][kind]


def test_what_stands_beside_the_rows(written) -> None:
    about = written[0]
    assert (about["sample"], about["simulated"]) == ("yakogai", True)
    assert (about["frame"], about["runs"]) == ([18, 32], 1)
    assert [row["pixels"] for row in about["scaling"]] == [256, 1024]
    assert set(about["stability"]) == {*simd.LEVELS, "eager"}
    for regions in about["stability"].values():
        assert all(region["finite"] for region in regions.values())
        assert regions["inside the box"]["worst"] < 1e-5
