"""`simulated_rig`: a measurement file becomes a rig that can be scanned."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from raden_torch.capture.spectrometer.csv_file import load_csv
from raden_torch.capture.spectrometer.rig import Rig
from raden_torch.capture.spectrometer.rig_config import load_rig
from raden_torch.capture.spectrometer.simulation.faults import Fault, read_log
from raden_torch.capture.spectrometer.simulation.laboratory import InstrumentErrors
from raden_torch.capture.spectrometer.stated_uncertainty import StatedUncertainty
from raden_torch.errors import InputError

WHITE_FACTOR = 99.0
_WHITE_X, _WHITE_FROM_X = 100.0, 50.0  # the slide that carries the white reference
_START_TIMEOUT_S = 60.0
_LEAST_TIMEOUT_S = 1.0  # a process that waits for its turn on a busy machine is no fault
_AXES = {  # letter, direction, zero, limits: as a real rig would have them, none of them trivial
    "incidence": ("A", 1, 0.0, (-5.0, 90.0)),
    "receiving": ("B", -1, 10.0, (-90.0, 90.0)),
    "tilt": ("C", 1, -5.0, (-90.0, 90.0)),
}
_CONTROLLER = {  # the settings that differ from the recorded controller's
    22: "1",  # homing is on: locked after power-up
    **{110 + i: "1800.000" for i in range(6)},  # deg/min (mm/min for the slide)
    **{120 + i: "60.000" for i in range(6)},  # deg/s²
}


@dataclass(frozen=True, slots=True)
class Conditions:
    """How good the simulated laboratory is.

    Attributes:
        noise: standard deviation of a reading, relative to it.
        dark_noise_cd_m2: standard deviation of a reading of nothing.
        dark_level_cd_m2: what is left with the lamp shut (stray light, the instrument's own zero).
        lamp_drift: how far, relative, the lamp wanders from its first level, over hours of the
            simulated clock.
        zero_error_deg: standard deviation of the error of each axis' zero, drawn once by the seed.
        position_error_deg: standard deviation of where each axis stands after a move.
        white_luminance_cd_m2: of the perfect diffuser at incidence and tilt 0.
        saturation_cd_m2: above this the instrument answers ER10.
    """

    noise: float = 0.002
    dark_noise_cd_m2: float = 0.002
    dark_level_cd_m2: float = 0.05
    lamp_drift: float = 0.01
    zero_error_deg: float = 0.0
    position_error_deg: float = 0.0
    white_luminance_cd_m2: float = 1000.0
    saturation_cd_m2: float = 5e5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise InputError(f"conditions: {field.name}: expected at least 0, got {value!r}")
        if self.white_luminance_cd_m2 == 0.0:
            raise InputError("conditions: white_luminance_cd_m2: expected more than 0, got 0")

    @property
    def errors(self) -> InstrumentErrors:
        """As the laboratory has them, relative to the perfect diffuser's light."""
        return InstrumentErrors(
            noise=self.noise,
            dark_noise=self.dark_noise_cd_m2 / self.white_luminance_cd_m2,
            dark_level=self.dark_level_cd_m2 / self.white_luminance_cd_m2,
            lamp_drift=self.lamp_drift,
            zero_deg=self.zero_error_deg,
            position_deg=self.position_error_deg,
        )

    @property
    def stated(self) -> StatedUncertainty:
        """What such a rig states of itself: the truth."""
        zero, position = self.zero_error_deg, self.position_error_deg
        return StatedUncertainty((zero, zero, zero), (position, position, position))


@dataclass(frozen=True, slots=True)
class SimulatedRig:
    """A running simulation.

    Attributes:
        rig: to scan with, as if it were real.
        config_path: the same rig as a file for `load_rig`, for use from another process.
    """

    rig: Rig
    config_path: Path

    def faults_injected(self) -> dict[Fault, int]:
        """How many faults of each kind have happened so far."""
        return read_log(*self.config_path.parent.glob("*.faults"))


@contextmanager
def simulated_rig(
    measurement: str | os.PathLike[str],
    *,
    seed: int = 0,
    faults: Mapping[Fault, float] | None = None,
    time_scale: float = 1.0,
    conditions: Conditions | None = None,
) -> Iterator[SimulatedRig]:
    """Run a simulated goniometer and colorimeter around the sample of a measurement file.

    Args:
        measurement: a CSV of `BrdfMeasurement.save`, on a grid; between its nodes it is
            interpolated linearly, beyond them the nearest one counts.
        seed: of noise and faults; whole number ≥ 0.
        faults: the probability of each fault at each opportunity for it (a reply, a measurement, a
            move).
        time_scale: how many simulated seconds pass in one real second, up to 10,000.

    Yields:
        The running rig; it ends with the block, and with the process that opened it.

    Raises:
        InputError: the measurement cannot be read or is not a grid; a number is out of range; the
            system has no ptys.
    """
    from raden_torch.capture.spectrometer.simulation.simulated_radiance import make_scene

    _check(seed, faults or {}, time_scale)
    if sys.platform == "win32":
        raise InputError("the simulated rig needs ptys, which Windows has not; Linux or macOS has")
    conditions = conditions or Conditions()
    scene = make_scene(load_csv(measurement), conditions.white_luminance_cd_m2)
    with tempfile.TemporaryDirectory(prefix="raden_rig_") as name:
        folder = Path(name)
        scene.save(folder / "scene.npz")
        common = {
            "seed": seed,
            "faults": {fault.value: chance for fault, chance in (faults or {}).items()},
            "time_scale": time_scale,
            "began_s": time.monotonic(),
            "stage": str(folder / "stage"),
        }
        stage = common | {"settings": _CONTROLLER}
        meter = common | _meter(folder / "scene.npz", conditions)
        config_path = folder / "rig.toml"
        config_path.write_text(_rig_file(folder, time_scale, conditions), encoding="utf-8")
        running: list[subprocess.Popen[bytes]] = []
        try:
            running.append(_start("grbl_controller", "goniometer", stage, folder))
            running.append(_start("spectroradiometer", "colorimeter", meter, folder))
            _wait_for_ports(folder, running)
            yield SimulatedRig(load_rig(config_path), config_path)
        finally:
            for process in running:
                _end(process)


def _check(seed: int, faults: Mapping[Fault, float], time_scale: float) -> None:
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed: expected a whole number of at least 0, got {seed!r}")
    if not 0.0 < time_scale <= 10_000.0:
        raise InputError(f"time_scale: expected more than 0, up to 10000, got {time_scale!r}")
    for fault, chance in faults.items():
        if not isinstance(fault, Fault) or not 0.0 <= chance <= 1.0:
            raise InputError(
                f"faults: expected a Fault and its chance 0…1, got {fault}: {chance!r}"
            )


def _meter(scene: Path, conditions: Conditions) -> dict[str, Any]:
    """What the simulated spectroradiometer has to know beside what both instruments do."""
    return {
        "scene": str(scene),
        "axes": [["XYZABC".index(a), sign, zero] for a, sign, zero, _ in _AXES.values()],
        "white_axis": 0,
        "white_from": _WHITE_FROM_X,
        "white_factor": WHITE_FACTOR,
        "errors": asdict(conditions.errors),
        "saturation": conditions.saturation_cd_m2,
    }


def _start(module: str, link: str, config: dict[str, Any], folder: Path) -> subprocess.Popen[bytes]:
    path = folder / f"{link}.json"
    own = {"link": str(folder / link), "fault_log": str(folder / f"{link}.faults")}
    path.write_text(json.dumps(config | own), encoding="utf-8")
    with (folder / f"{link}.log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.{module}", str(path)],
            stdin=subprocess.PIPE,  # closes when this process ends, however it ends
            stdout=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,  # Ctrl-C is for the scan, not for the instruments
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )


