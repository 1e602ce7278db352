"""Tablets of simulated shells of known thickness, with noise; and what is not nacre."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.optics import specimens
from raden_torch.optics.nacre import Stack, mean_reflectance
from raden_torch.optics.nacre_table import SPREADS, nacre_table
from raden_torch.optics.tablet_fit import estimate_tablets

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("nacre table")]

RIDGE_DEG = [(a, a, t) for a in np.arange(0, 71, 5.0) for t in (-10, -5, 0, 5, 10)]


def a_shell(monkeypatch, tablet_nm, spread, organic_nm=25.0, *, spectral=False, seed=0, noise=0.02):
    """The readings of a simulated shell of one thickness, along the mirror ridge."""
    shell = replace(
        specimens.SPECIMENS["yakogai"],
        stack=Stack(tablet_nm, spread, organic_nm),
        steep_tablet_nm=tablet_nm,
        stacks=60,
        stack_seed=seed,
    )
    monkeypatch.setitem(specimens.SPECIMENS, "known", shell)
    return rt.simulate_specimen(
        "known", geometries_deg=RIDGE_DEG, noise=noise, seed=seed, spectral=spectral
    )


@pytest.mark.parametrize("spectral", [False, True])
@pytest.mark.parametrize(
    ("tablet_nm", "spread", "organic_nm"),
    [(300, 0.04, 25), (380, 0.07, 29), (500, 0.035, 21)],
)
def test_known_tablets_are_found_within_three_percent_and_the_interval(
    monkeypatch, tablet_nm, spread, organic_nm, spectral
):
    shell = a_shell(monkeypatch, tablet_nm, spread, organic_nm, spectral=spectral)
    found = estimate_tablets(shell)
    assert found.tablet_nm == pytest.approx(tablet_nm, rel=0.03)
    low, high = found.tablet_interval_nm
    assert low <= tablet_nm <= high
    assert high - low < 0.08 * tablet_nm
    assert found.period_nm == pytest.approx(tablet_nm + organic_nm, rel=0.01)
    assert found.spread == pytest.approx(spread, rel=0.25)
    assert found.simulated


def test_the_intervals_cover_the_truth(monkeypatch):
    """Rationale: at 95 % more than two misses of twelve have a chance of 2 %; a hundred repeats
    are in docs/accuracy.md, by benchmarks/tablets.py."""
    rng = np.random.default_rng(3)
    missed = 0
    for seed in range(6):
        tablet_nm, spread = rng.uniform(300, 520), rng.uniform(0.03, 0.08)
        organic_nm = rng.normal(25, 5)
        found = estimate_tablets(a_shell(monkeypatch, tablet_nm, spread, organic_nm, seed=seed))
        low, high = found.tablet_interval_nm
        missed += not low <= tablet_nm <= high
        low, high = found.spread_interval
        missed += not low <= spread <= high
    assert missed <= 2


def test_the_table_is_the_stacks_mean():
    table, q_squared = nacre_table(1.53), np.array([0.0, 0.25])
    wavelength = np.arange(420.0, 720.0, 5.0)
    for tablet_nm, spread in ((370.0, SPREADS[6]), (415.0, SPREADS[10])):
        direct = mean_reflectance(
            Stack(tablet_nm, spread), wavelength, q_squared, ambient_n=1.53, stacks=150, seed=4
        )
        index = int(abs(SPREADS - spread).argmin())
        found = table.reflectance(tablet_nm, wavelength, q_squared)[index]
        assert np.sqrt(np.mean((found - direct) ** 2)) < 0.045  # both are means of few stacks


def test_grey_is_no_nacre():
    a, r, t = np.array(RIDGE_DEG).T
    grey = BrdfMeasurement(
        a, r, t, 40 * np.array([[95.047, 100.0, 108.883]]) / 100 + 0 * a[:, None]
    )
    with pytest.raises(InputError, match="no interference is seen"):
        estimate_tablets(grey)


def test_too_few_readings_are_refused():
    shell = rt.simulate_specimen(geometries_deg=[(a, a, 0) for a in (0, 10, 20, 30)])
    with pytest.raises(InputError, match="at 5 incidences over 25° or more"):
        estimate_tablets(shell)
    with pytest.raises(InputError, match=r"coat_n: expected an index in 1…1\.7, got 2"):
        estimate_tablets(shell, coat_n=2)


@pytest.mark.parametrize("name", ["pearl-paint", "color-changing-paint1", "spectralon_rgb"])
def test_real_materials_that_are_not_nacre_are_refused(shared, name):
    measured = rt.load_measurement(shared / "data" / "measured_brdf" / f"{name}.csv")
    with pytest.raises(InputError, match="not nacre") as error:
        estimate_tablets(measured)
    assert "\n" not in str(error.value)


def test_the_command_says_it_in_text_and_json(raden, tmp_path):
    path = tmp_path / "shell.csv"
    rt.simulate_specimen("akoya", step_deg=10, noise=0.01).save(path)
    done = raden("analyse", path)
    assert done.returncode == 0, done.stderr
    assert "tablets 36" in done.stdout
    assert "(simulated)" in done.stdout
    found = json.loads(raden("analyse", path, "--json").stdout)
    assert found["tablet_nm"] == pytest.approx(368, rel=0.03)
    assert found["tablet_95_percent_nm"][0] < 368 < found["tablet_95_percent_nm"][1]


def test_the_command_takes_a_model(raden, tmp_path):
    shell = rt.simulate_specimen("akoya", step_deg=10)
    rt.save_model(rt.fit(shell, interpolation="trilinear").model, tmp_path / "shell.safetensors")
    done = raden("analyse", tmp_path / "shell.safetensors", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["tablet_nm"] == pytest.approx(368, rel=0.03)
