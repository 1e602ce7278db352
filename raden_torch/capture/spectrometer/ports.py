"""The two ports of a rig: what turns the sample, and what measures its colour.

A scan knows only these. A driver for one more instrument implements one of them and raises the
errors below; nothing else in the room changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum

from msgspec import Struct

from raden_torch.arrays import Floats
from raden_torch.schema import Finite


class InstrumentError(Exception):
    """An instrument did not do what was asked; the message says which one, what and what to do."""


class ConnectionLostError(InstrumentError):
    """The line is dead or the answer makes no sense: connect again, then home again."""


class MotionAlarmError(InstrumentError):
    """The stage stopped by itself and no longer knows where it is: unlock, then home again."""


class InstrumentBusyError(InstrumentError):
    """Not now (busy, warming up, its internal shutter moving): the same request may work later."""


class Position(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Where the rig stands: the raden angles in degrees, as docs/conventions.md defines them.

    In files, a list of the three.
    """

    incidence_deg: Finite
    receiving_deg: Finite
    tilt_deg: Finite

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Incidence, receiving and tilt."""
        return self.incidence_deg, self.receiving_deg, self.tilt_deg


class Target(Enum):
    """What is in front of the instrument."""

    SAMPLE = "sample"
    WHITE = "white"  # the white reference in the sample's place
    DARK = "dark"  # the lamp shut: what is left is stray light and the instrument's own zero


class Range(Enum):
    """Whether the light suited the instrument."""

    OK = "ok"
    OVER = "over"  # saturated: the values mean nothing
    UNDER = "under"  # too little light for a value


@dataclass(frozen=True, slots=True)
class ColorReading:
    """One answer of a colorimeter.

    `xyz` is CIE 1931 2° XYZ in the instrument's own unit (cd/m² for Y), shape (3,); NaN where
    `range` is not OK. `wavelengths_nm` and `radiance` (n,) in W/(sr·m²·nm) are there when the
    instrument is a spectroradiometer, else None. `integration_s` is None where it is not told.
    """

    xyz: Floats
    range: Range = Range.OK
    integration_s: float | None = None
    wavelengths_nm: Floats | None = None
    radiance: Floats | None = None


class Goniometer(ABC):
    """Turns lamp, sample and detector. Angles in degrees; every call ends within a known time."""

    identity: str
    """Maker, model, firmware as the instrument tells them: kept in the journal."""

    @abstractmethod
    def home(self) -> None:
        """Find the reference marks. Nothing else moves before this (or `assume_position`)."""

    @property
    @abstractmethod
    def homed(self) -> bool:
        """Whether its angles can be believed."""

    @abstractmethod
    def assume_position(self, position: Position) -> None:
        """Take the operator's word for where it stands: the explicit way around homing."""

    @abstractmethod
    def move(self, position: Position) -> None:
        """Go there and return when it has arrived and settled. Refuses what is out of reach.

        The moment before the last approach is backlash-free: always from the same side.
        """

    @abstractmethod
    def position(self) -> Position:
        """Where it stands now, as the instrument reports it."""

    @abstractmethod
    def show(self, target: Target) -> None:
        """Put the sample or the white reference in place, or shut the lamp.

        Called before every reading: does nothing, and asks nobody, where it is so already.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop moving now; safe to call at any time, from a signal handler's clean-up, too."""

    @abstractmethod
    def reconnect(self) -> None:
        """Open the line again after ConnectionLostError. It is not homed afterwards."""

    @abstractmethod
    def close(self) -> None:
        """Give the line back."""


class Colorimeter(ABC):
    """Measures colour. Every call ends within a known time."""

    identity: str
    """Maker, model, serial number as the instrument tells them: kept in the journal."""

    @abstractmethod
    def measure(self) -> ColorReading:
        """One measurement with the instrument's own choice of integration time."""

    @abstractmethod
    def status(self) -> str:
        """One line of how it is doing, in its own terms."""

    @abstractmethod
    def reconnect(self) -> None:
        """Open the line again after ConnectionLostError and restore remote control."""

    @abstractmethod
    def close(self) -> None:
        """Give remote control and the line back."""
