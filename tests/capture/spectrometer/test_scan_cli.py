"""`raden scan` as a laboratory calls it: a process, on a simulated rig, interrupted, resumed."""

from __future__ import annotations

import contextlib
import io
import os
import pty
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.capture.spectrometer.journal import read_journal
from raden_torch.capture.spectrometer.simulation import (
    Conditions,
    SimulatedRig,
    simulated_rig,
)
from raden_torch.cli import main

COMMAND = [sys.executable, "-W", "error", "-m", "raden_torch.cli"]
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}


def raden(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command as a shell runs it, but in this process: nothing is imported again."""
    out, err = io.StringIO(), io.StringIO()
    words = ["raden", *map(str, arguments)]
    with (
        mock.patch.object(sys, "argv", words),
        mock.patch.object(warnings, "showwarning"),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    code = int(ended.value.code or 0)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def refusal(done: subprocess.CompletedProcess[str]) -> str:
    """The one line of a refused command."""
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    return done.stderr


@pytest.fixture(scope="module")
def specimen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("specimen") / "shell.csv"
    rt.simulate_specimen("yakogai", step_deg=35.0).save(path)
    return path


@pytest.fixture(scope="module")
def rig(specimen: Path) -> Iterator[SimulatedRig]:
    steady = Conditions(noise=0.0, dark_noise_cd_m2=0.0, lamp_drift=0.0)
    with simulated_rig(specimen, time_scale=1000.0, conditions=steady) as simulated:
        yield simulated


@pytest.mark.slow
def test_from_the_rig_to_the_sphere(specimen: Path, tmp_path: Path) -> None:
    """Rationale: what is scanned is what is fitted and lit.

    Expected: (value − specimen) / std has mean square 1, within what its correlated terms allow;
    the fitted table is the specimen, within 5 standard deviations.
    """
    shell, model = tmp_path / "shell.csv", tmp_path / "shell.safetensors"
    done = raden("scan", "--simulate", "--specimen", specimen, "--step", 35, "-o", shell)
    assert done.returncode == 0, done.stderr
    assert "lost 0" in done.stdout
    m, truth = rt.load_measurement(shell), rt.load_measurement(specimen)
    assert m.metadata.simulated
    assert dict(m.metadata.other)["scan"].endswith("grid of 35 deg (simulated)")
    np.testing.assert_array_equal(m.receiving_deg, truth.receiving_deg)
    assert m.valid.sum() == 75 - 15
    z = ((m.values - truth.values) / m.std)[m.valid]
    assert 0.4 < np.mean(z**2) < 2.0
    paper = "--interpolation", "trilinear", "--outside", "diffuse"
    done = raden("fit", shell, "-o", model, *paper)
    assert done.returncode == 0, done.stderr
    table = rt.load_model(model).table
    assert table is not None
    rgb, true_rgb = m.as_rgb(), truth.as_rgb()
    assert rgb.std is not None
    apart = 100 * np.pi * table.values.detach().numpy().reshape(-1, 3) - true_rgb.values
    assert (abs(apart) < 5 * rgb.std)[m.valid].all()
    done = raden("render", model, "--size", 64, "-o", tmp_path / "sphere.png")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "sphere.png").stat().st_size > 1000


LONG = ("--step", "35", "--repeats", "3")  # still running when the signal comes


def start_and_wait(rig: SimulatedRig, output: Path) -> subprocess.Popen[str]:
    """A scanning process that has taken a few readings."""
    process = subprocess.Popen(
        [*COMMAND, "scan", "--config", rig.config_path, "-o", output, *LONG],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
        # a background job of a shell ignores it, and so would the command
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    journal = output.with_name(f"{output.stem}.journal.jsonl")
    deadline = time.monotonic() + 300
    while not journal.exists() or len(read_journal(journal).taken) < 5:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return process


ADAPTIVE = ("--adaptive", "--step", "35", "--readings", "60")


@pytest.mark.slow
def test_an_adaptive_scan_killed_and_resumed(rig: SimulatedRig, tmp_path: Path) -> None:
    """Rationale: decisions are kept. Expected: killed after one, then resumed without its options,
    the scan reads the cells of the undisturbed one, and measures the same."""
    whole, killed = tmp_path / "whole.csv", tmp_path / "killed.csv"
    common = ("scan", "--config", rig.config_path)
    done = raden(*common, *ADAPTIVE, "-o", whole)
    assert done.returncode == 0, done.stderr
    assert "decisions: " in done.stdout
    process = subprocess.Popen(
        [*COMMAND, *common, *ADAPTIVE, "-o", killed],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=ENVIRONMENT,
    )
    journal = tmp_path / "killed.journal.jsonl"
    deadline = time.monotonic() + 300
    while not journal.exists() or not read_journal(journal).decisions:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.wait(300)
    done = raden(*common, "-o", killed, "--resume")
    assert done.returncode == 0, done.stderr
    assert rt.load_measurement(killed).values == pytest.approx(
        rt.load_measurement(whole).values, rel=1e-12, nan_ok=True
    )
    steps = [[t.step for t in read_journal(path).taken] for path in tmp_path.glob("*.jsonl")]
    assert steps[0] == steps[1]
    assert len(steps[0]) == 60


def test_an_adaptive_plan_forecast_and_refused(rig: SimulatedRig, tmp_path: Path) -> None:
    common = ("scan", "--config", rig.config_path)
    done = raden(*common, *ADAPTIVE, "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "at most" in done.stdout
    assert "60 readings" in done.stdout
    assert "--adaptive refines a grid" in refusal(
        raden(*common, "--adaptive", "--plan", "random", "-o", tmp_path / "x.csv")
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_signal_then_resume(rig: SimulatedRig, tmp_path: Path, name: str) -> None:
    output, number = tmp_path / "shell.csv", getattr(signal, name)
    process = start_and_wait(rig, output)
    process.send_signal(number)
    _, said = process.communicate(timeout=300)
    assert not output.exists()
    contents = read_journal(tmp_path / "shell.journal.jsonl")
    before = len(contents.taken)
    assert 5 <= before < 180
    if name == "SIGKILL":
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 128 + number
        assert f"{before} of 180 readings are in" in said
        assert "--resume" in said
        assert contents.sessions[-1].what == "interrupted"
        assert contents.torn_bytes == 0
    partial = tmp_path / "so_far.csv"
    done = raden("scan", "--from-journal", tmp_path / "shell.journal.jsonl", "-o", partial)
    assert done.returncode == 0, done.stderr
    assert f"{before} of 180: the scan is not finished" in done.stdout
    so_far = rt.load_measurement(partial)
    done = raden("scan", "--config", rig.config_path, "-o", output, "--resume")
    assert done.returncode == 0, done.stderr
    assert "sessions 2" in done.stdout
    m, truth = rt.load_measurement(output), rt.simulate_specimen("yakogai", step_deg=70.0)
    assert m.valid.sum() == 60
    assert so_far.valid.sum() == -(-before // 3)  # cells, of three readings each
    np.testing.assert_allclose(so_far.values[so_far.valid], m.values[so_far.valid], rtol=1e-6)
    corner = m.grid().values[::2, ::2, ::2]
    seen = ~np.isnan(corner)
    np.testing.assert_allclose(corner[seen], truth.grid().values[seen], rtol=2e-3)


def test_check_moves_nothing_without_yes(rig: SimulatedRig) -> None:
    done = raden("scan", "--config", rig.config_path, "--check")
    assert done.returncode == 0, done.stderr
    for part in ("grblHAL", "CS-2000", "nothing was moved"):
        assert part in done.stdout
    done = raden("scan", "--config", rig.config_path, "--check", "--yes")
    assert done.returncode == 0, done.stderr
    assert "white at incidence 45.00" in done.stdout


def test_dry_run_says_how_long_and_writes_nothing(rig: SimulatedRig, tmp_path: Path) -> None:
    output = tmp_path / "shell.csv"
    done = raden("scan", "--config", rig.config_path, "-o", output, "--dry-run")
    assert done.returncode == 0, done.stderr
    for part in ("12180 readings", "excluded: 435 cells", "travel: 60970 deg", "expected: 1"):
        assert part in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_list_is_a_plan(rig: SimulatedRig, tmp_path: Path) -> None:
    cells = tmp_path / "cells.csv"
    cells.write_text("incidence_deg,receiving_deg,tilt_deg\n10,20,0\n33.5,-1,7\n0,35,-35\n")
    output = tmp_path / "list.csv"
    done = raden("scan", "--config", rig.config_path, "-o", output, "--plan", cells, "--repeats", 2)
    assert done.returncode == 0, done.stderr
    m = rt.load_measurement(output)
    assert m.incidence_deg.tolist() == [0, 10, 33.5]
    assert m.count is not None
    assert m.count.tolist() == [2, 2, 2]
    truth = rt.simulate_specimen("yakogai", geometries_deg=[[0, 35, -35]])
    np.testing.assert_allclose(m.values[0], truth.values[0], rtol=2e-3)


def test_a_journal_is_not_overwritten_nor_mixed(rig: SimulatedRig, tmp_path: Path) -> None:
    common = ("scan", "--config", rig.config_path, "-o", tmp_path / "shell.csv")
    assert raden(*common, "--step", 70).returncode == 0
    assert "continue it with --resume" in refusal(raden(*common, "--step", 70))
    assert "is of another plan" in refusal(raden(*common, "--step", 35, "--resume"))
    assert "sample" in refusal(raden(*common, "--resume", "--sample", "another"))
    assert raden(*common, "--resume").returncode == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "give --config RIG.toml, --simulate, --queue FILE.toml, or --from-journal"),
        (
            ("--simulate", "--from-journal", "x.jsonl"),
            "give --config RIG.toml, --simulate, --queue",
        ),
        (("--from-journal", "x.jsonl", "--resume", "-o", "x.csv"), "goes with -o alone"),
        (("--simulate",), "name the measurement to write"),
        (("--simulate", "--check", "--resume"), "--resume: name the measurement"),
        (("--simulate", "-o", "x.csv", "--yes"), "--yes goes with --check"),
        (("--simulate", "-o", "no/x.csv"), "expected an existing folder, got "),
        (
            ("--config", "none.toml", "-o", "x.csv"),
            "none.toml: expected a rig file, got an error: No such file",
        ),
        (
            ("--simulate", "-o", "x.csv", "--white-every", "0"),
            "white interval: expected more than 0 min, got 0 min",
        ),
        (
            ("--simulate", "-o", "x.csv", "--white-readings", "1"),
            "white readings: expected 2…1000 (two at least",
        ),
        (("--simulate", "-o", "x.csv", "--resume", "--white-every", "5"), "are in the journal"),
        (
            ("--simulate", "-o", "x.csv", "--stands-at", "1,2"),
            "--stands-at: expected three numbers as 1,1,2, got 1,2",
        ),
        (("--simulate", "-o", "x.csv", "--fault", "rain=1"), "--fault: expected one of "),
    ],
)
def test_wrong_options(options: tuple, message: str) -> None:
    assert message in refusal(raden("scan", *options))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--step", "3"), "expected a whole number of steps of 3 deg, got "),
        (("--step", "0"), "step: expected more than 0 deg, got 0"),
        (
            ("--incidence", "0-70"),
            "--incidence: expected first and last in degrees, as 0:70, got 0-70",
        ),
        (("--plan", "random", "--step", "5"), "--step and limits of angles are for a grid"),
        (("--readings", "5"), "--readings goes with a random plan"),
        (("--plan", "none.csv"), "none.csv"),
        (("--repeats", "0"), "repeats: expected 1…100, got 0"),
        (("--resume",), "expected a journal to resume, got none"),
    ],
)
def test_wrong_plans_write_nothing(
    rig: SimulatedRig, tmp_path: Path, options: tuple, message: str
) -> None:
    common = ("scan", "--config", rig.config_path, "-o", tmp_path / "x.csv")
    assert message in refusal(raden(*common, *options))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("instrument", ["goniometer", "colorimeter"])
def test_a_port_that_is_not_there(rig: SimulatedRig, tmp_path: Path, instrument: str) -> None:
    text = rig.config_path.read_text()
    here = rig.config_path.parent / instrument
    config = tmp_path / "rig.toml"
    config.write_text(text.replace(f'"{here}"', f'"{tmp_path / "nothing"}"'))
    said = refusal(raden("scan", "--config", config, "-o", tmp_path / "x.csv"))
    assert "nothing" in said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.toml"]


def test_another_device_on_the_port(rig: SimulatedRig, tmp_path: Path) -> None:
    """The two ports are mistaken for each other."""
    a, b = (f'"{rig.config_path.parent / name}"' for name in ("goniometer", "colorimeter"))
    config = tmp_path / "rig.toml"
    config.write_text(rig.config_path.read_text().replace(a, "<").replace(b, a).replace("<", b))
    refusal(raden("scan", "--config", config, "-o", tmp_path / "x.csv"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.toml"]


def test_a_silent_port(rig: SimulatedRig, tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    try:
        here = rig.config_path.parent / "colorimeter"
        config = tmp_path / "rig.toml"
        config.write_text(
            rig.config_path.read_text().replace(f'"{here}"', f'"{os.ttyname(theirs)}"')
        )
        said = refusal(raden("scan", "--config", config, "-o", tmp_path / "x.csv"))
    finally:
        os.close(ours)
        os.close(theirs)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.toml"]
    assert "no" in said.lower()
