"""The simulated rig: the recorded controller's replies, the physics, and every fault survived."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    InstrumentBusyError,
    InstrumentError,
    MotionAlarmError,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.rig_config import load_rig
from raden_torch.capture.spectrometer.simulation import (
    Conditions,
    Fault,
    SimulatedRig,
    simulated_rig,
)
from raden_torch.capture.spectrometer.simulation.faults import FaultPlan
from raden_torch.capture.spectrometer.simulation.grbl_controller import GrblController
from raden_torch.capture.spectrometer.simulation.motion import planned
from raden_torch.capture.spectrometer.simulation.simulated_radiance import make_scene
from raden_torch.capture.spectrometer.simulation.stage import Stage, read_stage, write_stage
from raden_torch.errors import InputError

PERFECT = Conditions(noise=0.0, dark_noise_cd_m2=0.0, dark_level_cd_m2=0.0, lamp_drift=0.0)
FAST = 1000.0


@pytest.fixture(scope="module")
def shell(tmp_path_factory) -> tuple[Path, rt.BrdfMeasurement]:
    measurement = rt.simulate_specimen("yakogai", step_deg=10)
    path = tmp_path_factory.mktemp("shell") / "shell.csv"
    measurement.save(path)
    return path, measurement


# -- the recorded session ------------------------------------------------------------------------


def structure(line: str) -> str:
    """What must be the same: the kind of a line, error numbers, states, how many values."""
    line = line.strip()
    if line.startswith("<"):
        state, *fields = line[1:-1].split("|")
        counts = [
            f"{name}×{value.count(',') + 1}"
            for name, _, value in (field.partition(":") for field in fields)
            if name in ("MPos", "Bf", "FS")
        ]
        return " ".join([state, *counts])
    if re.match(r"\[(VER|DRIVER|DRIVER VERSION):", line):
        return line.partition(":")[0]
    return line


def recording(shared: Path) -> tuple[list[dict], list[tuple[float, str]]]:
    """The entries; and what was sent, at the moments at which the real controller took it up."""
    path = shared / "data" / "serial_transcripts" / "grblHAL_1.1f.20260817_ABC.jsonl"
    entries = [json.loads(line) for line in path.read_text().splitlines()]
    sent = []
    for entry, following in zip(entries, [*entries[1:], entries[-1]], strict=True):
        if entry["dir"] == "tx":
            taken_up = following["t"] if following["dir"] == "rx" else entry["t"]
            sent.append((taken_up, entry["data"]))
    return entries, sent


def replayed(sent: list[tuple[float, str]], until: float) -> list[str]:
    """What the simulated controller says to the recorded bytes, at their recorded moments."""
    controller = GrblController(FaultPlan({}, 0), switches=False)
    said: list[str] = []

    def collect(now: float) -> None:
        while (event := controller.next_event()) is not None and event <= now:
            controller.advance(event)
        while (message := controller.outbox.due(now)) is not None:
            said.extend(line for line in message.decode().split("\r\n") if line)

    for moment, data in sent:
        collect(moment)
        said.append(f"> {data!r}")
        controller.receive(data.encode("latin-1"), moment)
        collect(moment)
    collect(until)
    return said


def test_the_recorded_session_is_answered_alike(shared: Path) -> None:
    """Every line sent to the real controller gets the same kinds of reply, in the same order."""
    entries, sent = recording(shared)
    recorded = [
        f"> {entry['data']!r}" if entry["dir"] == "tx" else entry["data"]
        for entry in entries
        if entry["dir"] == "tx" or entry["data"].strip()
    ]
    ours = [structure(line) for line in replayed(sent, entries[-1]["t"] + 1)]
    assert ours == [structure(line) for line in recorded]


def test_the_recorded_positions_are_met(shared: Path) -> None:
    """The same moves end at the same places, as the reports at rest tell."""
    entries, sent = recording(shared)
    at_rest = [
        re.search(r"MPos:([-\d.,]+)", entry["data"])[1]
        for entry in entries
        if entry["dir"] == "rx" and entry["data"].startswith("<Idle") and entry["t"] < 6
    ]
    ours = [
        re.search(r"MPos:([-\d.,]+)", line)[1]
        for line in replayed(sent, 30.0)
        if line.startswith("<Idle")
    ][: len(at_rest)]
    assert ours == at_rest


# -- parts ---------------------------------------------------------------------------------------


def test_a_move_keeps_every_axis_within_its_rate_and_acceleration() -> None:
    rates, accelerations = np.array([10.0, 5.0, 2.0]), np.array([50.0, 20.0, 10.0])
    end = np.array([30.0, -40.0, 1.0])
    move = planned(np.zeros(3), end, 2.0, rates, accelerations, np.inf)
    t = np.linspace(2.0, 2.0 + move.duration, 2001)
    where = np.array([move.position(now) for now in t])
    speed = np.gradient(where, t, axis=0)
    assert (abs(speed) <= rates * 1.001).all()
    assert (abs(np.gradient(speed, t, axis=0))[2:-2] <= accelerations * 1.01).all()
    np.testing.assert_allclose(where[-1], end)
    assert abs(speed).max(axis=0)[1] == pytest.approx(5.0, rel=1e-3)  # the slowest axis decides
    stop, at = move.stopped_by_hold(3.0)
    ahead = np.linalg.norm(stop - move.position(3.0))
    covered, v = move.along(3.0)
    assert ahead == pytest.approx(v * (at - 3.0) / 2)  # a ramp down to rest
    assert 0 < covered < move.length


def test_the_stage_file_is_whole_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "stage"
    stage = Stage((0.0,) * 6, (6.0,) * 6, 10.0, 12.0, True)
    write_stage(path, stage)
    assert read_stage(path) == stage
    assert stage.at(11.0) == (3.0,) * 6
    assert stage.at(9.0) == (0.0,) * 6
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(RuntimeError, match="no whole state"):
        read_stage(path)


def test_a_scene_has_the_colours_of_its_measurement(shell) -> None:
    """XYZ → the smoothest spectrum → XYZ under the same lamp; grey stays flat."""
    scene = make_scene(shell[1], 1000.0)
    white = scene.xyz_of(scene.lamp)
    np.testing.assert_allclose(white, 10 * np.array([95.04, 100.0, 108.88]), rtol=3e-4)
    for xyz in scene.xyz.reshape(-1, 3)[::97]:
        seen = scene.xyz_of(scene.lamp * (scene.reflectance_of_xyz @ xyz))
        np.testing.assert_allclose(seen, xyz * 10, rtol=1e-6, atol=1e-9)
    flat = scene.reflectance_of_xyz @ (white / 10)
    np.testing.assert_allclose(flat, 1.0, atol=1e-4)


def test_a_scene_fills_what_was_not_measured(shell) -> None:
    m = shell[1]
    holes = rt.BrdfMeasurement(
        m.incidence_deg, m.receiving_deg, m.tilt_deg, m.values, valid=np.arange(len(m)) % 7 > 0
    )
    assert np.isfinite(make_scene(holes, 1.0).xyz).all()
    one_tilt = m.select(m.tilt_deg == 0)
    assert make_scene(one_tilt, 1.0).xyz.shape[2] == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed: .*, got -1"),
        ({"time_scale": 0.0}, "time_scale: .*, got 0"),
        ({"time_scale": float("nan")}, "time_scale: .*, got nan"),
        ({"faults": {Fault.LATE: 1.5}}, "faults: expected a Fault and its chance 0…1, got .*: 1.5"),
        ({"faults": {"late": 0.5}}, "a Fault and its chance"),
    ],
)
def test_bad_arguments(shell, arguments, message: str) -> None:
    with pytest.raises(InputError, match=message), simulated_rig(shell[0], **arguments):
        pass


def test_bad_conditions_and_measurements(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="noise: expected at least 0, got -1"):
        Conditions(noise=-1)
    with pytest.raises(InputError, match="white_luminance_cd_m2: expected more than 0, got 0"):
        Conditions(white_luminance_cd_m2=0)
    with pytest.raises(InputError, match="No such file"), simulated_rig(tmp_path / "none.csv"):
        pass
    scattered = rt.simulate_specimen(
        "akoya", geometries_deg=np.random.default_rng(0).uniform(0, 60, (200, 3))
    )
    scattered.save(tmp_path / "scattered.csv")
    with (
        pytest.raises(InputError, match="expected readings on a grid, got 200 scattered"),
        simulated_rig(tmp_path / "scattered.csv"),
    ):
        pass


# -- the running rig -----------------------------------------------------------------------------


class Reader:
    """Reads as a scan does: again after a fault, homing where the position is lost."""

    def __init__(self, sim: SimulatedRig) -> None:
        self.rig = sim.rig
        self.goniometer, self.colorimeter = sim.rig.goniometer(), sim.rig.colorimeter()
        self.recovered: list[str] = []

    def read(self, position: Position, target: Target = Target.SAMPLE) -> np.ndarray:
        for _ in range(30):
            instrument = self.goniometer
            try:
                if not self.goniometer.homed:
                    self.goniometer.home()
                self.goniometer.show(target)
                self.goniometer.move(position)
                instrument = self.colorimeter
                reading = self.colorimeter.measure()
            except (InstrumentBusyError, MotionAlarmError) as error:
                self.recovered.append(str(error))
            except ConnectionLostError as error:
                self.recovered.append(str(error))
                self._reconnect(instrument)
            else:
                if reading.range is Range.OK:
                    return reading.xyz
        raise AssertionError("30 attempts were not enough: " + "; ".join(self.recovered[-5:]))

    @staticmethod
    def _reconnect(instrument) -> None:
        for _ in range(10):
            try:
                return instrument.reconnect()
            except (ConnectionLostError, MotionAlarmError):
                continue
        raise AssertionError("no way to reconnect")

    def factor(self, position: Position, white: np.ndarray, at: Position) -> np.ndarray:
        """R = R_w · (L / cos θ) / (L_w / cos θ_w)."""
        light = self.read(position) / cosine(position)
        return self.rig.white.xyz(at) * light / (white / cosine(at))

    def close(self) -> None:
        self.goniometer.close()
        self.colorimeter.close()


def cosine(position: Position) -> float:
    a, t = np.radians([position.incidence_deg, position.tilt_deg])
    return float(np.cos(a) * np.cos(t))


def some_rows(rig, m: rt.BrdfMeasurement, count: int) -> list[int]:
    rows = np.random.default_rng(1).permutation(len(m))
    return [int(i) for i in rows if rig.reachable(position_of(m, i)) is None][:count]


def position_of(m: rt.BrdfMeasurement, row: int) -> Position:
    return Position(m.incidence_deg[row], m.receiving_deg[row], m.tilt_deg[row])


def test_the_rig_measures_what_the_file_says(shell) -> None:
    """Rationale: without noise, radiance ratios to a white are the file's reflectance factors."""
    path, m = shell
    with simulated_rig(path, time_scale=FAST, conditions=PERFECT) as sim:
        assert sim.rig.simulated
        reader = Reader(sim)
        at = sim.rig.white.geometry
        white = reader.read(at, Target.WHITE)
        np.testing.assert_allclose(white, sim.rig.white.xyz(at) * 10 * cosine(at), rtol=3e-4)
        assert (abs(reader.read(at, Target.DARK)) < 1e-6).all()
        for row in some_rows(sim.rig, m, 25):
            found = reader.factor(position_of(m, row), white, at)
            np.testing.assert_allclose(found, m.values[row], rtol=1e-3, atol=1e-3)
        assert reader.recovered == []
        assert sum(sim.faults_injected().values()) == 0
        reader.close()