def _wait_for_ports(folder: Path, running: list[subprocess.Popen[bytes]]) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    links = [folder / "goniometer", folder / "colorimeter"]
    while not all(link.is_symlink() for link in links):
        ended = any(process.poll() is not None for process in running)
        if ended or time.monotonic() > deadline:
            said = " ".join((folder / f"{link.name}.log").read_text()[-500:] for link in links)
            raise RuntimeError(f"the simulated rig did not start: {' '.join(said.split())}")
        time.sleep(0.01)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(2.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _rig_file(folder: Path, time_scale: float, conditions: Conditions) -> str:
    def scaled(seconds: float) -> float:
        return max(seconds / time_scale, _LEAST_TIMEOUT_S)

    axes = "".join(
        f"""
[goniometer.axes.{name}]
letter = "{letter}"
direction = {direction}
zero_deg = {zero}
limits_deg = [{low}, {high}]
zero_std_deg = {conditions.zero_error_deg}
position_std_deg = {conditions.position_error_deg}
"""
        for name, (letter, direction, zero, (low, high)) in _AXES.items()
    )
    return f"""name = "simulated rig"
simulated = true

[goniometer]
driver = "grbl"
port = "{folder / "goniometer"}"
approach_deg = 1.0
rapid_deg_per_s = 30.0
settle_s = {0.5 / time_scale}
poll_s = {max(0.2 / time_scale, 0.001)}
homing_timeout_s = {max(120.0 / time_scale, 5.0)}
reply_timeout_s = {scaled(5.0)}
connect_timeout_s = {max(15.0 / time_scale, 3.0)}
{axes}
[goniometer.show]
sample = ["M9", "G0 X0"]
white = ["M9", "G0 X{_WHITE_X:g}"]
dark = ["M8"]

[colorimeter]
driver = "cs2000"
port = "{folder / "colorimeter"}"
reply_timeout_s = {scaled(12.0)}
connect_timeout_s = {max(15.0 / time_scale, 3.0)}

[obstruction]
angle_deg = 4.0

[white]
reflectance_factor = {WHITE_FACTOR}
geometry_deg = [45.0, 0.0, 0.0]
"""
