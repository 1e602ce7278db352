"""`raden scan --queue` on simulated rigs: scans fail, go on from their journals, are skipped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from raden_torch.capture.spectrometer import drivers
from raden_torch.capture.spectrometer.journal import read_journal
from raden_torch.measurement import BrdfMeasurement, native_csv

DEFAULTS = """
ask = false
[defaults]
plan = "cells.csv"
time_scale = 3000
white_readings = 2
"""
RIG = """
name = "a rig that is switched off"
[goniometer]
driver = "grbl"
port = "{port}"
homing = "manual"
[goniometer.axes.incidence]
letter = "A"
limits_deg = [-2, 75]
[goniometer.axes.receiving]
letter = "B"
limits_deg = [-75, 75]
[goniometer.axes.tilt]
letter = "C"
limits_deg = [-75, 75]
[goniometer.show]
sample = ["M9"]
white = "manual"
dark = ["M8"]
[colorimeter]
driver = "cs2000"
port = "{port} 2"
[white]
name = "tile"
reflectance_factor = 98.5
geometry_deg = [45, 0, 0]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With what the scans read: three cells, a grey specimen, a rig whose ports are not there."""
    cells = "incidence_deg,receiving_deg,tilt_deg\n30,10,0\n30,20,0\n40,20,5\n"
    (tmp_path / "cells.csv").write_text(cells)
    a, r, t = ([0, 0, 70, 70], [-70, 70, -70, 70], [0, 0, 0, 0])
    angles = [[x, y, z + d] for x, y, z in zip(a, r, t, strict=True) for d in (-70, 0, 70)]
    incidence, receiving, tilt = zip(*angles, strict=True)
    native_csv.write(
        BrdfMeasurement(incidence, receiving, tilt, [[50.0] * 3] * 12), tmp_path / "g.csv"
    )
    (tmp_path / "rig.toml").write_text(RIG.format(port=tmp_path / "no port"))
    return tmp_path


def queued(folder: Path, *scans: str) -> Path:
    path = folder / "queue.toml"
    path.write_text(DEFAULTS + "".join(f"[[scan]]\n{scan}\n" for scan in scans))
    return path


def outcomes(folder: Path) -> dict[str, dict]:
    found = json.loads((folder / "queue.report.json").read_text("utf-8"))["jobs"]
    return {job["name"]: job for job in found}


SIMULATED = 'simulate = true\nspecimen = "g.csv"\n'


@pytest.mark.slow
def test_a_failed_scan_keeps_its_journal_and_goes_on(raden, folder: Path) -> None:
    """The first rig is always busy. Expected: exit code 3 of that scan, its journal kept, the
    second scan done. Then, without the fault: the first goes on, the second is skipped."""
    busy = queued(
        folder,
        SIMULATED + 'output = "a.csv"\nfault = "busy=1"',
        SIMULATED + 'output = "b.csv"\nsample = "grey b"',
    )
    assert raden("scan", "--queue", busy).returncode == 2
    found = outcomes(folder)
    assert (found["a.csv"]["state"], found["a.csv"]["exit_code"]) == ("failed", 3)
    assert "see to the instrument, then resume" in found["a.csv"]["message"]
    assert found["b.csv"]["state"] == "done"
    assert "coverage: 3 of 3 cells" in found["b.csv"]["text"]
    assert read_journal(folder / "a.journal.jsonl").faults
    assert not (folder / "a.csv").exists()
    again = queued(folder, SIMULATED + 'output = "a.csv"', SIMULATED + 'output = "b.csv"')
    done = raden("scan", "--queue", again)
    assert done.returncode == 0, done.stderr
    assert {name: one["state"] for name, one in outcomes(folder).items()} == {
        "a.csv": "done",
        "b.csv": "skipped",
    }
    contents = read_journal(folder / "a.journal.jsonl")
    assert contents.finished
    assert len(contents.sessions) > 2
    assert "coverage: 3 of 3 cells" in (folder / "queue.report.txt").read_text("utf-8")


def test_scans_on_a_rig_that_is_gone_are_not_begun(
    raden, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real rig asks for the sample first; a second one on the rig that does not answer is not
    asked for. A scan with a rig of its own goes on."""
    asked: list[str] = []
    monkeypatch.setattr(drivers, "ask_at_terminal", asked.append)
    path = queued(
        folder,
        'config = "rig.toml"\noutput = "a.csv"\nsample = "yakogai 3"',
        'config = "rig.toml"\noutput = "b.csv"',
        SIMULATED + 'output = "c.csv"',
    )
    path.write_text(path.read_text().replace("time_scale = 3000\n", "").replace("ask = false", ""))
    assert raden("scan", "--queue", path).returncode == 2
    found = outcomes(folder)
    assert {name: one["state"] for name, one in found.items()} == {
        **{"a.csv": "failed", "b.csv": "not begun", "c.csv": "done"}
    }
    assert "rig.toml does not answer: " in found["b.csv"]["message"]
    assert "cannot be opened" in found["a.csv"]["message"]
    assert asked == ["rig.toml: mount 'yakogai 3'"]


@pytest.mark.parametrize(
    ("scans", "said"),
    [
        ((), "scan"),
        ((SIMULATED + 'output = "a.csv"\nstepp = 3',), "scan 1: --stepp: no such option"),
        ((SIMULATED + "output = 3",), "scan 1: output: expected the file to write, .csv, got 3"),
        ((SIMULATED + 'output = "a.csv"',) * 2, "scan 2: output: expected another file"),
        ((SIMULATED + 'output = "a.csv"\nresume = true',), "expected no resume"),
    ],
)
def test_a_wrong_queue_is_refused_before_anything_moves(
    raden, folder: Path, scans: tuple[str, ...], said: str
) -> None:
    done = raden("scan", "--queue", queued(folder, *scans))
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(folder.glob("*.journal.jsonl"))


def test_a_queue_goes_alone(raden, folder: Path) -> None:
    done = raden("scan", "--queue", queued(folder, SIMULATED + 'output = "a.csv"'), "--simulate")
    assert "--queue: expected alone" in done.stderr
