"""Does a scan lose anything, whatever happens to it? Simulated faults and real kills, counted.

    python -m raden_torch.capture.spectrometer.simulation.endurance --kills 100

scans a simulated rig (no noise, so that two runs can be compared to the last digit) once
undisturbed, once for each fault, and in a process that is killed with SIGKILL at random moments
and resumed. Each ends in a measurement that must be the undisturbed one. It prints the table.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.journal import JournalContents, read_journal
from raden_torch.capture.spectrometer.ports import Range
from raden_torch.capture.spectrometer.reduction import reduce_readings
from raden_torch.capture.spectrometer.rig_config import load_rig
from raden_torch.capture.spectrometer.scan import RetryPolicy, run_scan
from raden_torch.capture.spectrometer.scan_cells import grid
from raden_torch.capture.spectrometer.scan_plan import FixedPlan, make_plan
from raden_torch.capture.spectrometer.scan_session import References, open_instruments, open_journal
from raden_torch.capture.spectrometer.simulation.faults import Fault
from raden_torch.capture.spectrometer.simulation.simulated_rig import (
    Conditions,
    SimulatedRig,
    simulated_rig,
)
from raden_torch.optics import simulate_specimen

CHANCES = {
    Fault.LATE: 0.01,
    Fault.SPLIT: 0.2,
    Fault.GARBAGE: 0.01,
    Fault.BUSY: 0.15,
    Fault.OVER_RANGE: 0.15,
    Fault.ALARM: 0.1,
    Fault.RESET: 0.1,
    Fault.VANISH: 0.04,
}
"""How likely each fault is when it is tried by itself, at each opportunity for it."""

_TIME_SCALE = 2000.0
_STEADY = Conditions(noise=0.0, dark_noise_cd_m2=0.0, lamp_drift=0.0)
_REFERENCES = References(every_s=2.0, readings=2)
_RETRY_POLICY = RetryPolicy(attempts=20, first_wait_s=0.005)
_AT_ONCE = 4  # they wait for their instruments most of the time
_LONGEST_LIFE_S = 0.5  # of a process, before it is killed


@dataclass(frozen=True)
class Outcome:
    """What one trial came to.

    Attributes:
        what: the fault.
        tried: how many times it happened.
        scans: how many scans were completed under it.
        readings: planned in all of them; `lost` of these are not in the journals, `twice` are
            there more than once.
        largest_difference: of any value from the undisturbed scan's, relative.
    """

    what: str
    tried: int
    scans: int
    readings: int
    lost: int
    twice: int
    largest_difference: float


class Endurance:
    """Trials on one specimen and one small plan, in a folder of their own."""

    def __init__(self, folder: Path, *, seed: int = 0) -> None:
        self.folder = folder
        self.seed = seed
        self.specimen = folder / "specimen.csv"
        simulate_specimen("yakogai", step_deg=35.0).save(self.specimen)
        with self._rig({}) as rig:
            cells = grid(step_deg=35.0)
            self.plan = make_plan(cells, "endurance", reachable=rig.rig.reachable)
            journal = folder / "undisturbed.jsonl"
            scan_once(rig.config_path, self.plan, journal)
            self.undisturbed = _values(read_journal(journal))

    def fault(self, fault: Fault, *, least: int = 5, most_scans: int = 10) -> Outcome:
        """Scan until a fault has happened `least` times."""
        done: list[JournalContents] = []
        with self._rig({fault: CHANCES[fault]}) as rig:
            while rig.faults_injected()[fault] < least and len(done) < most_scans:
                journal = self.folder / f"{fault.name.lower()}{len(done)}.jsonl"
                scan_once(rig.config_path, self.plan, journal)
                done.append(read_journal(journal))
            tried = rig.faults_injected()[fault]
        return self._outcome(fault.value, tried, done)

    def kills(self, count: int) -> Outcome:
        """Kill a scanning process `count` times, resuming it each time, and scan to the end.

        Each process lives for a random time. POSIX only.
        """
        moment = random.Random(self.seed)
        done: list[JournalContents] = []
        killed = 0
        with self._rig({}) as rig:
            while killed < count or self._journal(done).exists():
                journal = self._journal(done)
                life_s = None if killed >= count else moment.uniform(0.0, _LONGEST_LIFE_S)
                if _in_a_process(rig.config_path, self.plan, journal, life_s):
                    killed += 1
                else:
                    done.append(read_journal(journal))
        return self._outcome("kill -9", killed, done)

    def _journal(self, done: list[JournalContents]) -> Path:
        return self.folder / f"killed{len(done)}.jsonl"

    @contextmanager
    def _rig(self, faults: dict[Fault, float]) -> Iterator[SimulatedRig]:
        with simulated_rig(
            self.specimen,
            seed=self.seed,
            faults=faults,
            time_scale=_TIME_SCALE,
            conditions=_STEADY,
        ) as rig:
            yield rig

    def _outcome(self, what: str, tried: int, done: list[JournalContents]) -> Outcome:
        lost = twice = 0
        difference = 0.0
        for contents in done:
            cells = [taken.step.cell for taken in contents.taken]
            lost += len(self.plan.cells) - len(set(cells))
            lost += sum(taken.reading.range is not Range.OK for taken in contents.taken)
            twice += len(cells) - len(set(cells))
            difference = max(difference, _difference(_values(contents), self.undisturbed))
        readings = len(done) * self.plan.steps
        return Outcome(what, tried, len(done), readings, lost, twice, difference)


def scan_once(config: Path, plan: FixedPlan, journal: Path) -> None:
    """Begin or resume the scan of a journal on the rig of a file, and bring it to its end."""
    rig = load_rig(config)
    with (
        open_instruments(rig) as instruments,
        open_journal(
            journal,
            rig,
            instruments,
            plan,
            references=_REFERENCES,
            sample="yakogai",
            resume=journal.exists(),
        ) as opened,
    ):
        run_scan(
            opened, instruments.goniometer, instruments.colorimeter, retry_policy=_RETRY_POLICY
        )


def fault_table(outcomes: list[Outcome]) -> str:
    """The outcomes, a line each, as a Markdown table."""
    lines = [
        "| fault | times tried | scans | readings | lost | twice | largest difference |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {o.what} | {o.tried} | {o.scans} | {o.readings} | {o.lost} | {o.twice} | "
        f"{o.largest_difference:.1g} |"
        for o in outcomes
    ]
    return "\n".join(lines)


def _values(contents: JournalContents) -> Floats:
    return reduce_readings(contents).measurement.values


def _difference(values: Floats, undisturbed: Floats) -> float:
    """The largest relative one; infinite where a value is there in one and not in the other."""
    there = ~np.isnan(undisturbed)
    if not np.array_equal(there, ~np.isnan(values)):
        return float("inf")
    return float(abs(values[there] / undisturbed[there] - 1).max())


def _in_a_process(config: Path, plan: FixedPlan, journal: Path, life_s: float | None) -> bool:
    """Scan in a process of its own; True where it was killed after `life_s` seconds."""
    child = os.fork()
    if child == 0:
        try:
            scan_once(config, plan, journal)
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    ends = None if life_s is None else time.monotonic() + life_s
    while ends is None or time.monotonic() < ends:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            if status:
                raise RuntimeError("endurance: a scan failed; see above")
            return False
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


def main(arguments: list[str] | None = None) -> None:
    """Run every trial and print the table; exit code 1 where a reading was lost or changed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--least", type=int, default=5, help="times each fault is to happen")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        trial = Endurance(Path(folder), seed=options.seed)
        with ThreadPoolExecutor(_AT_ONCE) as pool:  # ended before anything forks
            outcomes = list(pool.map(lambda fault: trial.fault(fault, least=options.least), Fault))
        if options.kills:
            outcomes.append(trial.kills(options.kills))
    print(fault_table(outcomes))
    kept = all(o.lost == o.twice == 0 and o.largest_difference < 1e-9 for o in outcomes)
    sys.exit(0 if kept else 1)


if __name__ == "__main__":
    main()
