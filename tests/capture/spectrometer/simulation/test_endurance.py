"""Every fault of the simulated rig, and a hundred kills: each ends in the undisturbed measurement.

Rationale: the scan runs against real serial lines (ptys) and is killed with SIGKILL at random
moments; without noise, two complete scans must agree to the last digit.
Expected: no reading lost, none twice, and no value changed.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from raden_torch.capture.spectrometer.simulation import Fault


@pytest.mark.slow
def test_nothing_is_lost() -> None:
    module = "raden_torch.capture.spectrometer.simulation.endurance"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", module, "--kills", "100", "--least", "3"],
        capture_output=True,
        text=True,
        timeout=1800,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in done.stdout.splitlines()]
    table = {row[0]: [float(cell) for cell in row[1:]] for row in rows[2:]}
    assert set(table) == {fault.value for fault in Fault} | {"kill -9"}
    for what, (tried, scans, readings, lost, twice, difference) in table.items():
        assert tried >= (100 if what == "kill -9" else 3), what
        assert readings == 60 * scans, what
        assert (lost, twice, difference) == (0, 0, 0), what
