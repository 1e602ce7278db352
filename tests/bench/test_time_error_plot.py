"""The benchmark's plot: a mark where each row's time and error are."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from raden_torch.bench.bench_row import Row
from raden_torch.bench.forms import FIT, NAIVE, PAPER, RUNTIME
from raden_torch.bench.time_error_plot import save_plot
from raden_torch.brdf.fitting.score import Score
from raden_torch.measurement import Metadata


def test_marks_are_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    write = Figure.savefig

    def savefig(self: Figure, *arguments: Any, **options: Any) -> None:
        drawn.append(self)
        write(self, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    rows = [
        row(PAPER, NAIVE, 400.0, 0.04),
        row(FIT, "eager", 200.0, 0.01),
        row(RUNTIME, "avx2", 4.0, 0.02, nodes=40_000),
        row(RUNTIME, "avx2", 3.0, 0.03, nodes=20_000),
        row(RUNTIME, "avx2", 5.0, 0.015, nodes=147_600, default=True),
        row(RUNTIME, "eager", 150.0, 0.015, nodes=147_600, default=True),
        row(RUNTIME, "eager", 250.0, 0.016, nodes=147_600, default=True, precision="float16"),
    ]
    save_plot(rows, Metadata("shell", simulated=True), tmp_path / "plot.png")
    (figure,) = drawn
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
    assert figure.get_suptitle() == "simulated specimen: shell"
    panels = dict(
        zip(product(("rms", "log_error"), ("inside", "outside")), figure.axes, strict=True)
    )
    for (kind, region), ax in panels.items():
        at = np.concatenate([points.get_offsets() for points in ax.collections])
        errors = [getattr(each.errors[region], kind) for each in rows]
        times = [each.times_floor for each in rows]
        np.testing.assert_allclose(at, np.transpose([times, errors]))
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    inside = panels["rms", "inside"]
    assert inside.get_ylabel() == "RMS / 99.9 % quantile of Y"
    assert panels["log_error", "inside"].get_ylabel() == "mean |Δ log(1+Y)|"
    assert inside.get_title() == "inside the measured box, 100 readings"
    assert panels["rms", "outside"].get_title() == "outside the measured box, 50 readings"
    # sizes are joined from few nodes to many, and the ends and the default are named
    joined = [line.get_xdata().tolist() for line in inside.lines]
    assert [3.0, 4.0, 5.0] in joined
    assert [text.get_text() for text in inside.texts] == ["20k", "148k"]
    assert [text.get_text() for text in panels["rms", "outside"].texts] == ["148k"]
    *_, fast, eager, half = inside.collections
    for mark in (fast, eager):
        assert mark.get_sizes()[0] > half.get_sizes()[0]
        assert mark.get_edgecolors()[0].tolist() == [0, 0, 0, 1]
    assert len(half.get_facecolors()) == 0  # hollow: not float32
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[:3] == ["naive", "eager", "avx2"]
    assert labels[-2:] == ["the default", "maps not float32"]


def test_a_panel_only_where_there_are_readings(tmp_path: Path) -> None:
    only = {"inside": Score(3, 0.1, 0.2), "hemisphere": Score(3, 0.1, 0.2)}
    rows = [
        Row(PAPER, 9, False, NAIVE, "float32", 9.0, 1.0, only),
        Row(RUNTIME, 9, True, "eager", "float32", 3.0, 0.3, only),
    ]
    save_plot(rows, Metadata("shell"), tmp_path / "one.png")
    one = cv2.imread(str(tmp_path / "one.png"))
    assert one.shape[1] == pytest.approx(120 * 7.6, abs=1)


def row(
    form: str,
    backend: str,
    floor: float,
    error: float,
    *,
    nodes: int = 12_615,
    default: bool = False,
    precision: str = "float32",
) -> Row:
    errors = {
        "inside": Score(100, error, error / 10),
        "outside": Score(50, 3 * error, error / 2),
        "hemisphere": Score(150, 2 * error, error / 3),
    }
    return Row(form, nodes, default, backend, precision, floor, floor / 400, errors)