def test_noise_dark_level_and_saturation(shell) -> None:
    path, _ = shell
    conditions = Conditions(
        noise=0.05, dark_noise_cd_m2=0.02, dark_level_cd_m2=2.0, lamp_drift=0, saturation_cd_m2=900
    )
    at = Position(45, 0, 0)
    with simulated_rig(path, seed=3, time_scale=FAST, conditions=conditions) as sim:
        reader = Reader(sim)
        white = np.array([reader.read(at, Target.WHITE)[1] for _ in range(60)])
        level = 990 * cosine(at)
        assert white.mean() == pytest.approx(level + 2.0, rel=0.03)
        assert 0.03 < white.std() / level < 0.07
        dark = np.array([reader.read(at, Target.DARK)[1] for _ in range(20)])
        assert dark.mean() == pytest.approx(2.0, abs=0.03)
        reader.goniometer.show(Target.WHITE)
        reader.goniometer.move(Position(0, 20, 0))  # 990 cd/m²: over the 900 of this instrument
        readings = [reader.colorimeter.measure() for _ in range(5)]
        over = [reading for reading in readings if reading.range is Range.OVER]
        assert len(over) >= 4
        assert np.isnan(over[0].xyz).all()
        reader.close()


def test_the_lamp_drifts(shell) -> None:
    path, _ = shell
    conditions = Conditions(noise=0, dark_noise_cd_m2=0, dark_level_cd_m2=0, lamp_drift=0.1)
    with simulated_rig(path, time_scale=10_000, conditions=conditions) as sim:
        reader, at = Reader(sim), Position(45, 0, 0)
        levels = [reader.read(at, Target.WHITE)[1]]
        while np.ptp(levels) <= 0.02 * levels[0] and len(levels) < 60:
            time.sleep(0.15)  # 25 minutes of the simulated clock
            levels.append(reader.read(at, Target.WHITE)[1])
        assert 0.02 < np.ptp(levels) / levels[0] < 0.15
        reader.close()


