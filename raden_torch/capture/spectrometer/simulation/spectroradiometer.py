"""A simulated CS-2000 in front of the simulated stage.

Left out: synchronisation, user calibration, the stored-data memory, the speed modes.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import Target
from raden_torch.capture.spectrometer.simulation.faults import Fault, FaultPlan
from raden_torch.capture.spectrometer.simulation.laboratory import InstrumentErrors, Laboratory
from raden_torch.capture.spectrometer.simulation.serve import Outbox, serve
from raden_torch.capture.spectrometer.simulation.simulated_radiance import load_scene
from raden_torch.capture.spectrometer.simulation.stage import read_stage

IDENTITY = "CS-2000   ,1,simulated"
PARTS = {1: slice(0, 100), 2: slice(100, 200), 3: slice(200, 300), 4: slice(300, 401)}

_COMMAND_S = 0.02  # what a command takes that measures nothing
_ANNOUNCEMENT_S = 1.0
_READOUT_S = 1.5
_INTEGRATION_CD_M2_S = 100.0  # luminance × integration time that it aims for
_INTEGRATION_S = (0.005, 120.0)
_LONGEST_LINE = 1000


class Spectroradiometer:
    """The protocol, without a port.

    Args:
        look: spectral radiance `(401,)` in W/(sr·m²·nm) that is in front of it at a moment.
        xyz_of: of a spectral radiance.
        saturation_cd_m2: above this it answers ER10.
    """

    def __init__(
        self,
        faults: FaultPlan,
        look: Callable[[float], Floats],
        xyz_of: Callable[[Floats], Floats],
        saturation_cd_m2: float,
    ) -> None:
        self.outbox = Outbox()
        self.wants_to_vanish = False
        self._faults, self._look, self._xyz_of = faults, look, xyz_of
        self._saturation = saturation_cd_m2
        self._text = b""
        self._remote = False
        self._measuring: tuple[float, float, float] | None = None  # middle, end, integration
        self._radiance: Floats | None = None
        self._integration_s = 0.0

    def receive(self, data: bytes, now: float) -> None:
        for byte in data:
            if byte not in b"\r\n":
                self._text = (self._text + bytes([byte]))[-_LONGEST_LINE:]
                continue
            text, self._text = self._text.decode("ascii", "replace").strip(), b""
            if text:
                self._command(text, "\r\n" if byte == 13 else "\n", now)

    def advance(self, now: float) -> None:
        if self._measuring and self._measuring[1] <= now:
            middle, end, self._integration_s = self._measuring
            self._measuring = None
            self._finish(self._look(middle), end)

    def next_event(self) -> float | None:
        return self._measuring[1] if self._measuring else None

    def plugged_in(self, now: float) -> None:
        self._remote, self._measuring, self._text = False, None, b""
        self.outbox.clear()

    def _command(self, text: str, end: str, now: float) -> None:
        self.advance(now)
        name, *parameters = text.upper().split(",")
        reply = self._reply(name, parameters, now)
        if reply is not None:
            self.outbox.say(reply + end, now + _COMMAND_S)

    def _reply(self, name: str, parameters: list[str], now: float) -> str | None:
        if not all(p.isdigit() for p in parameters):
            return "ER17"
        numbers = [int(p) for p in parameters]
        if name == "RMTS" and numbers in ([0], [1]):
            self._remote = numbers == [1]
            return "OK00"
        if not self._remote:
            return "ER00"
        if name == "MEAS" and numbers == [0]:
            self._measuring = None
            self.outbox.clear()
            return "OK00"
        if self._measuring:
            return "ER02"
        if name == "MEAS" and numbers == [1]:
            return self._start(now)
        if name == "IDDR" and not numbers:
            return "OK00," + IDENTITY
        if name == "MEDR" and len(numbers) == 3:
            return self._result(*numbers)
        return "ER17" if name in ("RMTS", "MEAS", "MEDR", "IDDR") else "ER00"

    def _start(self, now: float) -> str | None:
        if self._faults.strikes(Fault.BUSY):
            return "ER02"
        if self._faults.strikes(Fault.VANISH):
            self.wants_to_vanish = True
            return None
        luminance = abs(float(self._xyz_of(self._look(now))[1]))
        low, high = _INTEGRATION_S
        integration = min(max(_INTEGRATION_CD_M2_S / max(luminance, 1e-6), low), high)
        takes = max(2, math.ceil(_READOUT_S + integration))
        begins = now + _ANNOUNCEMENT_S
        self._measuring = (begins + takes / 2, begins + takes, integration)
        self._radiance = None
        self.outbox.say(f"OK00,{takes:03d}\r\n", begins)
        return None

    def _finish(self, radiance: Floats, now: float) -> None:
        over = self._xyz_of(radiance)[1] > self._saturation
        if over or self._faults.strikes(Fault.OVER_RANGE):
            self.outbox.say("ER10\r\n", now)
            return
        self._radiance = radiance
        self.outbox.say("OK00\r\n", now)

    def _result(self, kind: int, form: int, which: int) -> str:
        if self._radiance is None:
            return "ER20"
        if form != 0:
            return "ER17"
        if kind == 0 and which == 1:
            return f"OK00,0,0,{self._integration_s * 1e6:09.0f},0,0,0,0,00"
        if kind == 1 and which in PARTS:
            return _joined(self._radiance[PARTS[which]])
        if kind == 2 and which == 1:
            return _joined(self._xyz_of(self._radiance))
        return "ER17"


class SeenRadiance:
    """Spectral radiance in front of the instrument, from the position in the stage's file."""

    def __init__(self, config: dict[str, Any], laboratory: Laboratory):
        self._c, self._laboratory = config, laboratory
        self._stage = Path(str(config["stage"]))

    def __call__(self, now: float) -> Floats:
        c = self._c
        stage = read_stage(self._stage)
        axes = stage.at(c["began_s"] + now / c["time_scale"])
        angles = np.array([direction * (axes[i] - zero) for i, direction, zero in c["axes"]])
        at_white = axes[c["white_axis"]] > c["white_from"]
        target = Target.WHITE if at_white else Target.SAMPLE
        if stage.shutter_closed:
            target = Target.DARK
        return self._laboratory.radiance(angles, target, now)


def _joined(values: Floats) -> str:
    return "OK00," + ",".join(f"{value:.4e}" for value in values)


def main(config: Path) -> None:
    """Run as a process; `config` is what `simulated_rig` wrote."""
    c = json.loads(config.read_text())
    scene = load_scene(Path(c["scene"]))
    faults = FaultPlan(
        {Fault(name): chance for name, chance in c["faults"].items()},
        c["seed"] + 1,
        Path(c["fault_log"]),
    )
    laboratory = Laboratory(
        scene,
        InstrumentErrors(**c["errors"]),
        c["white_factor"],
        np.random.default_rng(c["seed"] + 2),
    )
    look = SeenRadiance(c, laboratory)
    instrument = Spectroradiometer(faults, look, scene.xyz_of, c["saturation"])
    serve(instrument, Path(c["link"]), faults, c["time_scale"], c["began_s"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
