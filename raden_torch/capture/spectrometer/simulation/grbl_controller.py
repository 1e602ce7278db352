"""A simulated grblHAL controller of six axes, speaking as the recorded session does.

Left out: jogging, the controller's own soft limits, probing, spindle, coordinate systems other than
the machine's, look-ahead over corners. An abrupt stop loses steps; homing finds them again.
"""

from __future__ import annotations

import json
import re
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.simulation.controller_settings import ControllerSettings
from raden_torch.capture.spectrometer.simulation.faults import Fault, FaultPlan
from raden_torch.capture.spectrometer.simulation.gcode_block import LETTERS, Modes, read_block
from raden_torch.capture.spectrometer.simulation.motion import Segment, planned
from raden_torch.capture.spectrometer.simulation.serve import Outbox, serve
from raden_torch.capture.spectrometer.simulation.stage import AXES, Stage, write_stage
from raden_torch.capture.spectrometer.simulation.status_report import (
    PLANNER_BLOCKS,
    RECEIVE_BYTES,
    StatusReport,
)

GREETING = "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
LOCKED = "[MSG:'$H'|'$X' to unlock]\r\n"

_LINE_BYTES = 256
_RESET_S = 0.1  # from a reset to the greeting
_BOOT_S = 0.5
_PULL_OFF_S = 2.0  # what homing takes besides the way to the switch
_SEARCH_S = 25.0  # how long homing looks for a switch that is not there
_LOST_STEPS_DEG = 1.0