CHANCES = {
    Fault.LATE: 0.05,
    Fault.SPLIT: 0.1,
    Fault.GARBAGE: 0.02,
    Fault.BUSY: 0.2,
    Fault.OVER_RANGE: 0.2,
    Fault.ALARM: 0.1,
    Fault.RESET: 0.1,
    Fault.VANISH: 0.1,
}


@pytest.mark.parametrize("fault", Fault, ids=lambda fault: fault.value)
def test_every_fault_ends_in_the_same_readings(shell, fault: Fault) -> None:
    path, m = shell
    chance = {fault: CHANCES[fault]}
    with simulated_rig(path, seed=5, faults=chance, time_scale=FAST, conditions=PERFECT) as sim:
        reader = Reader(sim)
        at = sim.rig.white.geometry
        white = reader.read(at, Target.WHITE)
        for row in some_rows(sim.rig, m, 25):
            found = reader.factor(position_of(m, row), white, at)
            np.testing.assert_allclose(found, m.values[row], rtol=1e-3, atol=1e-3)
        counts = sim.faults_injected()
        assert counts.pop(fault) > 0
        assert sum(counts.values()) == 0
        if fault in (Fault.BUSY, Fault.ALARM, Fault.RESET, Fault.VANISH):
            assert reader.recovered
        reader.close()


