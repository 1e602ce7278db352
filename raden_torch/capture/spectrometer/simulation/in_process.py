"""A simulated scan without instruments: the same scan, the same laboratory, no lines between them.

Thousands of readings a second, to repeat a scan with other errors; what a line or a driver may do
wrong is not in it (`simulated_rig` has that).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.journal import Header, JournalContents, Record
from raden_torch.capture.spectrometer.lab_report import now_utc
from raden_torch.capture.spectrometer.ports import (
    Colorimeter,
    ColorReading,
    Goniometer,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.rig import angles_of
from raden_torch.capture.spectrometer.scan import run_scan
from raden_torch.capture.spectrometer.scan_plan import Plan
from raden_torch.capture.spectrometer.simulation.laboratory import Laboratory
from raden_torch.capture.spectrometer.simulation.simulated_radiance import FIRST_NM, LAST_NM, Scene
from raden_torch.capture.spectrometer.simulation.simulated_rig import WHITE_FACTOR, Conditions
from raden_torch.capture.spectrometer.white_reference import White
from raden_torch.colorimetry import D65_XYZ

_HOME = Position(0.0, 0.0, 0.0)
_WHITE_AT = Position(45.0, 0.0, 0.0)
_DEG_PER_S = 30.0
_SETTLE_S = 0.5
_READING_S = 3.0
_CHANGE_S = 2.0


def scan_in_process(
    scene: Scene,
    plan: Plan,
    *,
    conditions: Conditions,
    seed: int = 0,
    reference_every_s: float = 600.0,
    reference_readings: int = 5,
    sample: str = "",
    white_relative_std: float = 0.0,
) -> JournalContents:
    """Scan a simulated sample by its plan; what a journal would hold.

    Args:
        scene: the sample and the lamp, of `make_scene` with `conditions.white_luminance_cd_m2`.
        conditions: how good the laboratory is; the rig states its uncertainties rightly.
        seed: of all errors.
        white_relative_std: what the white's certificate states; the simulated one is exact.
    """
    laboratory = Laboratory(scene, conditions.errors, WHITE_FACTOR, np.random.default_rng(seed + 2))
    white = (WHITE_FACTOR / 100.0 * D65_XYZ).tolist()
    header = Header(
        plan=plan,
        white=White(
            _WHITE_AT,
            (white[0], white[1], white[2]),
            name="simulated white",
            relative_std=white_relative_std,
        ),
        reference_every_s=reference_every_s,
        reference_readings=reference_readings,
        goniometer="simulated, in one process",
        colorimeter="simulated, in one process",
        simulated=True,
        sample=sample,
        started=now_utc(),
        stated=conditions.stated,
    )
    stage, journal = _Stage(laboratory), _Memory(JournalContents(header))
    run_scan(journal, _Goniometer(stage), _Colorimeter(stage, scene), clock=lambda: stage.now_s)
    return journal.contents


@dataclass
class _Memory:
    """A journal that is on no disk."""

    contents: JournalContents

    def append(self, record: Record) -> None:
        self.contents.add(record)


@dataclass
class _Stage:
    """What both instruments share: where it stands, what it shows, and the time."""

    laboratory: Laboratory
    where: Position = _HOME
    shown: Target = Target.SAMPLE
    now_s: float = 0.0
    nm: Floats = field(default_factory=lambda: np.arange(FIRST_NM, LAST_NM + 1.0))


class _Goniometer(Goniometer):
    identity = "simulated"
    homed = True

    def __init__(self, stage: _Stage) -> None:
        self._stage = stage

    def move(self, position: Position) -> None:
        way = float(abs(angles_of(position) - angles_of(self._stage.where)).max())
        self._stage.now_s += way / _DEG_PER_S + _SETTLE_S if way else 0.0
        self._stage.where = position

    def position(self) -> Position:
        return self._stage.where

    def show(self, target: Target) -> None:
        self._stage.now_s += _CHANGE_S if target is not self._stage.shown else 0.0
        self._stage.shown = target

    def home(self) -> None:
        self.move(_HOME)

    def assume_position(self, position: Position) -> None:
        self._stage.where = position

    def stop(self) -> None: ...

    def reconnect(self) -> None: ...

    def close(self) -> None: ...


class _Colorimeter(Colorimeter):
    identity = "simulated"

    def __init__(self, stage: _Stage, scene: Scene) -> None:
        self._stage, self._scene = stage, scene

    def measure(self) -> ColorReading:
        stage = self._stage
        middle = stage.now_s + _READING_S / 2
        stage.now_s += _READING_S
        radiance = stage.laboratory.radiance(angles_of(stage.where), stage.shown, middle)
        return ColorReading(self._scene.xyz_of(radiance), Range.OK, None, stage.nm, radiance)

    def status(self) -> str:
        return self.identity

    def reconnect(self) -> None: ...

    def close(self) -> None: ...
