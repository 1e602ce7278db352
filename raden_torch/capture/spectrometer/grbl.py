"""A goniometer whose stages are rotary axes of a GRBL 1.1 or grblHAL controller.

See `grbl_line` for the conversation and where it is known from. `ok` means that a line was
accepted; arrival is the state Idle at the target position.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from contextlib import suppress

from raden_torch.capture.spectrometer.grbl_line import GrblLine, Status
from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    Goniometer,
    InstrumentError,
    MotionAlarmError,
    Position,
    Target,
)
from raden_torch.capture.spectrometer.rig import ANGLES, Ask, Axis, Rig, angles_of
from raden_torch.errors import InputError

ARRIVED_DEG = 0.05
"""How close to its target a stage at rest has arrived: more than a step, less than matters."""

_STOP_TIMEOUT_S = 5.0
_STALLED_S = 5.0  # how long it may be idle elsewhere, or held, before that is an error


class GrblGoniometer(Goniometer):
    """`Goniometer` over GRBL or grblHAL; opened and identified when it is made.

    Raises:
        ConnectionLostError: the port cannot be opened, or what answers is no such controller.
        InputError: the controller has no axis of a configured letter.
    """

    def __init__(self, rig: Rig, ask: Ask) -> None:
        self._rig = rig
        self._settings = s = rig.goniometer_settings
        self._ask = ask
        self._axes: list[Axis] = [s.axes[name] for name in ANGLES]
        self._zero = [axis.zero_deg for axis in self._axes]
        self._shown: tuple[Target, int] | None = None  # and after how many resets that was
        self._homing = False
        self._line = GrblLine(s)
        self.identity = self._line.identity
        missing = [axis.letter for axis in self._axes if axis.letter not in self._line.letters]
        if missing:
            self._line.close()
            raise InputError(
                f"{s.port}: expected axes {', '.join(missing)}, got a controller with "
                f"{', '.join(self._line.letters)}; correct `letter` in the rig file"
            )

    # -- the port ------------------------------------------------------------------------------

    @property
    def homed(self) -> bool:
        return not self._line.position_lost

    def home(self) -> None:
        s = self._settings
        self._line.position_lost = True
        self._make_ready()
        if s.homing == "manual":
            self._ask("Turn every axis to its zero mark by hand")
            self.assume_position(Position(0.0, 0.0, 0.0))
            return
        self._homing = True
        self._line.command(s.homing, s.homing_timeout_s)
        self._homing = False
        self._wait_idle(s.reply_timeout_s)
        self._zero = [axis.zero_deg for axis in self._axes]
        self._line.position_lost = False

    def assume_position(self, position: Position) -> None:
        angles = _finite(position)
        self._line.position_lost = True
        self._make_ready()
        motor = self._motor_position(self._wait_idle(self._settings.reply_timeout_s))
        self._zero = [
            m - axis.direction * angle
            for axis, m, angle in zip(self._axes, motor, angles, strict=True)
        ]
        self._line.position_lost = False

    def move(self, position: Position) -> None:
        angles = _finite(position)
        unreachable = self._rig.out_of_reach(position)
        if unreachable:
            raise InputError(f"the goniometer cannot go there: {unreachable}")
        self._check_homed()
        target = self._motor_target(angles)
        now = self._motor_position(self._at_rest())
        step = self._settings.approach_deg
        # where the last move would come from above, first go below: backlash is then taken up
        before = [
            t - step if t < n - ARRIVED_DEG and step > 0 else n
            for n, t in zip(now, target, strict=True)
        ]
        if before != list(now):
            self._go(before)
        self._go(target)
        time.sleep(self._settings.settle_s)
        self._line.check_for_surprises()

    def position(self) -> Position:
        self._check_homed()
        motor = self._motor_position(self._line.status())
        angles = (
            axis.direction * (m - zero)
            for axis, m, zero in zip(self._axes, motor, self._zero, strict=True)
        )
        return Position(*angles)

    def show(self, target: Target) -> None:
        if target is self._now_shown():
            return
        how = self._settings.shows[target]
        self._shown = None
        if isinstance(how, str):
            self._ask(how)
        else:
            if not self.homed and any(_moves(line) for line in how):
                raise InstrumentError(
                    f"{self._line.name}: not homed; home it before anything moves"
                )
            for line in how:
                self._line.command(line, self._settings.reply_timeout_s)
            self._wait_idle(self._settings.move_timeout_s)
            time.sleep(self._settings.settle_s)
        self._shown = target, self._line.resets

    def stop(self) -> None:
        held = None
        if not self._homing:  # which a hold does not stop, and during which `?` gets no answer
            with suppress(InstrumentError):
                self._line.hold()
                held = self._wait_held()
        if held is not None and held.base_state == "Idle":
            return
        # the rest of the move is still queued: a reset forgets it. After a completed hold it keeps
        # the position; in motion it raises an alarm, and the position is lost
        if held is None or held.state not in ("Hold:0", "Hold"):
            self._line.position_lost = True
        with suppress(InstrumentError):
            self._line.reset()
            self._homing = False

    def reconnect(self) -> None:
        self._homing = False
        self._line.reconnect()
        self.identity = self._line.identity

    def close(self) -> None:
        self._line.close()

    # -- motion --------------------------------------------------------------------------------

    def _go(self, target: Sequence[float]) -> None:
        words = " ".join(
            f"{axis.letter}{value:.3f}"
            for axis, value in zip(self._axes, self._to_work(target), strict=True)
        )
        feed = self._settings.feed_deg_per_min
        line = f"G0 {words}" if feed is None else f"G1 {words} F{feed:g}"
        self._line.command(line, self._settings.reply_timeout_s, checked_later=True)
        self._wait_arrived(target)

    def _wait_arrived(self, target: Sequence[float]) -> None:
        began = moved = time.monotonic()
        while True:
            status = self._line.status()
            now = time.monotonic()
            where = self._motor_position(status)
            state = status.base_state
            if state in ("Alarm", "Sleep"):
                self._line.position_lost = True
                raise MotionAlarmError(f"{self._line.name}: in state {status.state}; home it")
            away = max(abs(w - t) for w, t in zip(where, target, strict=True))
            if state == "Idle" and away <= ARRIVED_DEG:
                return
            if state == "Run":
                moved = now
            if now - moved > _STALLED_S or now - began > self._settings.move_timeout_s:
                self._line.position_lost = True
                raise MotionAlarmError(
                    f"{self._line.name}: in state {status.state}, {away:.2f} degrees from its "
                    "target; look at the stage, then home it"
                )

    def _at_rest(self) -> Status:
        """A line sent in any other state would wait there, and be obeyed when nobody expects it."""
        status = self._line.status()
        if status.base_state != "Idle":
            self._line.position_lost = True
            raise MotionAlarmError(
                f"{self._line.name}: in state {status.state} before a move, not Idle; see to the "
                "controller, then home it"
            )
        return status

    def _wait_idle(self, timeout_s: float) -> Status:
        deadline = time.monotonic() + timeout_s
        while True:
            status = self._line.status()
            if status.base_state == "Idle":
                return status
            if status.base_state in ("Alarm", "Sleep"):
                self._line.position_lost = True
                raise MotionAlarmError(f"{self._line.name}: in state {status.state}; home it")
            if time.monotonic() > deadline:
                raise InstrumentError(
                    f"{self._line.name}: still in state {status.state} after {timeout_s:g} s"
                )

    def _wait_held(self) -> Status | None:
        """The state in which the stage stands still; None where that did not show in time."""
        deadline = time.monotonic() + _STOP_TIMEOUT_S
        while time.monotonic() < deadline:
            status = self._line.status()
            if status.state in ("Idle", "Hold", "Hold:0", "Alarm", "Check", "Sleep"):
                return status
        return None

    def _make_ready(self) -> None:
        """Out of any hold, alarm or error, at rest, nothing queued, in degrees; nothing moves."""
        with suppress(MotionAlarmError):  # what was said before is no news now
            self._line.check_for_surprises()
        if self._line.quiet_status().base_state != "Idle" or self._line.awaits_replies:
            self._line.reset()
        self._line.command("$X", self._settings.reply_timeout_s)
        self._line.command("G21 G90 G94", self._settings.reply_timeout_s)
        self._homing = False

    def _now_shown(self) -> Target | None:
        """A reset switches the controller's outputs off; what an operator did stays."""
        if self._shown is None:
            return None
        target, resets = self._shown
        by_hand = isinstance(self._settings.shows[target], str)
        return target if by_hand or resets == self._line.resets else None

    def _check_homed(self) -> None:
        self._line.check_for_surprises()
        if not self.homed:
            raise InstrumentError(f"{self._line.name}: not homed; home it before anything moves")

    # -- coordinates ---------------------------------------------------------------------------

    def _motor_target(self, angles: Sequence[float]) -> list[float]:
        return [
            zero + axis.direction * angle
            for axis, zero, angle in zip(self._axes, self._zero, angles, strict=True)
        ]

    def _motor_position(self, status: Status) -> list[float]:
        """Machine coordinates of the three axes, in the order of `ANGLES`."""
        values = status.machine
        if values is None:
            values = tuple(
                w + o for w, o in zip(status.work or (), self._line.offset or (), strict=False)
            ) or (status.work or ())
        index = [self._line.letters.index(axis.letter) for axis in self._axes]
        if max(index) >= len(values):
            raise ConnectionLostError(f"{self._line.name}: a status report with {len(values)} axes")
        return [values[i] for i in index]

    def _to_work(self, machine: Sequence[float]) -> list[float]:
        """G0 and G1 take work coordinates: machine − offset."""
        if self._line.offset is None:
            return list(machine)
        index = [self._line.letters.index(axis.letter) for axis in self._axes]
        return [m - self._line.offset[i] for m, i in zip(machine, index, strict=True)]


def _moves(line: str) -> bool:
    return bool(re.search(r"[XYZABCUVW]\s*[-+.\d]", line.upper()))


def _finite(position: Position) -> list[float]:
    angles = [float(a) for a in angles_of(position)]
    if not all(map(math.isfinite, angles)):
        raise InputError(f"position: expected finite angles in degrees, got {position}")
    return angles
