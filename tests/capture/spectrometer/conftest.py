"""Instruments for the tests: ones that follow a script at the other end of a real pty, and fakes of
the two ports in this process, for the scan's own logic."""

from __future__ import annotations

import math
import os
import select
import threading
import tty
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from raden_torch.capture.spectrometer.journal import Header
from raden_torch.capture.spectrometer.ports import (
    Colorimeter,
    ColorReading,
    Goniometer,
    InstrumentError,
    Position,
    Range,
    Target,
)
from raden_torch.capture.spectrometer.scan_plan import Plan
from raden_torch.capture.spectrometer.white_reference import White

Answer = Callable[[bytes], bytes]


class ScriptedInstrument:
    """A pty whose far end answers what arrives: `answer(bytes) -> bytes`, called for each piece.

    `tick() -> bytes` is called every few milliseconds, for what is said unasked.
    """

    def __init__(self, answer: Answer, tick: Callable[[], bytes] | None = None) -> None:
        self._answer, self._tick = answer, tick
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        self._theirs = theirs
        self.port = os.ttyname(theirs)
        self.received = b""
        self._open = True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        os.write(self._ours, data)

    def unplug(self) -> None:
        """The cable is pulled: reading and writing fail at the other end."""
        self._stop()
        for handle in (self._ours, self._theirs):
            os.close(handle)

    def close(self) -> None:
        if self._open:
            self.unplug()

    def _stop(self) -> None:
        self._open = False
        self._thread.join(2.0)

    def _run(self) -> None:
        while self._open:
            ready, _, _ = select.select([self._ours], [], [], 0.02 if self._tick is None else 0.002)
            if self._tick is not None and (said := self._tick()):
                os.write(self._ours, said)
            if ready:
                data = os.read(self._ours, 4096)
                self.received += data
                reply = self._answer(data)
                if reply:
                    os.write(self._ours, reply)


def by_line(replies: Callable[[str], bytes]) -> Answer:
    """An answer to whole lines, however they arrive."""
    rest = b""

    def answer(data: bytes) -> bytes:
        nonlocal rest
        rest += data
        said = b""
        while b"\n" in rest:
            line, _, rest = rest.partition(b"\n")
            said += replies(line.decode("ascii").strip())
        return said

    return answer


@pytest.fixture
def scripted() -> Iterator[Callable[..., ScriptedInstrument]]:
    made: list[ScriptedInstrument] = []

    def make(answer: Answer, tick: Callable[[], bytes] | None = None) -> ScriptedInstrument:
        made.append(ScriptedInstrument(answer, tick))
        return made[-1]

    yield make
    for instrument in made:
        instrument.close()


@pytest.fixture
def scripted_lines(scripted: Callable[..., ScriptedInstrument]):
    """As `scripted`, with a function of one line."""
    return lambda replies: scripted(by_line(replies))


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
