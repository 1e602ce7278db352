"""Konica Minolta CS-100A: a tristimulus colorimeter.

Source of the protocol: a summary of the instrument's commands, and public programs for it. Written
without its manual and without an instrument at hand. 4800 baud, 7 data bits, even parity, 2 stop
bits; it drops commands that come within 0.1 s of the last reply.
"""

from __future__ import annotations

import math
import time

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import (
    ColorReading,
    ConnectionLostError,
    InstrumentError,
    Range,
)
from raden_torch.capture.spectrometer.rig import ColorimeterSettings
from raden_torch.capture.spectrometer.serial_colorimeter import SerialColorimeter
from raden_torch.capture.spectrometer.serial_line import LineSettings

_PAUSE_S = 0.1
_ATTEMPTS = 3
_LARGEST = 1e7  # cd/m²
_OVER = ("ER10", "OK12", "ER12", "ER19")
_UNDER = ("OK11", "OK13")
_ERRORS = {
    "ER00": "it does not know the command",
    "ER01": "a setting is wrong",
    "ER11": "a value in its memory is wrong",
    "ER20": "its memory is faulty",
    "ER30": "its battery is empty",
}


class Cs100a(SerialColorimeter):
    """`Colorimeter` over a CS-100A in absolute mode.

    Raises:
        ConnectionLostError: the port cannot be opened, or what answers is no CS-100A.
    """

    def __init__(self, settings: ColorimeterSettings) -> None:
        super().__init__(
            settings, LineSettings(settings.port, settings.baud or 4800, 7, "E", stop_bits=2)
        )

    def measure(self) -> ColorReading:
        for _ in range(_ATTEMPTS):
            code, *fields = self._ask("MES")
            if code in _OVER:
                return ColorReading(np.full(3, np.nan), Range.OVER)
            if code in _UNDER:
                return ColorReading(np.full(3, np.nan), Range.UNDER)
            if code != "OK00":
                raise InstrumentError(f"{self._name}: measuring failed: {_meaning(code)}")
            xyz = _xyz(fields)
            if xyz is not None:
                return ColorReading(xyz)
        raise ConnectionLostError(
            f"{self._name}: 'MES' was answered {_ATTEMPTS} times with something else than Y, x, y; "
            "check the cable and the baud rate"
        )

    def status(self) -> str:
        return f"{self.identity}: absolute mode"

    # -- the conversation ----------------------------------------------------------------------

    def _connect(self) -> None:
        self.identity = "Konica Minolta CS-100A"
        code = ""
        for command in ("MDS,04", "CLE"):  # absolute mode; forget earlier errors
            for _ in range(_ATTEMPTS):
                try:
                    code = self._ask(command)[0]
                except ConnectionLostError:
                    code = ""
                if code == "OK00":
                    break
            else:
                raise ConnectionLostError(
                    f"{self._name}: no CS-100A answered at {self._line.settings.baud} baud 7E2"
                    + (f" ({_meaning(code)})" if code else "")
                    + "; check the port, and that it was switched on with F held down"
                )

    def _ask(self, command: str) -> list[str]:
        time.sleep(_PAUSE_S)
        self._line.discard_received()
        self._line.send(command.encode("ascii") + b"\r\n")
        deadline = time.monotonic() + self._settings.reply_timeout_s
        while (line := self._line.read_line(deadline - time.monotonic())) is not None:
            fields = [field.strip() for field in line.split(",")]
            if fields[0] in ("OK00", *_OVER, *_UNDER, *_ERRORS):
                return fields
        raise ConnectionLostError(
            f"{self._name}: no reply to {command!r} within {self._settings.reply_timeout_s:g} s"
        )


def _xyz(fields: list[str]) -> Floats | None:
    """X = Y x/y, Z = Y (1 − x − y)/y (CIE 015); None where the three are no colour."""
    try:
        luminance, x, y = (float(field.replace(" ", "")) for field in fields)
    except ValueError:
        return None
    sensible = all(map(math.isfinite, (luminance, x, y))) and 0 <= luminance < _LARGEST
    if not sensible or not (0 <= x <= 1 and 0 < y <= 1):
        return None
    return np.array([x, y, 1 - x - y]) * luminance / y


def _meaning(code: str) -> str:
    return f"{code}, {_ERRORS[code]}" if code in _ERRORS else code
