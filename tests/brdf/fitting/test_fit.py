"""`fit`: nodes are exact, off the grid it is no worse than the measurement's own interpolation."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

import raden_torch as rt
from raden_torch.brdf.fitting.diffuse_fit import DiffuseParameters
from raden_torch.brdf.fitting.score import fit_form_factors, score, score_of
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement

MATERIALS = ["pearl-paint", "color-changing-paint1", "spectralon_rgb"]


def test_grid_nodes_come_back(analytic) -> None:
    m = analytic()
    result = rt.fit(m, interpolation="trilinear")
    assert fit_form_factors(result.model, m) == pytest.approx(m.as_rgb().values, rel=2e-7)
    assert result.report.measured == result.report.cells == 12615
    assert result.report.reading_rms < 1e-7


@pytest.mark.parametrize("name", MATERIALS)
def test_nodes_come_back_through_float32_vectors(shared: Path, name: str) -> None:
    """Through vectors, r = −a excluded: 1e-4 of the largest neighbour, since an angle's last
    float32 digit moves a reading beside a peak by that peak's slope."""
    m = rt.load_measurement(shared / f"data/measured_brdf/{name}.csv")
    m = m.select(m.receiving_deg != -m.incidence_deg)
    model = rt.fit(m, interpolation="trilinear").model
    angles = [
        torch.from_numpy(np.deg2rad(column))[None, :, None]
        for column in (m.incidence_deg, m.receiving_deg, m.tilt_deg)
    ]
    vectors = [v[None].float() for v in rt.vectors_from_angles(*angles)]
    with torch.no_grad():
        read = model.fit_form(*(angle.float() for angle in rt.raden_angles(*vectors)))
    found = read[0, :, :, 0].T.numpy() * 100 * np.pi
    truth = m.as_rgb().values
    grid = m.as_rgb().grid()
    from scipy.ndimage import maximum_filter

    around = maximum_filter(np.nan_to_num(abs(grid.values)), size=(3, 3, 3, 1))
    index = [
        np.searchsorted(axis, angle - 1e-6)
        for axis, angle in zip(
            grid.axes_deg, (m.incidence_deg, m.receiving_deg, m.tilt_deg), strict=True
        )
    ]
    error = abs(found - truth) / np.maximum(around[tuple(index)], 1e-3)
    assert error.max() < 1e-4
    if name == "pearl-paint":
        assert (abs(found - truth) / truth).max() < 1e-4


@pytest.mark.parametrize("name", MATERIALS)
def test_off_the_grid_no_worse_than_interpolating_the_total(shared: Path, name: str) -> None:
    folder = shared / "data/measured_brdf"
    m = rt.load_measurement(folder / f"{name}.csv")
    off = rt.load_measurement(folder / f"{name}.offgrid.csv")
    model = rt.fit(m, interpolation="trilinear").model
    found = score_of(fit_form_factors(model, off), off)
    grid = m.grid()
    points = np.stack([off.incidence_deg, off.receiving_deg, off.tilt_deg], axis=1)
    total = RegularGridInterpolator(grid.axes_deg, grid.values[..., 1])(points)
    truth = off.values[:, 1]
    rms = np.sqrt(np.mean((total - truth) ** 2)) / np.quantile(truth, 0.999)
    logs = np.mean(abs(np.log1p(total) - np.log1p(truth)))
    assert found.rms <= rms * (1 + 1e-4)
    assert found.log_error <= logs * (1 + 1e-4)


def test_spectralon_stays_matt(shared: Path) -> None:
    """Within 12 % of a Lambertian albedo of 0.94, light and view within 60° of the normal."""
    m = rt.load_measurement(shared / "data/measured_brdf/spectralon_rgb.csv")
    model = rt.fit(m).model
    generator = torch.Generator().manual_seed(0)
    v = torch.nn.functional.normalize(torch.randn(3, 1, 3, 20_000, 1, generator=generator), dim=2)
    normal, light, view = v
    dot = lambda x, y: (x * y).sum(1)  # noqa: E731
    near = (dot(normal, light) > 0.5) & (dot(normal, view) > 0.5) & (dot(light, view) > 0.5)
    with torch.no_grad():
        albedo = math.pi * model(normal, light, view).movedim(1, -1)[near]
    assert len(albedo) > 500
    assert ((albedo / 0.94 - 1).abs() < 0.12).all()


def test_hand_set_diffuse_parameters_are_kept(analytic) -> None:
    by_hand = DiffuseParameters((0.1, 0.2, 0.3), (0.02, 1.0, 30.0))
    result = rt.fit(analytic(), diffuse=by_hand, interpolation="trilinear")
    assert result.model.diffuse.scale.tolist() == pytest.approx(by_hand.scale)
    assert result.report.diffuse_exponent == by_hand.exponent
    assert not any("bound" in w for w in result.report.warnings)
    result.model.specular_gain = 0.0
    direction = torch.tensor([0.3, 0.0, 1.0]).view(1, 3, 1, 1).requires_grad_()
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    result.model(up, direction, up).sum().backward()
    assert torch.isfinite(direction.grad).all()


def test_report_says_what_happened(analytic) -> None:
    m = analytic()
    values = m.values.copy()
    values[5, 0] = -0.5
    hidden = (m.incidence_deg == 30) & (m.receiving_deg == -35)
    report = rt.fit(replace(m, values=values, valid=~hidden), interpolation="trilinear").report
    text = str(report)
    assert report.from_neighbours == 29
    assert "29 from measured neighbours" in text
    assert any("29 of 12615 readings are not valid" in w for w in report.warnings)
    assert any("1 readings have a negative value" in w for w in report.warnings)
    assert any("stopped at a bound" in w for w in report.warnings)
    assert report.reciprocity_mean < 0.01


