"""Readings → reflectance factors: against a sample that is known, and a budget that is kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.spectrometer.journal import JournalContents, JournalFile, read_journal
from raden_torch.capture.spectrometer.lab_report import make_report, with_report
from raden_torch.capture.spectrometer.ports import Position, Target
from raden_torch.capture.spectrometer.reciprocity import check_reciprocity
from raden_torch.capture.spectrometer.reduction import ReducedScan, reduce_readings
from raden_torch.capture.spectrometer.scan import run_scan
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import FixedPlan, make_plan
from raden_torch.capture.spectrometer.white_reference import White
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, native_csv


@pytest.fixture
def scanned(
    tmp_path: Path, fake, goniometer, colorimeter, header
) -> Callable[..., JournalContents]:
    def run(plan: FixedPlan, name: str = "scan.jsonl", **changed: object) -> JournalContents:
        with JournalFile.create(tmp_path / name, header(plan, **changed)) as journal:
            run_scan(journal, goniometer, colorimeter, clock=fake.clock)
        return read_journal(tmp_path / name)

    return run


@pytest.fixture
def plan() -> FixedPlan:
    return make_plan(grid(step_deg=35), "coarse")


def truth_of(measurement: BrdfMeasurement, true_factor: Callable) -> np.ndarray:
    m = measurement
    angles = zip(m.incidence_deg, m.receiving_deg, m.tilt_deg, strict=True)
    return np.array([true_factor(Position(*angle)) for angle in angles])


def test_the_sample_s_own_factor_comes_out(scanned, plan, true_factor) -> None:
    measurement = reduce_readings(scanned(plan)).measurement
    np.testing.assert_allclose(measurement.values, truth_of(measurement, true_factor), rtol=1e-12)
    assert measurement.metadata.simulated
    assert "fake goniometer" in measurement.metadata.instrument
    assert (measurement.count == 1).all()
    rows = np.stack([measurement.incidence_deg, measurement.receiving_deg, measurement.tilt_deg], 1)
    np.testing.assert_array_equal(rows, grid(step_deg=35))


def test_a_linear_drift_is_taken_out(scanned, plan, fake, true_factor) -> None:
    """What is left is that a reading's time is when it ended, seconds after the light fell in."""
    fake.drift_per_s = 1e-3
    reduced = reduce_readings(scanned(plan, every_s=50.0))
    truth = truth_of(reduced.measurement, true_factor)
    error = abs(reduced.measurement.values / truth - 1)
    assert np.ptp(reduced.white_level[:, 1]) > 0.2
    assert error.max() < 2e-3
    assert (error * truth <= 3 * reduced.budget.drift + 1e-3 * truth).all()


def test_repeats_give_the_standard_deviation_of_their_mean(scanned, fake, true_factor) -> None:
    fake.noise = 0.01
    plan = make_plan(grid(step_deg=35), "coarse", repeats=12)
    reduced = reduce_readings(scanned(plan, readings=10, every_s=1e9))
    m = reduced.measurement
    assert (m.count == 12).all()
    truth = truth_of(m, true_factor)
    expected = truth * 0.01 / np.sqrt(12)
    assert np.mean(reduced.budget.repeatability / expected) == pytest.approx(1, abs=0.1)
    assert reduced.repeat_std[1] == pytest.approx(0.01, rel=0.2)
    assert reduced.white_single_std == pytest.approx(0.01, rel=0.4)


def test_the_budget_covers_the_error(scanned, fake, true_factor) -> None:
    """Rationale: `std` is k = 1, so over many cells (error / std)² is about 1 on average.

    Expected: between 0.6 and 1.4 with one reading a cell; white noise is shared between cells.
    """
    fake.noise = 0.004
    plan = make_plan(grid(step_deg=17.5), "coarse")
    reduced = reduce_readings(scanned(plan, readings=12, every_s=150.0))
    m = reduced.measurement
    z = (m.values - truth_of(m, true_factor)) / m.std
    assert 0.6 < np.mean(z**2) < 1.4
    assert (reduced.budget.total <= m.std + 1e-15).all()
    assert reduced.budget.scale.max() == 0


def test_the_certificate_s_uncertainty_is_kept_apart(scanned, plan) -> None:
    white = White(Position(45.0, 0.0, 0.0), (94.0, 99.0, 107.8), relative_std=0.01)
    reduced = reduce_readings(scanned(plan, white=white))
    m = reduced.measurement
    np.testing.assert_allclose(reduced.budget.scale, 0.01 * m.values)
    assert m.std.max() < 1e-9 * m.values.max()


def test_white_in_every_cell_needs_no_cosine(scanned, fake, true_factor, monkeypatch) -> None:
    """A rig whose irradiance does not follow the cosine: only the white beside the cell knows."""
    plan = make_plan(grid(step_deg=35), "each", white_at_each=True)
    known = White(
        Position(45.0, 0.0, 0.0),
        (94.0, 99.0, 107.8),
        at_cells=tuple((94.0, 99.0, 107.8) for _ in plan.cells),
    )
    real = fake.called

    def crooked(call: str) -> None:  # the lamp sags where the arm is far out
        fake.drift_per_s = -0.4 * np.sin(np.radians(fake.where.incidence_deg)) / fake.seconds
        real(call)

    fake.seconds = 1000.0
    fake.called = crooked
    m = reduce_readings(scanned(plan, white=known)).measurement
    np.testing.assert_allclose(m.values, truth_of(m, true_factor), rtol=2e-2)
    fixed = make_plan(grid(step_deg=35), "fixed")
    m = reduce_readings(scanned(fixed, "fixed.jsonl")).measurement
    assert abs(m.values / truth_of(m, true_factor) - 1).max() > 0.1