class GrblController:
    """The protocol, without a port: bytes and the clock in, an outbox out. Times in seconds.

    Args:
        settings: changes to what the recorded controller has.
        switches: whether homing finds its switches.
        moved: told the true position and the shutter whenever they change.
    """

    def __init__(
        self,
        faults: FaultPlan,
        settings: dict[int, str] | None = None,
        *,
        switches: bool = True,
        moved: Callable[[Segment | None, Floats, bool, float], None] | None = None,
    ) -> None:
        self.outbox = Outbox()
        self.wants_to_vanish = False
        self._faults = faults
        self._settings = ControllerSettings(settings or {})
        self._switches = switches
        self._moved = moved or (lambda *_: None)
        self._lost = np.zeros(AXES)  # true position − the position that it believes in
        self._position = np.zeros(AXES)
        self._restart()
        self.outbox.say("error:7\r\n", 0.0)  # as the recorded one does at its first boot
        self.outbox.say(GREETING, 0.0)
        if self._settings.homing:
            self._state = "Alarm"
            self.outbox.say(LOCKED, 0.0)
        self._tell_stage(0.0)

    def _restart(self) -> None:
        self._state = "Idle"
        self._segment: Segment | None = None
        self._queue: deque[tuple[Floats, float]] = deque()
        self._waiting: deque[str] = deque()
        self._text = b""
        self._modes = Modes()
        self._sticky = 0
        self._critical = False
        self._busy_until = 0.0
        self._hold_at: tuple[Floats, float] | None = None
        self._after_hold: Floats | None = None
        self._homing_ends: tuple[float, bool] | None = None
        self._accident: tuple[float, Fault] | None = None
        self._shutter_closed = False
        self._report = StatusReport()

    # -- the instrument's side of `serve` --------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        self.advance(now)
        for byte in data:
            self._byte(byte, now)
        self._work(now)

    def advance(self, now: float) -> None:
        """Let what has happened by `now` have happened."""
        while (event := self.next_event()) is not None and event <= now:
            self._happen(event)

    def next_event(self) -> float | None:
        moments = [self._homing_ends[0]] if self._homing_ends else []
        if self._accident:
            moments.append(self._accident[0])
        if self._state == "Hold:1" and self._hold_at:
            moments.append(self._hold_at[1])
        if self._segment and self._state == "Run":
            moments.append(self._segment.began + self._segment.duration)
        if self._waiting and self._state == "Idle" and self._busy_until:
            moments.append(self._busy_until)
        return min(moments, default=None)

    def plugged_in(self, now: float) -> None:
        """Powered up again, after its port had vanished with its power."""
        self._crash(now)

    # -- events ----------------------------------------------------------------------------------

    def _happen(self, now: float) -> None:
        if self._accident and self._accident[0] <= now:
            fault = self._accident[1]
            self._accident = None
            if fault is Fault.ALARM:
                self._alarm(1, now)
                self._critical = True
                self.outbox.say("[MSG:Reset to continue]\r\n", now)
            elif fault is Fault.RESET:
                self._crash(now)
            else:
                self._freeze(now)
                self.wants_to_vanish = True
            return
        if self._homing_ends and self._homing_ends[0] <= now:
            found, self._homing_ends = self._homing_ends[1], None
            if not found:
                self._alarm(9, now)
                return
            self._position, self._lost = np.zeros(AXES), np.zeros(AXES)
            self._state = "Idle"
            self._tell_stage(now)
            self.outbox.say("ok\r\n", now)
        elif self._state == "Hold:1" and self._hold_at and self._hold_at[1] <= now:
            assert self._segment is not None
            self._after_hold = self._segment.end
            self._position = self._hold_at[0]
            self._segment, self._hold_at = None, None
            self._state = "Hold:0"
            self._tell_stage(now)
        elif self._segment and self._state == "Run":
            self._position = self._segment.end
            self._segment = None
            self._state = "Idle"
            self._tell_stage(now)
        self._busy_until = self._busy_until if self._busy_until > now else 0.0
        self._work(now)

    def _alarm(self, number: int, now: float) -> None:
        self._freeze(now)
        self._state = "Alarm"
        self.outbox.say(f"ALARM:{number}\r\n", now)

    def _freeze(self, now: float) -> None:
        """Stop dead: the stage slides on, and its true position is known no more."""
        if self._segment is not None:
            self._position = self._where(now)
            slip = self._faults.random.uniform(-1, 1, AXES) * _LOST_STEPS_DEG
            self._lost = self._lost + np.where(self._segment.direction != 0, slip, 0.0)
        self._segment, self._hold_at, self._homing_ends = None, None, None
        self._accident = None
        self._queue.clear()
        self._tell_stage(now)

    def _crash(self, now: float) -> None:
        """A restart by itself: what is believed is 0, wherever the stage stands."""
        self._freeze(now)
        truth = self._position + self._lost
        self._restart()
        self._position, self._lost = np.zeros(AXES), truth
        self._tell_stage(now)
        self.outbox.clear()
        self._greet(now + _BOOT_S)

    def _greet(self, at: float) -> None:
        self.outbox.say(GREETING, at)
        if self._settings.homing:
            self._state = "Alarm"
        if self._state == "Alarm":
            self.outbox.say(LOCKED, at)

    # -- bytes -----------------------------------------------------------------------------------

    def _byte(self, byte: int, now: float) -> None:
        if byte == 0x18:
            self._soft_reset(now)
        elif byte == ord("?"):
            if self._state != "Home":  # as recorded: no report while homing
                self.outbox.say(self._status(now), now)
        elif byte == ord("!"):
            if self._state == "Run" and self._segment:
                self._hold_at = self._segment.stopped_by_hold(now)
                self._state = "Hold:1"
                self._accident = None
        elif byte == ord("~"):
            self._resume(now)
        elif byte in b"\r\n":
            self._waiting.append(self._text.decode("ascii", "replace"))
            self._text = b""
        elif len(self._text) < RECEIVE_BYTES:
            self._text += bytes([byte])

    def _soft_reset(self, now: float) -> None:
        moving = self._state in ("Run", "Hold:1")
        homing = self._state == "Home"
        locked = self._state == "Alarm"
        self._freeze(now)
        self._restart()
        self.outbox.clear()
        if moving or homing:
            self.outbox.say(f"ALARM:{6 if homing else 3}\r\n", now)
        self._state = "Alarm" if moving or homing or locked else "Idle"
        self.outbox.say(GREETING, now + _RESET_S)
        if self._state == "Alarm":
            self.outbox.say(LOCKED, now + _RESET_S)
        self._tell_stage(now)

    def _resume(self, now: float) -> None:
        if not self._state.startswith("Hold"):
            return
        self.outbox.say("[MSG:]\r\n", now)
        where, end = self._position, self._after_hold
        if self._state == "Hold:1" and self._hold_at and self._segment:
            where, end = self._hold_at[0], self._segment.end
        self._hold_at = self._after_hold = None
        self._state = "Idle"
        if end is not None:
            self._depart(where, end, self._modes.feed or np.inf, now)

    # -- lines -----------------------------------------------------------------------------------

    def _work(self, now: float) -> None:
        """Start what is queued and answer the lines that can be answered."""
        while True:
            if self._state == "Idle" and self._queue:
                end, feed = self._queue.popleft()
                self._depart(self._position, end, feed, now)
            if not self._waiting or self._critical or self._state == "Home":
                return
            if len(self._queue) >= PLANNER_BLOCKS or self._busy_until > now:
                return
            text = self._waiting[0]
            waits_for_rest = re.search(r"M\d|G0*4(?!\d)", text.upper()) or text.startswith("$H")
            if waits_for_rest and (self._segment or self._queue):
                return
            self._waiting.popleft()
            reply = self._line(text, now)
            if reply is not None:
                self.outbox.say(reply, now)

    def _line(self, text: str, now: float) -> str | None:
        if len(text) > _LINE_BYTES:
            return "error:11\r\n"
        text = re.sub(r"\([^)]*\)|;.*|\s", "", text).upper()
        if not text:
            return "ok\r\n"
        if text.startswith("$"):
            return self._system(text, now)
        if self._state == "Alarm":
            return "error:9\r\n"
        if not self._sticky:
            self._sticky = self._gcode(text, now)
        return f"error:{self._sticky}\r\n" if self._sticky else "ok\r\n"

    def _system(self, text: str, now: float) -> str | None:
        if text == "$X":
            self._sticky = 0
            if self._state != "Alarm":
                return "ok\r\n"
            self._state = "Idle"
            return "[MSG:Caution: Unlocked]\r\nok\r\n"
        if text == "$H":
            return self._home(now)
        return self._settings.answer(text)

    def _home(self, now: float) -> str | None:
        if not self._settings.homing:
            return "error:5\r\n"
        if self._state not in ("Idle", "Alarm"):
            return "error:8\r\n"
        self._state = "Home"
        truth = self._position + self._lost
        way = float((np.abs(truth) / self._settings.rates).max())
        self._homing_ends = (
            now + (way + _PULL_OFF_S if self._switches else _SEARCH_S),
            self._switches,
        )
        self._moved(None, truth, self._shutter_closed, now)
        return self._status(now)

    def _gcode(self, text: str, now: float) -> int:
        """Carry out a block; 0 or the number of its error."""
        block = read_block(text, self._modes)
        if isinstance(block, int):
            return block
        self._modes = block.modes
        if block.dwell_s is not None:
            self._busy_until = now + block.dwell_s
            return 0
        if block.shutter_closed is not None:
            self._shutter_closed = block.shutter_closed
            self._report.told_accessories = False
            self._tell_stage(now)
        if block.axes:
            self._move(block.axes, now)
        return 0

    def _move(self, axes: dict[str, float], now: float) -> None:
        last = self._queue[-1][0] if self._queue else self._position
        if self._segment and not self._queue:
            last = self._segment.end
        end = last.copy()
        for letter, value in axes.items():
            index = LETTERS.index(letter)
            end[index] = value + (0.0 if self._modes.absolute else last[index])
        self._queue.append((end, self._modes.feed if self._modes.motion == 1 else np.inf))
        if self._state == "Idle":
            self._depart(self._position, *self._queue.popleft(), now)

    def _depart(self, start: Floats, end: Floats, feed: float, now: float) -> None:
        self._position = start
        if np.array_equal(start, end):
            return
        settings = self._settings
        self._segment = planned(
            start, end, now, settings.rates, settings.accelerations, feed / 60.0
        )
        self._state = "Run"
        for fault in (Fault.ALARM, Fault.RESET, Fault.VANISH):
            if self._faults.strikes(fault):
                moment = now + self._faults.random.random() * self._segment.duration
                self._accident = (moment, fault)
                break
        self._tell_stage(now)

    # -- state -----------------------------------------------------------------------------------

    def _where(self, now: float) -> Floats:
        if self._segment is None:
            return self._position
        if self._state == "Hold:1" and self._hold_at:
            return self._hold_at[0] if now >= self._hold_at[1] else self._segment.position(now)
        return self._segment.position(now)

    def _status(self, now: float) -> str:
        speed = self._segment.along(now)[1] * 60 if self._segment else 0.0
        blocks = len(self._queue) + (self._segment is not None)
        return self._report.text(self._state, self._where(now), speed, blocks, self._shutter_closed)

    def _tell_stage(self, now: float) -> None:
        self._moved(self._segment, self._position + self._lost, self._shutter_closed, now)


def main(config: Path) -> None:
    """Run as a process; `config` is what `simulated_rig` wrote."""
    c = json.loads(config.read_text())
    began, scale, state = c["began_s"], c["time_scale"], Path(c["stage"])

    def moved(segment: Segment | None, truth: Floats, shutter_closed: bool, now: float) -> None:
        start, end, ends = truth, truth, now
        if segment is not None:  # truth is that of the departure
            end = truth + (segment.end - segment.start)
            ends = now + segment.duration
        moments = began + now / scale, began + ends / scale
        write_stage(state, Stage(tuple(start), tuple(end), *moments, shutter_closed))

    faults = FaultPlan(
        {Fault(name): chance for name, chance in c["faults"].items()},
        c["seed"],
        Path(c["fault_log"]),
    )
    settings = {int(number): value for number, value in c["settings"].items()}
    controller = GrblController(faults, settings, moved=moved)
    serve(controller, Path(c["link"]), faults, scale, began)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
