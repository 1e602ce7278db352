"""The diffuse formula fitted to the floor and to the surface of a measurement."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.fitting.diffuse_fit import FITS, angle_from_mirror, fit_diffuse
from raden_torch.brdf.fitting.score import fit_form_factors
from raden_torch.cli import run
from raden_torch.errors import InputError
from raden_torch.info.reflectance_info import describe_model
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB

SCALE, EXPONENT = (0.1, 0.2, 0.05), (0.7, 1.0, 2.0)
Angles = tuple[np.ndarray, np.ndarray, np.ndarray]


def grid_deg(step: float = 10.0) -> np.ndarray:
    """`[3, M]`: incidence, receiving and tilt to 70 degrees."""
    sides = np.arange(-70, 70.1, step)
    axes = np.meshgrid(np.arange(0, 70.1, step), sides, sides, indexing="ij")
    return np.stack([axis.ravel() for axis in axes])


def formula(angles: Angles, scale=SCALE, exponent=EXPONENT) -> np.ndarray:
    """Eqs (3)–(6): `[M, 3]` f_r in 1/sr."""
    a, r, t = angles
    x = 1 - np.cos(a)
    basis = np.stack([x**n for n in exponent], axis=1)
    return np.array(scale) * (np.cos(t) * np.cos(r))[:, None] * basis


def highlight(angles: Angles, width_deg: float = 5.0) -> np.ndarray:
    from_mirror = np.rad2deg(angle_from_mirror(*angles))
    return 3.0 * np.exp(-((from_mirror / width_deg) ** 2))[:, None]


def measured(f_r: np.ndarray, deg: np.ndarray, valid: np.ndarray | None = None) -> BrdfMeasurement:
    return BrdfMeasurement(*deg, FACTOR_PER_SR * f_r, channels=RGB, valid=valid)


@pytest.mark.parametrize("to", FITS)
def test_both_find_the_formula_under_a_highlight(to: str) -> None:
    angles = tuple(np.deg2rad(grid_deg()))
    found = fit_diffuse(angles, formula(angles) + highlight(angles), to)
    assert found.scale == pytest.approx(SCALE, rel=1e-3)
    assert found.exponent == pytest.approx(EXPONENT, rel=1e-3)


def test_of_noisy_readings_the_surface_is_the_middle_and_the_floor_lies_below() -> None:
    """Of factors 1 ± 0.2 (Gaussian) the median is 1, and the 5 % quantile 1 − 1.645 · 0.2."""
    generator = np.random.default_rng(0)
    angles = tuple(np.deg2rad(grid_deg(5.0)))
    noise = 1 + 0.2 * generator.standard_normal(len(angles[0]))[:, None]
    glints = (generator.random(len(angles[0])) < 0.02)[:, None]
    f_r = formula(angles) * noise + highlight(angles) + glints
    surface, floor = (fit_diffuse(angles, f_r, to) for to in ("surface", "floor"))
    assert surface.scale == pytest.approx(SCALE, rel=0.03)
    assert surface.exponent == pytest.approx(EXPONENT, rel=0.03)
    assert np.array(floor.scale) / SCALE == pytest.approx([1 - 0.2 * 1.645] * 3, abs=0.03)


@pytest.mark.parametrize("to", FITS)
def test_a_perfect_diffuser_is_fitted_as_well_as_the_formula_can(to: str) -> None:
    """No S and n within the bounds have less of the pinball loss, and n stops at its bound."""
    angles = tuple(np.deg2rad(grid_deg()))
    flat = np.full((len(angles[0]), 3), 1 / np.pi)
    found = fit_diffuse(angles, flat, to)
    q, (low, high) = FITS[to].quantile, FITS[to].exponent_bounds
    use = (angles[0] > 0) & (angle_from_mirror(*angles) > np.deg2rad(20))

    def loss(scale: float, n: float) -> float:
        above = (flat - formula(angles, (scale,) * 3, (n,) * 3))[use, 0]
        return float(np.mean(np.maximum(q * above, (q - 1) * above)))

    best = min(loss(s, n) for n in np.geomspace(low, high, 40) for s in np.geomspace(0.01, 10, 60))
    assert loss(found.scale[0], found.exponent[0]) <= best
    assert found.exponent == pytest.approx((low,) * 3, rel=1e-3)


@pytest.mark.parametrize("to", FITS)
def test_a_highlight_on_black_has_no_diffuse_part(to: str) -> None:
    deg = grid_deg()
    angles = tuple(np.deg2rad(deg))
    f_r = highlight(angles) * (highlight(angles) > 1e-3) * np.ones(3)
    result = rt.fit(measured(f_r, deg), diffuse=to, interpolation="trilinear")
    assert result.model.diffuse.scale.tolist() == [0, 0, 0]
    assert fit_form_factors(result.model, measured(f_r, deg)) == pytest.approx(
        FACTOR_PER_SR * f_r, rel=2e-7, abs=1e-9
    )


def test_a_black_surface_with_a_bright_rim_does_not_grow_without_bound() -> None:
    """Readings of 1 at 70° alone: to 90° the formula grows at most by (1 − cos 70°)⁻⁵."""
    angles = tuple(np.deg2rad(grid_deg()))
    rim = np.where(angles[0] > 1.2, 1.0, 1e-9)[:, None] * np.ones(3)
    found = fit_diffuse(angles, rim, "surface")
    most = (1 - np.cos(np.deg2rad(70))) ** -5 / (np.cos(np.deg2rad(70)) ** 2)
    assert max(found.exponent) <= 5
    assert max(found.scale) <= most


@pytest.mark.parametrize("to", FITS)
@pytest.mark.parametrize("outside", ["continued", "diffuse"])
def test_nodes_are_exact_and_the_fit_ignores_missing_cells(to: str, outside: str) -> None:
    deg = grid_deg()
    angles = tuple(np.deg2rad(deg))
    f_r = formula(angles) + highlight(angles)
    known = np.random.default_rng(0).random(len(f_r)) > 0.3
    m = measured(np.where(known[:, None], f_r, np.nan), deg, known)
    result = rt.fit(m, diffuse=to, outside=outside, interpolation="trilinear")
    assert result.report.diffuse_scale == pytest.approx(SCALE, rel=2e-3)
    at_zero = deg[0] == 0  # averaged over equivalents
    found = fit_form_factors(result.model, m)[known & ~at_zero]
    assert found == pytest.approx(FACTOR_PER_SR * f_r[known & ~at_zero], rel=2e-6)


def test_outside_the_box_stands_what_was_fitted() -> None:
    """The paper's rule: off the table by more than a step, eq. (6) with the fitted S and n."""
    deg = grid_deg()
    angles = tuple(np.deg2rad(deg))
    m = measured(formula(angles) + highlight(angles), deg)
    model = rt.fit(m, diffuse="surface", outside="diffuse", interpolation="trilinear").model
    beyond = np.array([[81.0, 85.0, 30.0], [-60.0, 88.0, 10.0], [20.0, 0.0, 82.0]])
    truth = FACTOR_PER_SR * formula(tuple(np.deg2rad(beyond)))
    assert fit_form_factors(model, measured(truth, beyond)) == pytest.approx(truth, rel=1e-2)


