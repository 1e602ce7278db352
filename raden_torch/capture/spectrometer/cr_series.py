"""Colorimetry Research CR series (CR-100, CR-250, CR-300 …): XYZ.

Source of the protocol: the commands that public programs for these instruments use; the maker gives
its command reference to customers. Written without an instrument at hand. A reply is
`OK:code:command:value` or `ER:code:command:text`. Spectra (`RM Spectrum`) are left out: their
layout differs between the models.
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

_LONGEST_MEASUREMENT_S = 120.0
_LARGEST = 1e9  # cd/m²
_ATTEMPTS = 3
_TOO_DARK = ("-304", "-305", "100")
_TOO_BRIGHT = ("-306",)
_COMMAND_PAUSE_S = 0.05  # the instrument drops a command that follows the last one sooner


class CrSeries(SerialColorimeter):
    """`Colorimeter` over a CR instrument, with its own choice of exposure.

    Raises:
        ConnectionLostError: the port cannot be opened, or what answers is no CR instrument.
    """

    def __init__(self, settings: ColorimeterSettings) -> None:
        self._last_command = 0.0
        super().__init__(settings, LineSettings(settings.port, settings.baud or 115200))

    def measure(self) -> ColorReading:
        code, text = self._ask("M", _LONGEST_MEASUREMENT_S)
        if code in _TOO_DARK:
            return ColorReading(np.full(3, np.nan), Range.UNDER)
        if code in _TOO_BRIGHT:
            return ColorReading(np.full(3, np.nan), Range.OVER)
        if code != "0":
            raise InstrumentError(f"{self._name}: measuring failed with {code}: {text[:60]}")
        return ColorReading(self._xyz(), Range.OK)

    def status(self) -> str:
        return f"{self.identity}: {self._value('RS ExposureMode')} exposure"

    # -- the conversation ----------------------------------------------------------------------

    def _connect(self) -> None:
        code, kind, limit = "", "", self._settings.reply_timeout_s
        for _ in range(_ATTEMPTS):
            try:
                code, kind = self._ask("RC InstrumentType", min(2.0, limit))
                break
            except ConnectionLostError as error:
                reason = error
        else:
            raise ConnectionLostError(
                f"{self._name}: no CR instrument answered at {self._line.settings.baud} baud; "
                f"check the port, the baud rate and the power ({reason})"
            )
        kinds = {"0": "photometer", "1": "colorimeter", "2": "spectroradiometer"}
        name = kinds.get(kind.strip(), "instrument of a kind unknown here")
        if code != "0" or name == "photometer":
            raise InstrumentError(
                f"{self._name}: expected a colorimeter that measures XYZ, got a CR {name}"
            )
        model, number = self._value("RC Model"), self._value("RC ID")
        firmware = self._value("RC Firmware")
        self.identity = f"Colorimetry Research {model} {name}, {number}, firmware {firmware}"

    def _xyz(self) -> Floats:
        for _ in range(_ATTEMPTS):
            code, text = self._ask("RM XYZ", self._settings.reply_timeout_s)
            try:
                values = [float(word) for word in text.split(",")]
            except ValueError:
                continue
            if code == "0" and len(values) == 3 and all(_plausible(v) for v in values):
                return np.array(values)
        raise ConnectionLostError(
            f"{self._name}: 'RM XYZ' was answered {_ATTEMPTS} times with something else than three "
            "numbers; check the cable and the baud rate"
        )

    def _value(self, command: str) -> str:
        code, text = self._ask(command, self._settings.reply_timeout_s)
        return text.strip() if code == "0" else "(not told)"

    def _ask(self, command: str, timeout_s: float) -> tuple[str, str]:
        """Code and value of the reply. The instrument may echo the command first (`E` toggles)."""
        time.sleep(max(0.0, self._last_command + _COMMAND_PAUSE_S - time.monotonic()))
        self._line.discard_received()
        self._line.send(command.encode("ascii") + b"\r\n")
        self._last_command = time.monotonic()
        deadline = self._last_command + timeout_s
        while (line := self._line.read_line(deadline - time.monotonic())) is not None:
            kind, code, about, text = [*line.split(":", 3), "", "", ""][:4]
            if kind in ("OK", "ER") and about == command:
                return code.strip(), text
        raise ConnectionLostError(f"{self._name}: no reply to {command!r} within {timeout_s:g} s")


def _plausible(value: float) -> bool:
    return math.isfinite(value) and abs(value) < _LARGEST
