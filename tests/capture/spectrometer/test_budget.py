"""The stated standard deviation against what scans scatter by, and what a scan says of itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.spectrometer.journal import JournalContents, JournalFile, read_journal
from raden_torch.capture.spectrometer.lab_report import make_report
from raden_torch.capture.spectrometer.ports import Position
from raden_torch.capture.spectrometer.reduction import ReducedScan, reduce_readings
from raden_torch.capture.spectrometer.scan import run_scan
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import make_plan
from raden_torch.capture.spectrometer.simulation.in_process import scan_in_process
from raden_torch.capture.spectrometer.simulation.simulated_radiance import Scene, make_scene
from raden_torch.capture.spectrometer.simulation.simulated_rig import Conditions, simulated_rig
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.capture.spectrometer.white_reference import White
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.compare import compare
from raden_torch.optics import simulate_specimen
from raden_torch.reflectance.regions import regions

BOX = {"incidence": (20.0, 60.0), "receiving": (-60.0, 60.0), "tilt": (0.0, 15.0)}
"""Ridge, body, grazing and retro, with the neighbours that slopes need: 900 cells."""


@pytest.fixture(scope="module")
def shell() -> tuple[Scene, BrdfMeasurement]:
    """The simulated shell at 1° around the box, as a scene, and its true values in the cells."""
    axes = [np.arange(low - 2, high + 2.1) for low, high in BOX.values()]
    fine = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    scene = make_scene(simulate_specimen("yakogai", geometries_deg=fine), 1000.0)
    return scene, simulate_specimen("yakogai", geometries_deg=grid(step_deg=5, **BOX))


def scans(scene: Scene, conditions: Conditions, runs: int, **options: object) -> list[ReducedScan]:
    plan = make_plan(grid(step_deg=5, **BOX), "box")
    return [
        reduce_readings(scan_in_process(scene, plan, conditions=conditions, seed=seed, **options))
        for seed in range(runs)
    ]


@pytest.mark.slow
def test_the_stated_std_is_what_repeated_scans_scatter_by(shell) -> None:
    """Rationale: 50 scans of one shell with other noise, drift, zeros and moves.

    Expected: by region, scatter / stated between 0.8 and 1.25 (median of the cells); the mean
    square of (measured − truth) / std about 1; within 2 std in 93 to 97 %.
    """
    scene, truth = shell
    conditions = Conditions(noise=0.002, zero_error_deg=0.05, position_error_deg=0.02)
    found = scans(scene, conditions, 50)
    values = np.array([one.measurement.values for one in found])
    std = np.array([one.measurement.std for one in found])
    ratio = values.std(axis=0, ddof=1) / np.sqrt((std**2).mean(axis=0))
    z = (values - truth.values) / std
    for name, mask in regions(truth.angles_deg).items():
        assert 0.8 < np.median(ratio[mask]) < 1.25, name
        assert np.mean(z[:, mask] ** 2) == pytest.approx(1, abs=0.25), name
    assert np.mean(z**2) == pytest.approx(1, abs=0.1)
    assert 0.93 < np.mean(abs(z) < 2) < 0.97
    # and two of these scans agree, although their zeros differ
    agreeing = [compare(a.measurement, b.measurement) for a, b in pairwise(found)]
    assert np.mean([c.agrees for c in agreeing]) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("conditions", "term", "region"),
    [
        ({"zero_error_deg": 0.2}, "zeros", "ridge"),
        ({"position_error_deg": 0.1}, "positioning", "ridge"),
        ({"noise": 0.005}, "repeatability", "body"),
    ],
)
def test_each_term_alone_is_as_large_as_its_error(
    shell, conditions: dict, term: str, region: str
) -> None:
    scene, truth = shell
    quiet = {"noise": 1e-5, "dark_noise_cd_m2": 0.0, "lamp_drift": 0.0}
    found = scans(scene, Conditions(**(quiet | conditions)), 20)
    mask = regions(truth.angles_deg)[region]
    values = np.array([one.measurement.values for one in found])[:, mask]
    stated = np.sqrt(np.mean([one.budget.terms()[term][mask] ** 2 for one in found], axis=0))
    assert np.median(values.std(axis=0, ddof=1) / stated) == pytest.approx(1, abs=0.25)


@pytest.mark.slow
def test_ptys_and_one_process_give_the_same_readings(tmp_path: Path) -> None:
    """Zeros that are off, and no noise: what is left is the four digits of the instrument."""
    from raden_torch.capture.spectrometer import scan_session

    path = tmp_path / "shell.csv"
    simulate_specimen("yakogai", step_deg=10).save(path)
    conditions = Conditions(noise=0.0, dark_noise_cd_m2=0.0, lamp_drift=0.0, zero_error_deg=0.3)
    plan = make_plan(grid(step_deg=20, incidence=(20, 40), receiving=(0, 40), tilt=(0, 20)), "few")
    references = scan_session.References(1e6, 2)
    with (
        simulated_rig(path, seed=3, time_scale=300, conditions=conditions) as simulated,
        scan_session.open_instruments(simulated.rig) as instruments,
        scan_session.open_journal(
            tmp_path / "j.jsonl",
            simulated.rig,
            instruments,
            plan,
            references=references,
            sample="shell",
            resume=False,
        ) as journal,
    ):
        run_scan(journal, instruments.goniometer, instruments.colorimeter)
        lines = reduce_readings(journal.contents).measurement
    scene = make_scene(simulate_specimen("yakogai", step_deg=10), 1000.0)
    contents = scan_in_process(scene, plan, conditions=conditions, seed=3, reference_readings=2)
    process = reduce_readings(contents).measurement
    np.testing.assert_allclose(lines.values, process.values, rtol=2e-4)
    np.testing.assert_allclose(lines.std, process.std, rtol=2e-3)
    assert lines.metadata.systematic == process.metadata.systematic
    straight = simulate_specimen("yakogai", geometries_deg=plan.cells).values
    assert abs(np.sort(lines.values, axis=0) / np.sort(straight, axis=0) - 1).max() > 0.01


@pytest.fixture
def scanned(
    tmp_path: Path, fake, goniometer, colorimeter, header
) -> Callable[..., JournalContents]:
    def run(plan, name: str = "scan.jsonl", **changed: object) -> JournalContents:
        with JournalFile.create(tmp_path / name, header(plan, **changed)) as journal:
            run_scan(journal, goniometer, colorimeter, clock=fake.clock)
        return read_journal(tmp_path / name)

    return run


def test_the_wavelengths_own_error_follows_the_samples_spectrum(scanned, fake) -> None:
    """A sample that rises linearly with the wavelength: its Y changes by the slope, per nm."""
    nm = np.linspace(380.0, 780.0, 401)
    lamp = np.ones(401)

    def spectrum(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        colour = 0.5 + 1e-3 * (nm - 580) if "sample" in fake.shown.value else np.ones(401)
        return nm, lamp * (signal[1] - 0.2) * colour + 0.2

    fake.spectrum = spectrum
    plan = make_plan(grid(step_deg=35), "coarse")
    stated = StatedUncertainty(wavelength_std_nm=0.3)
    reduced = reduce_readings(scanned(plan, stated=stated))
    y, term = reduced.measurement.values[:, 1], reduced.budget.colour[:, 1]
    middle = 0.5 + 1e-3 * (559.7 - 580)  # 559.7 nm: the mean wavelength of ȳ under D65
    np.testing.assert_allclose(term / y, 0.3 * 1e-3 / middle, rtol=0.01)
    assert (reduced.measurement.std >= reduced.budget.colour).all()


def test_a_tristimulus_instrument_states_its_own(scanned) -> None:
    plan = make_plan(grid(step_deg=35), "coarse")
    reduced = reduce_readings(scanned(plan, stated=StatedUncertainty(xyz_std=0.02)))
    np.testing.assert_allclose(reduced.budget.colour, 0.02 * reduced.measurement.values)


def test_what_is_common_stands_in_the_measurement(scanned) -> None:
    plan = make_plan(grid(step_deg=35), "coarse")
    white = White(Position(45.0, 0.0, 0.0), (94.0, 99.0, 107.8), "tile 7", relative_std=0.005)
    stated = StatedUncertainty((0.1, 0.2, 0.3), (0.01, 0.02, 0.03))
    reduced = reduce_readings(scanned(plan, white=white, stated=stated))
    common = reduced.measurement.metadata.systematic
    assert (common.scale_std, common.scale_reference) == (0.005, "tile 7")
    assert common.zero_std_deg == (0.1, 0.2, 0.3)
    assert common.white_deg == (45.0, 0.0, 0.0)
    np.testing.assert_allclose(reduced.budget.scale, 0.005 * reduced.measurement.values)
    unnamed = White(Position(45.0, 0.0, 0.0), (94.0, 99.0, 107.8), relative_std=0.005)
    common = reduce_readings(
        scanned(plan, "b.jsonl", white=unnamed)
    ).measurement.metadata.systematic
    assert (common.scale_std, common.scale_reference) == (0.005, "")


def test_where_the_white_stood_the_irradiance_s_zero_cancels(scanned) -> None:
    """At the white's own incidence the cosine of both errs alike; elsewhere by tan a_w − tan a."""
    plan = make_plan(grid(step_deg=15, incidence=(15, 75), tilt=(0, 0), receiving=(0, 0)), "line")
    reduced = reduce_readings(scanned(plan, stated=StatedUncertainty((0.1, 0.0, 0.0))))
    m = reduced.measurement
    from raden_torch.reflectance.slopes import slopes_per_deg

    slope = slopes_per_deg(m.angles_deg, m.values, m.valid)[:, :, 0]
    lit = np.radians(1.0) * (1.0 - np.tan(np.radians(m.incidence_deg)))[:, None] * m.values
    np.testing.assert_allclose(reduced.budget.zeros, 0.1 * abs(slope + lit), rtol=1e-9)
    assert abs(lit[m.incidence_deg == 45]).max() < 1e-12


