"""The benchmark's plot: a mark where each row's time and error are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from raden_torch.bench.bench_row import Row
from raden_torch.bench.time_error_plot import save_plot
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.reflectance.interpolation import SCHEMES


def test_marks_are_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    write = Figure.savefig

    def savefig(self: Figure, *arguments: Any, **options: Any) -> None:
        drawn.append(self)
        write(self, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    first, second = list(SCHEMES)[:2]
    rows = [
        Row(scheme, backend, precision, floor, 0.1, error, error / 10, 1000)
        for scheme, backend, precision, floor, error in (
            (first, "eager", "float32", 30.0, 0.02),
            (first, "eager", "float16", 40.0, 0.03),
            (second, "naive", "float32", 90.0, 0.01),
        )
    ]
    m = BrdfMeasurement(
        [0.0], [0.0], [0.0], [[50.0] * 3], metadata=Metadata("shell", simulated=True)
    )
    save_plot(rows, second, m, tmp_path / "plot.png")
    (figure,) = drawn
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
    rms, log_error = figure.axes
    for ax, scale in ((rms, 1.0), (log_error, 0.1)):
        at = np.concatenate([points.get_offsets() for points in ax.collections])
        np.testing.assert_allclose(at, [[30, 0.02 * scale], [40, 0.03 * scale], [90, 0.01 * scale]])
        assert ax.get_xlabel() == "run time / copy of the same bytes"
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert rms.get_ylabel() == "RMS / 99.9 % quantile of Y"
    assert log_error.get_ylabel() == "mean |Δ log(1+Y)|"
    plain, half, chosen = rms.collections
    assert len(half.get_facecolors()) == 0  # hollow: not float32
    np.testing.assert_array_equal(plain.get_facecolors(), plain.get_edgecolors())
    assert chosen.get_sizes()[0] > plain.get_sizes()[0]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [*SCHEMES, "eager", "naive", "not float32"]
    assert figure.get_suptitle() == f"simulated specimen: shell; default: {second}"
