"""Lines of text over a serial port, with every wait bounded.

What arrives is untrusted. pyserial's own `readline` can outlast its timeout while data keeps
coming, a read that times out returns what it has, and a pulled cable may raise `SerialException`,
`OSError` or return nothing for ever: hence one deadline loop and framing of our own.
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from raden_torch.capture.spectrometer.ports import ConnectionLostError
from raden_torch.packages import require

if TYPE_CHECKING:
    import serial

MAX_LINE_BYTES = 8192
"""More without a line end is not an instrument of ours; the longest reply has 1,300."""
MAX_UNASKED_BYTES = 1_000_000
"""More than this after one request is an endless reply."""

_READ_TIMEOUT_S = 0.02  # how long one read may block: no deadline is missed by more
_WRITE_TIMEOUT_S = 2.0
_NOISE = bytes([*range(0x21), *range(0x7F, 0x100)])  # what no line of an instrument begins with

# SerialException is an OSError; TypeError and ValueError are pyserial's on a port closed meanwhile
_PORT_ERRORS: tuple[type[Exception], ...] = (OSError, TypeError, ValueError)
if sys.platform != "win32":
    import termios

    _PORT_ERRORS += (termios.error,)


@dataclass(frozen=True, slots=True)
class LineSettings:
    """How to open a port: `port` is a device, a pty's path or a URL of pyserial."""

    port: str
    baud: int = 115200
    data_bits: int = 8
    parity: str = "N"
    stop_bits: int = 1
    rtscts: bool = False


class SerialLine:
    """An open port that sends bytes and receives lines. Lines may end in CR, LF or both.

    Every method may raise ConnectionLostError.
    """

    def __init__(self, settings: LineSettings) -> None:
        self.settings = settings
        self._port: serial.Serial | None = None
        self._buffer = bytearray()
        self._bytes_since_send = 0
        self.open()

    def open(self) -> None:
        """Open the port, closing it first where it is open."""
        require("instruments on serial lines", "spectrometer")
        import serial

        self.close()
        s = self.settings
        try:
            port = serial.serial_for_url(s.port, do_not_open=True)
            port.baudrate, port.bytesize, port.parity = s.baud, s.data_bits, s.parity
            port.stopbits, port.rtscts = s.stop_bits, s.rtscts
            port.timeout, port.write_timeout = _READ_TIMEOUT_S, _WRITE_TIMEOUT_S
            if "://" not in s.port:
                port.exclusive = True  # two programs on one line would eat each other's replies
            port.open()
        except _PORT_ERRORS as error:
            raise ConnectionLostError(
                f"{s.port}: cannot be opened ({_first_line(error)}); check the port, the cable and "
                "that no other program uses it"
            ) from None
        self._port = port
        self._buffer.clear()
        self._bytes_since_send = 0

    def close(self) -> None:
        """Close the port; never raises."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(*_PORT_ERRORS):  # a vanished device cannot be closed in order
                port.close()

    def send(self, data: bytes) -> None:
        try:
            self._open_port().write(data)
        except _PORT_ERRORS as error:
            raise self._lost(error) from None
        self._bytes_since_send = 0

    def read_line(self, timeout_s: float) -> str | None:
        """The next line without its end; None where none is complete within the time.

        Empty lines are skipped; half a line stays for the next call. Noise before a line is
        dropped; within it, bytes that are not ASCII come as "\\ufffd", so that no number closes
        over a gap.
        """
        if timeout_s < 0:
            return None  # a deadline that has passed, whatever else may have come
        deadline = time.monotonic() + timeout_s
        while (line := self._take_line()) is None:
            left = deadline - time.monotonic()
            self._receive(max(left, 0.0))
            if left <= 0:
                return self._take_line()
        return line

    def drain(self, quiet_s: float, at_most_s: float = 2.0) -> bytes:
        """Discard what has arrived, until nothing came for `quiet_s`; return its first bytes."""
        dropped = bytes(self._buffer[:64])
        self._buffer.clear()
        now = time.monotonic()
        end, silent_since = now + at_most_s, now
        while now < end and now - silent_since < quiet_s:
            if self._receive(min(quiet_s, end - now)):
                silent_since = time.monotonic()
                dropped = (dropped + bytes(self._buffer[:64]))[:64]
                self._buffer.clear()
            now = time.monotonic()
        return dropped

    def discard_received(self) -> None:
        """Discard what has arrived so far, without waiting."""
        self._buffer.clear()
        port = self._open_port()
        try:
            port.read(min(port.in_waiting, MAX_UNASKED_BYTES))
        except _PORT_ERRORS as error:
            raise self._lost(error) from None

    def _take_line(self) -> str | None:
        while self._buffer:
            ends = [i for i in (self._buffer.find(b"\n"), self._buffer.find(b"\r")) if i >= 0]
            if not ends:
                return None
            raw = bytes(self._buffer[: min(ends)])
            del self._buffer[: min(ends) + 1]
            text = raw.lstrip(_NOISE).rstrip(b"\0 \t").decode("ascii", "replace")
            if text:
                return text
        return None

    def _receive(self, at_most_s: float) -> int:
        """Wait for bytes, `at_most_s` or one read timeout, whichever is shorter; how many came."""
        port = self._open_port()
        asked = time.monotonic()
        try:
            waiting = port.in_waiting
            if not waiting and at_most_s < _READ_TIMEOUT_S:
                time.sleep(min(at_most_s, 0.001))
                waiting = port.in_waiting
                if not waiting:
                    return 0
            data = port.read(max(1, min(waiting, MAX_LINE_BYTES)))
        except _PORT_ERRORS as error:
            raise self._lost(error) from None
        if not data and time.monotonic() - asked < _READ_TIMEOUT_S / 4:
            time.sleep(min(at_most_s, _READ_TIMEOUT_S))  # a port that returns nothing at once
        self._bytes_since_send += len(data)
        if self._bytes_since_send > MAX_UNASKED_BYTES:
            raise ConnectionLostError(
                f"{self.settings.port}: over {MAX_UNASKED_BYTES} bytes came that nobody asked for; "
                "another device is on this port, or the baud rate is wrong"
            )
        self._buffer += data
        tail = len(self._buffer) - 1 - max(self._buffer.rfind(b"\n"), self._buffer.rfind(b"\r"))
        if tail > MAX_LINE_BYTES:
            start = bytes(self._buffer[-tail:][:24])
            self._buffer.clear()
            raise ConnectionLostError(
                f"{self.settings.port}: no line end in {tail} bytes (they begin {start!r}); "
                "another device is on this port, or the baud rate is wrong"
            )
        return len(data)

    def _open_port(self) -> serial.Serial:
        if self._port is None:
            raise ConnectionLostError(f"{self.settings.port}: the port is closed; reconnect")
        return self._port

    def _lost(self, error: Exception) -> ConnectionLostError:
        return ConnectionLostError(
            f"{self.settings.port}: the connection is lost ({_first_line(error)}); check the cable"
        )


def reopen(line: SerialLine, within_s: float) -> None:
    """Open the line again, trying until the port is back, for at most `within_s`."""
    end = time.monotonic() + within_s
    while True:
        try:
            return line.open()
        except ConnectionLostError:
            if time.monotonic() >= end:
                raise
            time.sleep(min(0.1, within_s / 20))


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