def test_a_journal_of_old_states_nothing(tmp_path: Path, header) -> None:
    plan = make_plan(grid(step_deg=35), "coarse")
    path = tmp_path / "scan.jsonl"
    JournalFile.create(path, header(plan, stated=StatedUncertainty((1.0, 1.0, 1.0)))).close()
    assert read_journal(path).header.stated.zero_std_deg == (1.0, 1.0, 1.0)
    record = json.loads(path.read_text())
    del record["stated"]
    path.write_text(json.dumps(record) + "\n")
    assert read_journal(path).header.stated == StatedUncertainty()


@pytest.mark.parametrize(
    "wrong", [{"zero_std_deg": (-1.0, 0.0, 0.0)}, {"xyz_std": 1.5}, {"wavelength_std_nm": np.nan}]
)
def test_a_stated_uncertainty_out_of_range_is_refused(wrong: dict) -> None:
    with pytest.raises(InputError, match="stated uncertainty"):
        StatedUncertainty(**wrong)


def test_repeats_that_contradict_are_named_or_refused(scanned, fake) -> None:
    fake.noise = 0.001
    plan = make_plan(grid(step_deg=35), "coarse", repeats=3)
    real, limits = fake.called, {"from": 30, "to": 31}

    def jolt(call: str) -> None:
        real(call)
        if call == "measure":
            off = limits["from"] <= fake.measures < limits["to"] and fake.measures % 3 == 0
            fake.drift_per_s = 0.05 / fake.seconds if off else 0.0

    fake.called = jolt
    contents = scanned(plan, readings=6)
    reduced = reduce_readings(contents)
    [warning] = reduced.warnings
    assert "repeats of 1 of 75 cells" in warning
    assert warning in str(make_report(contents, reduced))
    fake.measures, limits["to"] = 0, 100
    with pytest.raises(InputError, match=r"repeats of \d+ of 75 cells .* the sample moves"):
        reduce_readings(scanned(plan, "again.jsonl", readings=6))


def test_a_white_that_jumps_is_told_or_refused(scanned, fake) -> None:
    plan = make_plan(grid(step_deg=35), "coarse")
    real, step = fake.called, {"by": 0.05}

    def jump(call: str) -> None:
        real(call)
        fake.drift_per_s = step["by"] / fake.seconds if fake.measures > 40 else 0.0

    fake.called = jump
    reduced = reduce_readings(scanned(plan, every_s=40.0))
    assert any("the white changed by +5 %" in warning for warning in reduced.warnings)
    fake.measures, step["by"] = 0, 0.5
    with pytest.raises(InputError, match="is not what it was"):
        reduce_readings(scanned(plan, "again.jsonl", every_s=40.0))