def test_with_spectra_the_lamp_s_spectrum_does_not_matter(scanned, plan, fake) -> None:
    """A coloured sample under a lamp that is far from D65."""
    nm = np.linspace(380.0, 780.0, 401)
    lamp = np.exp(-(((nm - 600) / 90) ** 2)) + 0.02
    colour = 0.2 + 0.6 * (nm > 560)

    def spectrum(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dark = 0.2
        light = lamp * (signal[1] - dark) * (colour if fake.shown is Target.SAMPLE else 1.0)
        return nm, light / 1000 + dark

    fake.spectrum = spectrum
    reduced = reduce_readings(scanned(plan))
    assert reduced.spectral
    names = tuple(f"{x:g}nm" for x in nm)
    zero = np.zeros(1)
    tint = BrdfMeasurement(zero, zero, zero, 100 * colour[None], names).as_xyz().values[0]
    perfect = BrdfMeasurement(zero, zero, zero, 100 + 0 * nm[None], names).as_xyz().values[0]
    ratio = reduced.measurement.values / [94.0, 99.0, 107.8]
    ratio = ratio / ratio[:, 1:2] * tint[1] / perfect[1]
    np.testing.assert_allclose(ratio, np.broadcast_to(tint / perfect, ratio.shape), rtol=1e-9)


def test_excluded_cells_are_rows_without_a_value(scanned, tmp_path: Path) -> None:
    plan = make_plan(
        grid(step_deg=35),
        "coarse",
        reachable=lambda p: "hidden" if p.receiving_deg == -p.incidence_deg else None,
    )
    contents = scanned(plan)
    reduced = reduce_readings(contents)
    m = reduced.measurement
    assert len(m) == 75
    assert int(reduced.excluded.sum()) == int((~m.valid).sum()) == 15
    np.testing.assert_array_equal(m.incidence_deg[~m.valid], -m.receiving_deg[~m.valid])
    kept = with_report(m, make_report(contents, reduced))
    kept.save(tmp_path / "shell.csv")
    again = native_csv.read(tmp_path / "shell.csv")
    assert again == kept
    assert dict(again.metadata.other)["excluded"] == "hidden: 15"


def test_a_cell_with_one_reading_over_range_is_not_valid(scanned, fake) -> None:
    """One repeat of three, and that three times running: a glint that stays a while."""
    real = fake.called

    def glint(call: str) -> None:
        fake.over_above = 0.0 if 20 <= fake.measures < 23 else np.inf
        real(call)

    fake.called = glint
    reduced = reduce_readings(scanned(make_plan(grid(step_deg=35), "coarse", repeats=3)))
    assert reduced.over.sum() == 1
    np.testing.assert_array_equal(reduced.measurement.valid, reduced.over == 0)
    assert reduced.measurement.count[reduced.over == 1] == 2


def test_a_journal_without_references_is_refused(tmp_path: Path, header, plan: FixedPlan) -> None:
    with (
        JournalFile.create(tmp_path / "j.jsonl", header(plan)) as journal,
        pytest.raises(InputError, match="no dark or no white"),
    ):
        reduce_readings(journal.contents)


@pytest.mark.parametrize(
    ("xyz", "message"),
    [((0.0, 99.0, 100.0), "above 0"), ((94.0, np.nan, 100.0), "above 0"), ((9e9, 9.0, 9.0), "300")],
)
def test_a_white_of_zero_is_refused(xyz: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        White(Position(45.0, 0.0, 0.0), xyz)


def test_reciprocity_is_found_and_its_breach(scanned, plan, analytic) -> None:
    kept = check_reciprocity(analytic(step=10.0))
    assert kept.pairs > 700
    assert kept.mean < 1e-12
    assert kept.within_two_std == 1.0
    m = analytic(step=10.0)
    values = m.values * np.where(m.receiving_deg > m.incidence_deg, 1.1, 1.0)[:, None]
    broken = check_reciprocity(
        BrdfMeasurement(m.incidence_deg, m.receiving_deg, m.tilt_deg, values)
    )
    assert 0.02 < broken.mean < 0.1
    assert broken.within_two_std < 0.7
    assert kept.warning is None
    off = BrdfMeasurement(m.incidence_deg, m.receiving_deg, m.tilt_deg, values, std=0.01 * values)
    assert "worst at (" in str(check_reciprocity(off).warning)


def test_the_report_says_what_a_lab_keeps(scanned, fake, plan: FixedPlan) -> None:
    from raden_torch.capture.spectrometer.ports import InstrumentBusyError

    fake.noise, fake.drift_per_s = 0.001, 1e-5
    fake.fail("measure", [None] * 20 + [InstrumentBusyError("ER02")])
    contents = scanned(plan, every_s=100.0)
    reduced: ReducedScan = reduce_readings(contents)
    text = str(make_report(contents, reduced))
    for part in (
        "fake shell, coarse (simulated)",
        plan.hash,
        "coverage: 75 of 75 cells (100 %); over range 0, under range 0, excluded 0",
        "readings taken: 75, lost 0",
        "drift: lamp",
        "repeatability: white 0.1",
        "reciprocity: 3",
        "read at incidence 45, receiving 0, tilt 0",
        "travel: 2590 deg",
        "faults: busy 1",
    ):
        assert part in text, part
