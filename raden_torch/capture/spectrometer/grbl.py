"""A goniometer whose stages are rotary axes of a GRBL 1.1 or grblHAL controller.

Source of the protocol: GRBL 1.1's interface and commands pages and grblHAL's core wiki; checked
against a session recorded with grblHAL. No goniometer with such a controller was at hand.

What the protocol hides from a casual reader, and this driver is built around:

- `ok` means that a line was accepted. Arrival is the state Idle at the target position.
- Replies come in the order of the lines; a line whose reply was not awaited (Ctrl-C) still has one
  coming, which must not be taken for the next line's.
- Realtime bytes (`?`, `!`, `~`, 0x18) have no reply of their own, and `?` gets none while homing.
- grblHAL repeats a G-code error for every later G-code line until `$X`.
- After an alarm the position is not to be believed. Some alarms need a reset before `$X`.
- A greeting in the middle of a session means that the controller has restarted.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    Goniometer,
    InstrumentError,
    MotionAlarmError,
    Position,
    Target,
)
from raden_torch.capture.spectrometer.rig import (
    ANGLES,
    Ask,
    Axis,
    Rig,
    angles_of,
)
from raden_torch.capture.spectrometer.serial_line import LineSettings, SerialLine, reopen
from raden_torch.errors import InputError

STATUS, HOLD, RESUME, RESET = b"?", b"!", b"~", b"\x18"

ARRIVED_DEG = 0.05
"""How close to its target a stage at rest has arrived: more than a step, less than matters."""
_LARGEST_DEG = 1e5  # a position beyond this is a garbled number
_STOP_TIMEOUT_S = 5.0
_ATTEMPTS = 3
_QUIET_S = 0.1
_STALLED_S = 5.0  # how long it may be idle elsewhere, or held, before that is an error
_DEFAULT_LETTERS = "XYZABCUVW"
_GREETING = re.compile(r"^(Grbl|GrblHAL)\b.*\[", re.IGNORECASE)
_ERRORS = {  # https://github.com/gnea/grbl/wiki/Grbl-v1.1-Interface, in short
    2: "a number or axis letter is not valid",
    5: "homing is not enabled in the controller ($22)",
    8: "only possible when idle",
    9: "locked by an alarm",
    15: "beyond the controller's own soft limits",
    20: "the controller does not know this G-code",
    22: "no feed rate was set",
    25: "a word is repeated",
}
_ALARMS = {
    1: "a hard limit was hit",
    2: "the target is beyond the controller's soft limits",
    3: "it was reset in motion",
    6: "homing was reset",
    7: "the safety door was opened while homing",
    8: "homing did not clear the switch",
    9: "homing did not find the switch",
    10: "emergency stop",
}


@dataclass(frozen=True, slots=True)
class Status:
    """One status report: `<State|MPos:…|…>`."""

    state: str
    machine: tuple[float, ...] | None
    work: tuple[float, ...] | None
    offset: tuple[float, ...] | None

    @property
    def base_state(self) -> str:
        """Without the sub-state: Hold:0 is Hold."""
        return self.state.partition(":")[0]


def parse_status(line: str) -> Status | None:
    """A status report, or None where `line` is not a whole and sensible one."""
    if not (line.startswith("<") and line.endswith(">")):
        return None
    state, *fields = line[1:-1].split("|")
    if not re.fullmatch(r"[A-Z][A-Za-z]*(:\d+)?", state):
        return None
    values: dict[str, tuple[float, ...]] = {}
    for field in fields:
        key, _, text = field.partition(":")
        if key in ("MPos", "WPos", "WCO"):
            numbers = _numbers(text)
            if numbers is None:
                return None
            values[key] = numbers
    return Status(state, values.get("MPos"), values.get("WPos"), values.get("WCO"))


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
        self._homed = False
        self._shown: Target | None = None
        self._replies_due = 0
        self._asked_status = 0.0
        self._homing = False
        self._line = SerialLine(LineSettings(s.port, s.baud))
        try:
            self._connect()
        except BaseException:
            self._line.close()
            raise

    # -- the port ------------------------------------------------------------------------------

    @property
    def homed(self) -> bool:
        return self._homed

    def home(self) -> None:
        s = self._settings
        self._homed = False
        self._make_ready()
        if s.homing == "manual":
            self._ask("Turn every axis to its zero mark by hand")
            self.assume_position(Position(0.0, 0.0, 0.0))
            return
        self._homing = True
        self._command(s.homing, s.homing_timeout_s)
        self._homing = False
        self._wait_idle(s.reply_timeout_s)
        self._zero = [axis.zero_deg for axis in self._axes]
        self._homed = True

    def assume_position(self, position: Position) -> None:
        angles = _finite(position)
        self._homed = False
        self._make_ready()
        motor = self._motor_position(self._wait_idle(self._settings.reply_timeout_s))
        self._zero = [
            m - axis.direction * angle
            for axis, m, angle in zip(self._axes, motor, angles, strict=True)
        ]
        self._homed = True

    def move(self, position: Position) -> None:
        angles = _finite(position)
        unreachable = self._rig.out_of_reach(position)
        if unreachable:
            raise InputError(f"the goniometer cannot go there: {unreachable}")
        self._check_homed()
        target = self._motor_target(angles)
        now = self._motor_position(self._status())
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
        self._check_for_surprises()

    def position(self) -> Position:
        self._check_homed()
        motor = self._motor_position(self._status())
        angles = (
            axis.direction * (m - zero)
            for axis, m, zero in zip(self._axes, motor, self._zero, strict=True)
        )
        return Position(*angles)

    def show(self, target: Target) -> None:
        if target is self._shown:
            return
        how = self._settings.shows[target]
        self._shown = None
        if isinstance(how, str):
            self._ask(how)
        else:
            if not self._homed and any(_moves(line) for line in how):
                raise InstrumentError(f"{self._name}: not homed; home it before anything moves")
            for line in how:
                self._command(line, self._settings.reply_timeout_s)
            self._wait_idle(self._settings.move_timeout_s)
            time.sleep(self._settings.settle_s)
        self._shown = target

    def stop(self) -> None:
        held = None
        if not self._homing:  # which a hold does not stop, and during which `?` gets no answer
            with suppress(InstrumentError):
                self._line.send(HOLD)
                held = self._wait_held()
        if held is not None and held.base_state == "Idle":
            return
        # the rest of the move is still queued: a reset forgets it. After a completed hold it keeps
        # the position; in motion it raises an alarm, and the position is lost
        if held is None or held.state not in ("Hold:0", "Hold"):
            self._homed = False
        with suppress(InstrumentError):
            self._soft_reset()

    def reconnect(self) -> None:
        self._homed = False
        reopen(self._line, self._settings.connect_timeout_s)
        self._connect()

    def close(self) -> None:
        self._line.close()

    # -- the conversation ----------------------------------------------------------------------

    @property
    def _name(self) -> str:
        return self._settings.port

    def _connect(self) -> None:
        self._homed = False
        self._forget_session()
        self._offset: tuple[float, ...] | None = None
        self._letters = _DEFAULT_LETTERS
        self._zero = [axis.zero_deg for axis in self._axes]
        self._await_controller()
        for attempt in range(_ATTEMPTS):
            try:
                self._identify()
                break
            except MotionAlarmError:  # an alarm or a greeting from before: nothing is homed yet
                if attempt == _ATTEMPTS - 1:
                    raise
                self._line.drain(_QUIET_S)
                self._replies_due = 0

    def _identify(self) -> None:
        self.identity, letters = self._ask_build_info()
        status = self._first_status()
        count = len(status.machine or status.work or ())
        self._letters = letters or _DEFAULT_LETTERS[:count]
        missing = [axis.letter for axis in self._axes if axis.letter not in self._letters[:count]]
        if missing:
            raise InputError(
                f"{self._name}: the controller has the axes {', '.join(self._letters[:count])}, "
                f"none called {', '.join(missing)}; correct `letter` in the rig file"
            )

    def _await_controller(self) -> None:
        """Wait for a status report: opening the port may have restarted the controller."""
        began = time.monotonic()
        give_up = began + self._settings.connect_timeout_s
        reset_at = began + self._settings.connect_timeout_s / 2
        heard = ""
        while time.monotonic() < give_up:
            if time.monotonic() > reset_at:  # it may be homing for a program that is gone
                self._line.send(RESET)
                reset_at = math.inf
            self._line.send(STATUS)
            until = time.monotonic() + 0.25
            while time.monotonic() < until:
                line = self._line.read_line(until - time.monotonic())
                if line is not None and parse_status(line):
                    self._line.drain(self._settings.poll_s / 4)
                    return
                heard = heard or line or ""
        raise ConnectionLostError(
            f"{self._name}: no GRBL controller answered at {self._settings.baud} baud"
            + (f", but something said {heard[:40]!r}" if heard else "")
            + "; check the port, the baud rate and the power"
        )

    def _ask_build_info(self) -> tuple[str, str]:
        """Version, and the axis letters where the controller tells them (grblHAL does)."""
        found = {"VER": "", "AXS": "", "FIRMWARE": "Grbl", "DRIVER": ""}
        for line in self._build_info():
            match = re.fullmatch(r"\[(\w+):(.*)\]", line)
            if match and match[1] in found:
                found[match[1]] = match[2].strip(": ")
        letters = found["AXS"].rpartition(":")[2].upper()
        parts = (found["FIRMWARE"], found["VER"], found["DRIVER"] and f"on {found['DRIVER']}")
        return " ".join(part for part in parts if part), letters

    def _build_info(self) -> list[str]:
        """The lines of `$I`; none where the controller does not know it."""
        try:
            return self._command("$I", self._settings.reply_timeout_s)
        except (ConnectionLostError, MotionAlarmError):
            raise
        except InstrumentError:
            return []

    def _first_status(self) -> Status:
        """A report with positions; asks a few times, since the work offset comes in some only."""
        for _ in range(4):
            status = self._status()
            if self._offset is not None:
                break
        return status

    def _command(
        self,
        text: str,
        timeout_s: float,
        *,
        checked_later: bool = False,
    ) -> list[str]:
        """Send a line, wait for its `ok`; what came before it.

        Where `checked_later`, a garbled line in place of the reply is let pass.

        Raises:
            MotionAlarmError: an alarm, a restart, or the controller is locked by one.
            InstrumentError: the controller refuses the line.
            ConnectionLostError: no reply within the time.
        """
        self._line.send(text.encode("ascii") + b"\n")
        self._replies_due += 1
        deadline = time.monotonic() + timeout_s
        said: list[str] = []
        while True:
            line = self._line.read_line(deadline - time.monotonic())
            if line is None:
                if checked_later and any(map(_garbled, said)):
                    self._replies_due = 0
                    return said
                raise ConnectionLostError(
                    f"{self._name}: no reply to {text!r} within {timeout_s:g} s"
                )
            self._look_for_alarm(line)
            if _garbled(line):
                # it may have been the reply: not much longer is waited for another
                deadline = min(deadline, time.monotonic() + timeout_s / 10)
            if line != "ok" and not line.startswith("error:"):
                said.append(line)
                continue
            self._replies_due -= 1
            if self._replies_due > 0:  # the reply to a line that nobody waited for
                said.clear()
                continue
            self._replies_due = 0
            if line == "ok":
                return said
            self._refused(text, _error_number(line))

    def _refused(self, text: str, number: int) -> None:
        meaning = f"error {number}" + (f", {_ERRORS[number]}" if number in _ERRORS else "")
        if number == 9:
            self._homed = False
            raise MotionAlarmError(f"{self._name}: {meaning}; unlock and home it")
        if not text.startswith("$"):
            # grblHAL would answer every later line with this error; it moves nothing to ask for it
            self._command("$X", self._settings.reply_timeout_s)
        raise InstrumentError(f"{self._name}: the controller refused {text!r} ({meaning})")

    def _look_for_alarm(self, line: str) -> None:
        if line.startswith("ALARM:"):
            self._homed = False
            number = _error_number(line)
            meaning = _ALARMS.get(number, "see the controller's manual")
            raise MotionAlarmError(
                f"{self._name}: alarm {number}, {meaning}; clear the cause, then home it"
            )
        if _GREETING.match(line):
            self._homed = False
            self._forget_session()
            raise MotionAlarmError(
                f"{self._name}: the controller restarted by itself ({line[:30]!r}); home it"
            )

    def _check_for_surprises(self) -> None:
        """Lines that came unasked: an alarm or a restart while nothing was awaited."""
        while (line := self._line.read_line(0.0)) is not None:
            self._look_for_alarm(line)

    def _status(self) -> Status:
        """Ask until a whole report comes, no oftener than every `poll_s`."""
        deadline = time.monotonic() + self._settings.reply_timeout_s
        while True:
            time.sleep(max(0.0, self._asked_status + self._settings.poll_s - time.monotonic()))
            self._asked_status = time.monotonic()
            self._line.send(STATUS)
            until = min(deadline, time.monotonic() + max(1.0, 5 * self._settings.poll_s))
            while (line := self._line.read_line(until - time.monotonic())) is not None:
                self._look_for_alarm(line)
                if line == "ok" or line.startswith("error:"):
                    self._replies_due = max(0, self._replies_due - 1)
                status = parse_status(line)
                if status is None and (_garbled(line) or line.startswith("<")):
                    break  # it may have been the report
                if status and (status.machine or status.work):
                    self._offset = status.offset or self._offset
                    if status.base_state == "Alarm":
                        self._homed = False
                    return status
            if time.monotonic() >= deadline:
                raise ConnectionLostError(
                    f"{self._name}: no status report within {self._settings.reply_timeout_s:g} s"
                )

    # -- motion --------------------------------------------------------------------------------

    def _go(self, target: Sequence[float]) -> None:
        words = " ".join(
            f"{axis.letter}{value:.3f}"
            for axis, value in zip(self._axes, self._to_work(target), strict=True)
        )
        feed = self._settings.feed_deg_per_min
        line = f"G0 {words}" if feed is None else f"G1 {words} F{feed:g}"
        self._command(line, self._settings.reply_timeout_s, checked_later=True)
        self._wait_arrived(target)

    def _wait_arrived(self, target: Sequence[float]) -> None:
        began = moved = time.monotonic()
        while True:
            status = self._status()
            now = time.monotonic()
            where = self._motor_position(status)
            state = status.base_state
            if state in ("Alarm", "Sleep"):
                self._homed = False
                raise MotionAlarmError(f"{self._name}: in state {status.state}; home it")
            away = max(abs(w - t) for w, t in zip(where, target, strict=True))
            if state == "Idle" and away <= ARRIVED_DEG:
                return
            if state == "Run":
                moved = now
            if now - moved > _STALLED_S or now - began > self._settings.move_timeout_s:
                self._homed = False
                raise MotionAlarmError(
                    f"{self._name}: in state {status.state}, {away:.2f} degrees from its target; "
                    "look at the stage, then home it"
                )

    def _wait_idle(self, timeout_s: float) -> Status:
        deadline = time.monotonic() + timeout_s
        while True:
            status = self._status()
            if status.base_state == "Idle":
                return status
            if status.base_state in ("Alarm", "Sleep"):
                self._homed = False
                raise MotionAlarmError(f"{self._name}: in state {status.state}; home it")
            if time.monotonic() > deadline:
                raise InstrumentError(
                    f"{self._name}: still in state {status.state} after {timeout_s:g} s"
                )

    def _wait_held(self) -> Status | None:
        """The state in which the stage stands still; None where that did not show in time."""
        deadline = time.monotonic() + _STOP_TIMEOUT_S
        while time.monotonic() < deadline:
            status = self._status()
            if status.state in ("Idle", "Hold", "Hold:0", "Alarm", "Check", "Sleep"):
                return status
        return None

    def _make_ready(self) -> None:
        """Out of any hold, alarm or error, at rest, nothing queued, in degrees; nothing moves."""
        with suppress(MotionAlarmError):  # what was said before is no news now
            self._check_for_surprises()
        if self._quiet_status().base_state != "Idle" or self._replies_due:
            self._soft_reset()
        self._command("$X", self._settings.reply_timeout_s)
        self._command("G21 G90 G94", self._settings.reply_timeout_s)

    def _quiet_status(self) -> Status:
        """A status where alarms are no surprise; each is told once."""
        for _ in range(_ATTEMPTS - 1):
            with suppress(MotionAlarmError):
                return self._status()
        return self._status()

    def _soft_reset(self) -> None:
        self._line.send(RESET)
        deadline = time.monotonic() + self._settings.connect_timeout_s
        self._forget_session()
        while (line := self._line.read_line(deadline - time.monotonic())) is not None:
            if line.startswith("ALARM:"):
                self._homed = False
            if _GREETING.match(line):
                self._line.drain(min(0.1, self._settings.poll_s))  # its [MSG:…] about unlocking
                return
        raise ConnectionLostError(f"{self._name}: no greeting after a reset")

    def _forget_session(self) -> None:
        """After a reset no reply is due any more, and the controller's outputs are off."""
        self._replies_due = 0
        self._homing = False
        if self._shown and not isinstance(self._settings.shows[self._shown], str):
            self._shown = None

    def _check_homed(self) -> None:
        self._check_for_surprises()
        if not self._homed:
            raise InstrumentError(f"{self._name}: not homed; home it before anything moves")

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
                w + o for w, o in zip(status.work or (), self._offset or (), strict=False)
            ) or (status.work or ())
        index = [self._letters.index(axis.letter) for axis in self._axes]
        if max(index) >= len(values):
            raise ConnectionLostError(f"{self._name}: a status report with {len(values)} axes")
        return [values[i] for i in index]

    def _to_work(self, machine: Sequence[float]) -> list[float]:
        """G0 and G1 take work coordinates: machine − offset."""
        if self._offset is None:
            return list(machine)
        index = [self._letters.index(axis.letter) for axis in self._axes]
        return [m - self._offset[i] for m, i in zip(machine, index, strict=True)]


def _numbers(text: str) -> tuple[float, ...] | None:
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        return None
    if len(values) > len(_DEFAULT_LETTERS) or len(values) < 3:
        return None
    return values if all(abs(v) < _LARGEST_DEG for v in values) else None  # NaN fails too


def _garbled(line: str) -> bool:
    return not (line.isascii() and line.isprintable())


def _error_number(line: str) -> int:
    digits = re.search(r"\d{1,4}", line)
    return int(digits[0]) if digits else 0


def _moves(line: str) -> bool:
    return bool(re.search(r"[XYZABCUVW]\s*[-+.\d]", line.upper()))


def _finite(position: Position) -> list[float]:
    angles = [float(a) for a in angles_of(position)]
    if not all(map(math.isfinite, angles)):
        raise InputError(f"{position}: an angle is not a finite number; degrees were wanted")
    return angles