def test_a_surface_above_the_table_leaves_a_negative_remainder(
    dtype: torch.dtype, tolerance: float
) -> None:
    """Eq. (2) is linear in I_d and I_s, also where specular = table − diffuse is below 0."""
    deg = grid_deg()
    generator = np.random.default_rng(0)
    angles = tuple(np.deg2rad(deg))
    f_r = formula(angles) * (1 + 0.3 * generator.standard_normal((len(deg[0]), 1)))
    f_r = np.maximum(f_r + highlight(angles), 0)
    m = measured(f_r, deg)
    model = rt.fit(m, diffuse="surface", interpolation="trilinear", outside="diffuse").model.to(
        dtype
    )
    vectors = torch.from_numpy(generator.standard_normal((3, 1, 3, 40, 50))).to(dtype)
    vectors[:, :, 2].abs_()

    def at(diffuse_gain: float, specular_gain: float) -> torch.Tensor:
        model.diffuse_gain, model.specular_gain = diffuse_gain, specular_gain
        with torch.no_grad():
            f = model(*vectors)
        assert (f.abs().amax((0, 2, 3)) <= model.upper_bound() * (1 + 1e-5)).all()
        return f

    both, body, rest = at(1, 1), at(1, 0), at(0, 1)
    assert both.min() >= 0
    assert rest.min() < -1e-3
    level = float(both.max())
    assert both.dtype is dtype
    assert (body + rest - both).abs().max() < 3 * tolerance * level
    assert (2 * body + 0.5 * rest - at(2, 0.5)).abs().max() < 3 * tolerance * level


def test_report_model_and_info_say_which(tmp_path: Path, monkeypatch, capsys) -> None:
    deg = grid_deg()
    angles = tuple(np.deg2rad(deg))
    measured(formula(angles) + highlight(angles), deg).save(tmp_path / "m.csv")
    monkeypatch.chdir(tmp_path)
    for words, fitted_to in (
        (["--diffuse", "surface"], "the surface of the readings"),
        ([], "the floor of the readings"),
        (["--diffuse-scale", "0.1,0.1,0.1", "--diffuse-exponent", "1,1,1"], "set by hand"),
    ):
        run(["fit", "m.csv", "-o", "m.safetensors", *words])
        assert fitted_to in capsys.readouterr().out
        model = rt.load_model("m.safetensors")
        assert fitted_to in describe_model(model)
        assert json.loads(json.dumps(model.provenance.fit))["diffuse_fit"] in (*FITS, "by hand")
    model.provenance = replace(model.provenance, fit={})
    assert fitted_to not in describe_model(model)
    with pytest.raises(InputError, match="--diffuse surface fits what --diffuse-scale sets"):
        run(["fit", "m.csv", "-o", "n.safetensors", "--diffuse", "surface", *words])


@pytest.mark.parametrize("wrong", ["median", 0.5, ["floor"]])
def test_another_name_is_refused(wrong: object) -> None:
    deg = grid_deg()
    with pytest.raises(
        InputError, match=r"^diffuse: expected (floor or surface|str or DiffuseParameters), got"
    ):
        rt.fit(measured(np.ones((len(deg[0]), 3)), deg), diffuse=wrong)


@pytest.mark.parametrize(
    ("keep", "got"),
    [
        (lambda a, r, t: a < 15, r"got \d+ at 1"),
        (lambda a, r, t: (abs(r - a) < 15) & (abs(t) < 10) & (r > 0), "got 0 at 0"),
    ],
)
def test_too_few_readings_off_the_highlight_are_said(keep, got: str) -> None:
    deg = grid_deg()[:, keep(*grid_deg())]
    angles = tuple(np.deg2rad(deg))
    f_r = formula(angles) + highlight(angles)
    with pytest.raises(InputError, match=rf"^diffuse: expected at least 10 .* {got}; [^\n]*$"):
        fit_diffuse(angles, f_r, "surface")
    fit_diffuse(angles, f_r, "floor")  # has one to give
