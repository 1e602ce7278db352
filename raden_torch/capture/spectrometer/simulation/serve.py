"""One simulated instrument as a process: its pty, its clock, and the faults of its line."""

from __future__ import annotations

import heapq
import sys
import time
from pathlib import Path
from typing import Protocol

from raden_torch.capture.spectrometer.simulation.faults import Fault, FaultPlan
from raden_torch.capture.spectrometer.simulation.pty_port import PtyPort

_LATE_S = (0.3, 3.0)  # within the 10 s that the CS-2000 may take
_PIECES_APART_S = (0.01, 0.3)
_AWAY_S = (1.0, 10.0)
_LEAST_AWAY_REAL_S = 0.05  # or a fast clock would bring it back before anyone noticed
_LONGEST_WAIT_REAL_S = 0.5


class Outbox:
    """What an instrument will say, and when (simulated seconds)."""

    def __init__(self) -> None:
        self._queue: list[tuple[float, int, bytes]] = []
        self._count = 0

    def say(self, data: str | bytes, at: float) -> None:
        data = data.encode("ascii") if isinstance(data, str) else data
        heapq.heappush(self._queue, (at, self._count, data))
        self._count += 1

    def clear(self) -> None:
        self._queue.clear()

    def due(self, now: float) -> bytes | None:
        return heapq.heappop(self._queue)[2] if self._queue and self._queue[0][0] <= now else None

    @property
    def next_at(self) -> float | None:
        return self._queue[0][0] if self._queue else None


class Instrument(Protocol):
    """A simulated instrument: bytes in, an outbox of bytes, and a clock of its own events."""

    outbox: Outbox
    wants_to_vanish: bool

    def receive(self, data: bytes, now: float) -> None: ...
    def advance(self, now: float) -> None: ...
    def next_event(self) -> float | None: ...
    def plugged_in(self, now: float) -> None: ...


def serve(
    instrument: Instrument, link: Path, faults: FaultPlan, time_scale: float, began: float
) -> None:
    """Run until standard input closes: the process that started this one has ended.

    Args:
        began: the monotonic moment at which the simulated clock stood at 0.
    """
    port = PtyPort(link)
    line = _Line(port, faults)
    back_at = 0.0
    parent = sys.stdin.fileno()  # nothing is ever written to it: readable means closed
    try:
        while True:
            now = (time.monotonic() - began) * time_scale
            if not port.present and now >= back_at:
                port.appear()
                instrument.plugged_in(now)
            instrument.advance(now)
            while (message := instrument.outbox.due(now)) is not None:
                line.say(message, now)
            line.flush(now)
            if instrument.wants_to_vanish:
                instrument.wants_to_vanish = False
                line.drop()
                port.vanish()
                away = faults.random.uniform(*_AWAY_S)
                back_at = now + max(away, _LEAST_AWAY_REAL_S * time_scale)
            moments = [instrument.next_event(), instrument.outbox.next_at, line.next_at]
            moments += [] if port.present else [back_at]
            wait = min((m - now for m in moments if m is not None), default=float("inf"))
            data, ended = port.receive(min(wait / time_scale, _LONGEST_WAIT_REAL_S), parent)
            if ended:
                return
            if data:
                instrument.receive(data, (time.monotonic() - began) * time_scale)
    finally:
        port.vanish()


class _Line:
    """What happens to messages on their way: in order, but late, in pieces, or with noise."""

    def __init__(self, port: PtyPort, faults: FaultPlan) -> None:
        self._port, self._faults = port, faults
        self._pieces: list[tuple[float, bytes]] = []

    @property
    def next_at(self) -> float | None:
        return self._pieces[0][0] if self._pieces else None

    def say(self, message: bytes, now: float) -> None:
        random = self._faults.random
        at = max([now, *(moment for moment, _ in self._pieces[-1:])])
        if self._faults.strikes(Fault.LATE):
            at += random.uniform(*_LATE_S)
        if self._faults.strikes(Fault.GARBAGE):
            noise = bytes(random.integers(0x80, 0x100, random.integers(1, 6), dtype="uint8"))
            noise += b"\r\n" if random.random() < 0.3 else b""
            where = int(random.integers(0, len(message))) if random.random() < 0.5 else 0
            message = message[:where] + noise + message[where:]
        if len(message) > 1 and self._faults.strikes(Fault.SPLIT):
            cut = int(random.integers(1, len(message)))
            self._pieces.append((at, message[:cut]))
            at, message = at + random.uniform(*_PIECES_APART_S), message[cut:]
        self._pieces.append((at, message))

    def flush(self, now: float) -> None:
        ready = b""
        while self._pieces and self._pieces[0][0] <= now:
            ready += self._pieces.pop(0)[1]
        if ready:
            self._port.send(ready)

    def drop(self) -> None:
        self._pieces.clear()