def test_the_faults_are_those_of_the_seed() -> None:
    def struck(seed: int) -> list[bool]:
        plan = FaultPlan({Fault.LATE: 0.3}, seed)
        return [plan.strikes(Fault.LATE) for _ in range(50)]

    assert struck(1) == struck(1)
    assert struck(1) != struck(2)
    assert not any(FaultPlan({}, 1).strikes(Fault.LATE) for _ in range(50))


def test_unhomed_it_stands_elsewhere(shell) -> None:
    """After a power cut the controller believes in 0 wherever it stands: only homing mends it."""
    path, _ = shell
    with simulated_rig(path, time_scale=FAST, conditions=PERFECT) as sim:
        goniometer = sim.rig.goniometer()
        with pytest.raises(InstrumentError, match="not homed"):
            goniometer.move(Position(10, 10, 10))
        goniometer.home()
        goniometer.move(Position(60, 20, 30))
        assert goniometer.position() == Position(60, 20, 30)
        goniometer.close()


def test_another_process_finds_the_rig_by_its_file_and_outlives_none(shell) -> None:
    path, _ = shell
    with simulated_rig(path, time_scale=FAST, conditions=PERFECT) as sim:
        script = (
            "import sys\n"
            "from raden_torch.capture.spectrometer.rig_config import load_rig\n"
            "from raden_torch.capture.spectrometer.ports import Position\n"
            "rig = load_rig(sys.argv[1])\n"
            "g = rig.goniometer(); g.home(); g.move(Position(30, 30, 0)); print(g.position())\n"
            "assert 'torch' not in sys.modules\n"
            "import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n"
        )
        for _ in range(2):  # killed with the port open; the next one can still use the rig
            done = subprocess.run(
                [sys.executable, "-u", "-c", script, str(sim.config_path)],
                capture_output=True,
                text=True,
                timeout=300,
                check=False,
            )
            assert "receiving_deg=30.0" in done.stdout, done.stderr
        assert load_rig(sim.config_path) == sim.rig
        folder = sim.config_path.parent
    assert not folder.exists()
    with pytest.raises(ConnectionLostError):
        sim.rig.goniometer()


def test_the_simulators_end_with_the_process_that_started_them(shell) -> None:
    script = (
        "import os, signal, sys\n"
        "from raden_torch.capture.spectrometer.simulation import simulated_rig\n"
        "with simulated_rig(sys.argv[1]) as sim:\n"
        "    print(sim.config_path.parent, flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(shell[0])],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    folder = Path(done.stdout.strip())
    links = [folder / "goniometer", folder / "colorimeter"]
    deadline = time.monotonic() + 120
    while any(link.is_symlink() for link in links) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(link.is_symlink() for link in links)
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
