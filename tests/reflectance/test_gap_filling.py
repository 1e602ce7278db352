"""Cells that were not measured, against what they would have been."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.gap_filling import fill


def hide(m: BrdfMeasurement, hidden: np.ndarray) -> BrdfMeasurement:
    return replace(m, valid=~hidden)


def filled_luminance(m: BrdfMeasurement, hidden: np.ndarray) -> np.ndarray:
    """Y of the filled cells, in the order of the readings."""
    grid = hide(m, hidden).grid()
    full = fill(grid.axes_deg, grid.values).values[..., 1]
    index = [
        np.searchsorted(axis, angle - 1e-6)
        for axis, angle in zip(
            grid.axes_deg, (m.incidence_deg, m.receiving_deg, m.tilt_deg), strict=True
        )
    ]
    return full[tuple(index)][hidden]


def test_the_lamp_side_of_an_analytic_specimen_is_filled(analytic) -> None:
    """The detector hides the lamp near r = −a; at a = 0 that is the highlight itself."""
    m = analytic()
    hidden = abs(m.incidence_deg + m.receiving_deg) < 7.6
    error = abs(filled_luminance(m, hidden) / m.values[hidden, 1] - 1)
    assert error.max() < 0.02
    at_zero = m.incidence_deg[hidden] == 0
    assert error[at_zero].mean() < 0.005


@pytest.mark.parametrize(
    ("name", "mean", "worst"),
    [
        ("pearl-paint", 0.002, 0.02),
        ("color-changing-paint1", 0.005, 0.2),
        ("spectralon_rgb", 0.02, 0.6),
    ],
)
def test_the_lamp_side_of_real_materials_is_filled(shared: Path, name, mean, worst) -> None:
    m = rt.load_measurement(shared / f"data/measured_brdf/{name}.csv")
    hidden = abs(m.incidence_deg + m.receiving_deg) < 7.6
    truth = m.values[hidden, 1]
    error = abs(filled_luminance(m, hidden) - truth) / np.maximum(truth, 1)
    assert error.mean() < mean
    assert error.max() < worst
    peak = truth.argmax() if name == "pearl-paint" else None
    if peak is not None:
        assert error[peak] < 0.005


def test_equivalents_at_perpendicular_incidence_come_first(analytic) -> None:
    m = analytic()
    # one of each pair (0, r, t) ≡ (0, −r, −t) is not measured
    hidden = (m.incidence_deg == 0) & (m.receiving_deg > 20)
    grid = hide(m, hidden).grid()
    filled = fill(grid.axes_deg, grid.values)
    assert filled.from_equivalent.sum() == hidden.sum()
    assert not filled.from_neighbours.any()
    assert filled_luminance(m, hidden) == pytest.approx(m.values[hidden, 1])


def test_what_has_no_measured_neighbour_is_left_to_the_diffuse_part(analytic) -> None:
    m = analytic()
    # between 20 and 60 degrees nothing was measured: three planes on each side have a neighbour
    hidden = (m.incidence_deg > 20) & (m.incidence_deg < 60) & (m.receiving_deg > 0)
    result = rt.fit(hide(m, hidden), interpolation="trilinear")
    assert result.report.from_equivalent == 0
    assert result.report.from_diffuse == 14 * 29 - 3 * 29  # the plane at 40, less 3 near r = 0
    model = result.model
    angles = [torch.full((1, 1, 1), np.deg2rad(x), dtype=torch.float64) for x in (40, 40, 10)]
    torch.testing.assert_close(model.fit_form(*angles), model.diffuse(*angles))
    assert any("no measured neighbour" in w for w in result.report.warnings)


def test_the_box_ends_where_the_readings_end(analytic) -> None:
    m = analytic()
    assert (
        rt.fit(m.select(m.incidence_deg < 38), interpolation="trilinear").report.cells
        == 8 * 29 * 29
    )


def test_asymmetry_at_perpendicular_incidence_is_averaged_and_reported(analytic) -> None:
    m = analytic()
    values = m.values.copy()
    lifted = (m.incidence_deg == 0) & (m.tilt_deg > 0)
    values[lifted] *= 1.5
    report = rt.fit(replace(m, values=values), interpolation="trilinear").report
    # at tilt 0 a cell and its equivalent are on the same side
    assert report.averaged == 28 * 29
    assert report.asymmetry == pytest.approx(0.4 * 28 / 29, rel=0.1)
    even = rt.fit(m, interpolation="trilinear").report
    assert even.asymmetry < 1e-12
    assert np.isnan(
        rt.fit(m.select(m.incidence_deg > 0), interpolation="trilinear").report.asymmetry
    )