def test_reciprocity_of_an_analytic_specimen_holds(analytic) -> None:
    report = rt.fit(analytic(), interpolation="trilinear").report
    assert report.reciprocity_worst < 1e-12


@pytest.mark.parametrize(
    ("axis", "words"), [("incidence", "20"), ("receiving", "0"), ("tilt", "0")]
)
def test_one_plane_only_is_refused(analytic, axis: str, words: str) -> None:
    m = analytic()
    plane = m.select(getattr(m, f"{axis}_deg") == float(words))
    with pytest.raises(InputError, match=rf"got one {axis} only \({words} deg\)"):
        rt.fit(plane, interpolation="trilinear")


def test_uneven_axes_get_their_common_step(analytic) -> None:
    m = analytic()
    kept = np.isin(m.incidence_deg, [0, 10, 30, 40, 70])
    result = rt.fit(m.select(kept), interpolation="trilinear")
    assert result.model.table.step_deg == (10.0, 5.0, 5.0)
    assert result.report.from_neighbours + result.report.from_equivalent == 3 * 29 * 29
    assert score(result.model, m).rms < 0.02
    odd = m.select(np.isin(m.incidence_deg, [0, 10]))
    shifted = replace(odd, incidence_deg=np.where(odd.incidence_deg == 10, 10.0123, 0.0))
    assert rt.fit(shifted, interpolation="trilinear").model.table.step_deg[0] == pytest.approx(
        10.0123
    )
    third = m.select(np.isin(m.incidence_deg, [0, 10, 20]))
    uneven = replace(
        third, incidence_deg=np.where(third.incidence_deg == 10, 10.123, third.incidence_deg)
    )
    result = rt.fit(uneven, interpolation="trilinear")
    assert result.report.scattered
    assert score(result.model, m.select(m.incidence_deg <= 20)).rms < 0.02


@pytest.mark.parametrize("name", ["pearl-paint", "spectralon_rgb"])
def test_scattered_readings_are_regularised(shared: Path, name: str) -> None:
    """Fitted to 10,000 scattered readings, scored on 10,000 others and on the grid's nodes."""
    folder = shared / "data/measured_brdf"
    scattered = rt.load_measurement(folder / f"{name}.offgrid.csv")
    half = np.arange(len(scattered)) < 10_000
    result = rt.fit(scattered.select(half), interpolation="trilinear")
    assert result.report.scattered
    assert result.report.cells == 12615
    assert result.report.measured > 6000
    assert any("10000 scattered readings" in w for w in result.report.warnings)
    assert score(result.model, scattered.select(~half)).rms < 0.02
    assert score(result.model, rt.load_measurement(folder / f"{name}.csv")).rms < 0.03


def test_scattered_readings_cover_what_they_cover(analytic) -> None:
    """Two patches: nodes near them are measured or continued, the rest is the diffuse part."""
    m = analytic()
    generator = np.random.default_rng(0)
    u = generator.random((3, 600))
    a, r, t = 10 + 20 * u[0], 30 + 30 * u[1], 20 * u[2]
    from scipy.interpolate import RegularGridInterpolator

    grid = m.grid()
    values = RegularGridInterpolator(grid.axes_deg, grid.values)(np.stack([a, r, t], axis=1))
    far = BrdfMeasurement([0, 70], [-70, -70], [-70, -70], np.full((2, 3), 20.0))
    both = BrdfMeasurement(
        np.append(a, far.incidence_deg),
        np.append(r, far.receiving_deg),
        np.append(t, far.tilt_deg),
        np.concatenate([values, far.values]),
        azimuth_deg=np.append(np.zeros(600), [0, 90]),
    )
    report = rt.fit(both, interpolation="trilinear").report
    assert report.measured + report.from_neighbours + report.from_diffuse == report.cells
    assert 100 < report.measured < 250
    assert report.from_diffuse > report.cells // 2
    assert report.reading_rms < 0.01
    assert any("all 2 of them as one" in w for w in report.warnings)


def test_bands_without_a_colour_make_a_grey_model(analytic) -> None:
    m = analytic()
    grey = replace(m, values=m.values[:, 1:2], channels=("650nm",))
    result = rt.fit(grey, interpolation="trilinear")
    assert any("the model is grey" in w for w in result.report.warnings)
    factors = fit_form_factors(result.model, m)
    assert factors == pytest.approx(np.repeat(m.values[:, 1:2], 3, axis=1), rel=1e-6)


def test_a_real_goniometers_readings(shared: Path) -> None:
    """RT-300S: four incidences, one band, 19 azimuths of the sample."""
    name = "ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115.xls"
    m = rt.load_measurement(shared / "data/goniometer_rt300s" / name)
    report = rt.fit(m, interpolation="trilinear").report
    assert report.scattered
    assert 1490 < report.measured < 1700  # receiving goes on to 80 here
    assert report.from_diffuse > 0
    assert any("grey" in w for w in report.warnings)
    assert any("azimuth" in w for w in report.warnings)
    assert report.reading_rms < 0.1


def test_model_is_deterministic_and_its_provenance_is_kept(analytic) -> None:
    m: BrdfMeasurement = analytic()
    one, two = (
        rt.fit(m, interpolation="trilinear").model,
        rt.fit(m, interpolation="trilinear").model,
    )
    assert torch.equal(one.table.values, two.table.values)
    assert one.provenance.simulated
    assert one.provenance.measurement_sha256 == m.sha256
