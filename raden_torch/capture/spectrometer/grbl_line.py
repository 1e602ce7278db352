"""The conversation with a GRBL 1.1 or grblHAL controller.

Source of the protocol: the public notes on GRBL 1.1's interface and on grblHAL, and a session
recorded with grblHAL. Tried against the two firmwares themselves in their projects' simulators
(grblHAL 1.1f of 2026-08-17 with six axes, GRBL 1.1h); no goniometer with one was at hand.

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
from contextlib import suppress
from dataclasses import dataclass

from raden_torch.capture.spectrometer.ports import (
    ConnectionLostError,
    InstrumentError,
    MotionAlarmError,
)
from raden_torch.capture.spectrometer.rig import GoniometerSettings
from raden_torch.capture.spectrometer.serial_line import LineSettings, SerialLine, reopen

STATUS, HOLD, RESET = b"?", b"!", b"\x18"

_LARGEST_DEG = 1e5  # a position beyond this is a garbled number
_ATTEMPTS = 3
_MOST_SURPRISES = 1000
_QUIET_S = 0.1
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


class GrblLine:
    """Lines, their replies, and status reports.

    Attributes:
        identity: firmware, version and driver, as `$I` tells them.
        letters: the axes in the order of the reports' positions.
        offset: machine − work coordinates, as last reported; None where never.
        position_lost: an alarm or a restart has happened since this was last set to False.
        resets: how often the controller has restarted, as far as was noticed.
    """

    def __init__(self, settings: GoniometerSettings) -> None:
        self._settings = settings
        self.name = settings.port
        self.identity, self.letters = "", _DEFAULT_LETTERS
        self.offset: tuple[float, ...] | None = None
        self.position_lost, self.resets = True, 0
        self._replies_due = 0
        self._asked_status = 0.0
        self._line = SerialLine(LineSettings(settings.port, settings.baud))
        try:
            self._connect()
        except BaseException:
            self._line.close()
            raise

    def reconnect(self) -> None:
        reopen(self._line, self._settings.connect_timeout_s)
        self._connect()

    def close(self) -> None:
        self._line.close()

    @property
    def awaits_replies(self) -> bool:
        """Whether a line was sent whose reply has not come: an alarm or Ctrl-C came between."""
        return self._replies_due > 0

    def command(self, text: str, timeout_s: float, *, checked_later: bool = False) -> list[str]:
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
                    f"{self.name}: no reply to {text!r} within {timeout_s:g} s"
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
            self.position_lost = True
            raise MotionAlarmError(f"{self.name}: {meaning}; unlock and home it")
        if not text.startswith("$"):
            # grblHAL would answer every later line with this error; it moves nothing to ask for it
            self.command("$X", self._settings.reply_timeout_s)
        raise InstrumentError(f"{self.name}: the controller refused {text!r} ({meaning})")

    def _look_for_alarm(self, line: str) -> None:
        if line.startswith("ALARM:"):
            self.position_lost = True
            number = _error_number(line)
            meaning = _ALARMS.get(number, "see the controller's manual")
            raise MotionAlarmError(
                f"{self.name}: alarm {number}, {meaning}; clear the cause, then home it"
            )
        if _GREETING.match(line):
            self.position_lost = True
            self._forget_session()
            raise MotionAlarmError(
                f"{self.name}: the controller restarted by itself ({line[:30]!r}); home it"
            )

    def check_for_surprises(self) -> None:
        """Lines that came unasked: an alarm or a restart while nothing was awaited."""
        for _ in range(_MOST_SURPRISES):
            line = self._line.read_line(0.0)
            if line is None:
                return
            self._look_for_alarm(line)

    def status(self) -> Status:
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
                    self.offset = status.offset or self.offset
                    if status.base_state == "Alarm":
                        self.position_lost = True
                    return status
            if time.monotonic() >= deadline:
                raise ConnectionLostError(
                    f"{self.name}: no status report within {self._settings.reply_timeout_s:g} s"
                )

    def quiet_status(self) -> Status:
        """A status where alarms are no surprise; each is told once."""
        for _ in range(_ATTEMPTS - 1):
            with suppress(MotionAlarmError):
                return self.status()
        return self.status()

    def reset(self) -> None:
        self._line.send(RESET)
        deadline = time.monotonic() + self._settings.connect_timeout_s
        self._forget_session()
        while (line := self._line.read_line(deadline - time.monotonic())) is not None:
            if line.startswith("ALARM:"):
                self.position_lost = True
            if _GREETING.match(line):
                self._line.drain(min(0.1, self._settings.poll_s))  # its [MSG:…] about unlocking
                return
        raise ConnectionLostError(f"{self.name}: no greeting after a reset")

    def hold(self) -> None:
        """Decelerate to rest, keeping the position; the rest of the move stays queued."""
        self._line.send(HOLD)

    # -- connecting ----------------------------------------------------------------------------

    def _connect(self) -> None:
        self.position_lost = True
        self._forget_session()
        self.offset = None
        self._await_controller()
        for attempt in range(_ATTEMPTS):
            try:
                self._identify()
                return
            except MotionAlarmError:  # an alarm or a greeting from before: nothing is homed yet
                if attempt == _ATTEMPTS - 1:
                    raise
                self._line.drain(_QUIET_S)
                self._replies_due = 0

    def _identify(self) -> None:
        self.identity, letters = self._ask_build_info()
        status = self._first_status()
        count = len(status.machine or status.work or ())
        self.letters = (letters or _DEFAULT_LETTERS)[:count]

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
            f"{self.name}: no GRBL controller answered at {self._settings.baud} baud"
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
        for _ in range(_ATTEMPTS):
            try:
                said = self.command("$I", self._settings.reply_timeout_s)
            except (ConnectionLostError, MotionAlarmError):
                raise
            except InstrumentError:
                said = []
            if any(line.startswith("[VER:") for line in said):
                return said
            self._line.drain(_QUIET_S)  # the reply may have been to a line of a killed program
        return []

    def _first_status(self) -> Status:
        """A report with positions; asks a few times, since the work offset comes in some only."""
        for _ in range(4):
            status = self.status()
            if self.offset is not None:
                break
        return status

    def _forget_session(self) -> None:
        """After a reset no reply is due any more."""
        self._replies_due = 0
        self.resets += 1


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
