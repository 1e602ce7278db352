"""Fakes of the two ports, in this process: a scan's own logic, without a serial line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import pytest

from raden_torch.capture.spectrometer.journal import Header
from raden_torch.capture.spectrometer.plan import Plan
from raden_torch.capture.spectrometer.ports import (
    Colorimeter,
    ColorReading,
    Goniometer,
    InstrumentError,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.white import White

WHITE_POSITION = Position(45.0, 0.0, 0.0)
HOME = Position(0.0, 0.0, 0.0)
WHITE_XYZ = np.array([94.0, 99.0, 107.8])
LAMP = np.array([900.0, 1000.0, 1200.0])  # signal of the perfect diffuser, lit from above
DARK = np.array([0.3, 0.2, 0.4])


def factor_of(position: Position) -> np.ndarray:
    """The fake sample's XYZ reflectance factor: smooth, coloured and reciprocal."""
    a, r, t = (
        math.radians(x) for x in (position.incidence_deg, position.receiving_deg, position.tilt_deg)
    )
    lobe = math.exp(-(((r - a) / 0.5) ** 2) - (t / 0.4) ** 2)
    return np.array([20.0, 25.0, 15.0]) + lobe * np.array([200.0, 150.0, 300.0])


@dataclass
class FakeRig:
    """Both instruments share this. `script` holds what the next calls do instead of working."""

    seconds: float = 0.0
    where: Position = HOME
    shown: Target = Target.SAMPLE
    measures: int = 0
    calls: list[str] = field(default_factory=list)
    script: dict[str, list[BaseException]] = field(default_factory=dict)
    drift_per_s: float = 0.0
    noise: float = 0.0
    spectrum: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None
    over_above: float = math.inf

    def fail(self, call: str, errors: Iterable[BaseException]) -> None:
        self.script.setdefault(call, []).extend(errors)

    def called(self, call: str) -> None:
        self.calls.append(call)
        self.seconds += 1.0
        errors = self.script.get(call)
        if errors:
            error = errors.pop(0)
            if error is not None:
                raise error

    def clock(self) -> float:
        return self.seconds

    def sleep(self, seconds: float) -> None:
        self.seconds += seconds


class FakeGoniometer(Goniometer):
    def __init__(self, rig: FakeRig) -> None:
        self.rig = rig
        self.identity = "fake goniometer"
        self._homed = False

    def home(self) -> None:
        self.rig.called("home")
        self._homed = True

    @property
    def homed(self) -> bool:
        return self._homed

    def assume_position(self, position: Position) -> None:
        self.rig.called("assume")
        self.rig.where = position
        self._homed = True

    def move(self, position: Position) -> None:
        if not self._homed:
            raise InstrumentError("goniometer: not homed")
        self.rig.called("move")
        self.rig.where = position

    def position(self) -> Position:
        self.rig.called("position")
        return self.rig.where

    def show(self, target: Target) -> None:
        self.rig.called(f"show {target.value}")
        self.rig.shown = target

    def stop(self) -> None:
        self.rig.called("stop")

    def reconnect(self) -> None:
        self.rig.called("reconnect goniometer")
        self._homed = False

    def close(self) -> None:
        self.rig.called("close")


class FakeColorimeter(Colorimeter):
    def __init__(self, rig: FakeRig) -> None:
        self.rig = rig
        self.identity = "fake colorimeter"
        self.random = np.random.default_rng(0)

    def measure(self) -> ColorReading:
        self.rig.called("measure")
        self.rig.measures += 1
        rig, here = self.rig, self.rig.where
        light = math.cos(math.radians(here.incidence_deg)) * math.cos(math.radians(here.tilt_deg))
        level = LAMP * (1 + rig.drift_per_s * rig.seconds) * light / [95.047, 100.0, 108.883]
        factor = {
            Target.SAMPLE: factor_of(here),
            Target.WHITE: WHITE_XYZ,
            Target.DARK: np.zeros(3),
        }[rig.shown]
        signal = level * factor * (1 + rig.noise * self.random.standard_normal(3)) + DARK
        if signal.max() > rig.over_above:
            return ColorReading(np.full(3, np.nan), Range.OVER)
        if rig.spectrum is not None:
            nm, radiance = rig.spectrum(signal)
            return ColorReading(signal, Range.OK, 0.1, nm, radiance)
        return ColorReading(signal, Range.OK, 0.1)

    def status(self) -> str:
        return "fake"

    def reconnect(self) -> None:
        self.rig.called("reconnect colorimeter")

    def close(self) -> None:
        self.rig.called("close")


@pytest.fixture
def fake() -> FakeRig:
    return FakeRig()


@pytest.fixture
def goniometer(fake: FakeRig) -> FakeGoniometer:
    return FakeGoniometer(fake)


@pytest.fixture
def colorimeter(fake: FakeRig) -> FakeColorimeter:
    return FakeColorimeter(fake)


@pytest.fixture
def header() -> Callable[..., Header]:
    """A header around a plan; the white reference is the fakes' own."""

    def make(plan: Plan, every_s: float = 600.0, readings: int = 2, **changed: object) -> Header:
        known: dict[str, object] = {
            "plan": plan,
            "white": White(WHITE_POSITION, tuple(WHITE_XYZ.tolist())),
            "reference_every_s": every_s,
            "reference_readings": readings,
            "goniometer": "fake goniometer",
            "colorimeter": "fake colorimeter",
            "simulated": True,
            "sample": "fake shell",
            "started": "2026-01-01 00:00:00 UTC",
        }
        return Header(**(known | changed))  # type: ignore[arg-type]

    return make


@pytest.fixture
def true_factor() -> Callable[[Position], np.ndarray]:
    return factor_of
