"""Konica Minolta CS-2000 and CS-2000A: spectroradiometers, 380…780 nm.

Source of the protocol: a summary of the maker's communication specification, and public programs
for the instrument, which agree on the commands used here; the meaning of the fields of `IDDR` and
`MEDR,0,0,1` is theirs. Written without the specification itself and without an instrument at hand.
"""

from __future__ import annotations

import math
import re
import time
from contextlib import suppress

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.ports import (
    ColorReading,
    ConnectionLostError,
    InstrumentBusyError,
    InstrumentError,
    Range,
)
from raden_torch.capture.spectrometer.rig import ColorimeterSettings
from raden_torch.capture.spectrometer.serial_colorimeter import SerialColorimeter
from raden_torch.capture.spectrometer.serial_line import LineSettings
from raden_torch.capture.spectrometer.spectrum import xyz_of

WAVELENGTHS_NM = np.arange(380.0, 781.0)
PARTS = ((1, 100), (2, 100), (3, 100), (4, 101))
"""`MEDR,1,0,n` gives this many values."""

_LONGEST_MEASUREMENT_S = 242
_NOT_COMPUTED = -9.9e9  # the instrument writes -9.9999e+9
_LARGEST = 1e9  # cd/m² or W/(sr·m²·nm): beyond this a number is garbled
_ATTEMPTS = 3
_CANCEL_S = 2.0
_SPECTRUM_TOLERANCE = 0.02
_SPECTRUM_FLOOR = 0.01  # cd/m²; below, five digits and the dark noise decide
_ERRORS = {
    "ER00": "it does not know the command",
    "ER02": "it is busy measuring",
    "ER10": "the light is over its range",
    "ER17": "a parameter is wrong",
    "ER20": "it has no data",
    "ER30": "its memory is faulty",
    "ER32": "its memory is faulty",
    "ER34": "its memory is faulty",
    "ER51": "its temperature is out of range",
    "ER52": "its temperature is out of range",
    "ER71": "it cannot synchronise to the light",
    "ER81": "its shutter is stuck",
    "ER82": "its filter wheel is stuck",
    "ER83": "its aperture is stuck",
    "ER84": "its filter is stuck",
    "ER99": "an error of its own",
}


class Cs2000(SerialColorimeter):
    """`Colorimeter` over a CS-2000; in remote control from when it is made until `close`.

    XYZ is computed from the spectrum where `settings.spectrum` is on, and compared with the
    instrument's own.

    Raises:
        ConnectionLostError: the port cannot be opened, or what answers is no CS-2000.
    """

    def __init__(self, settings: ColorimeterSettings) -> None:
        super().__init__(
            settings, LineSettings(settings.port, settings.baud or 115200, rtscts=True)
        )

    def measure(self) -> ColorReading:
        code = self._run()
        if code == "ER10":
            return ColorReading(np.full(3, np.nan), Range.OVER)
        self._check(code, "MEAS,1")
        integration_s = self._integration_s()
        own = self._numbers("MEDR,2,0,1", 3)
        if (own <= _NOT_COMPUTED).any():
            return ColorReading(np.full(3, np.nan), Range.UNDER, integration_s)
        if not self._settings.spectrum:
            return ColorReading(own, Range.OK, integration_s)
        radiance = self._spectrum_that_agrees_with(own)
        xyz = xyz_of(radiance, WAVELENGTHS_NM)
        return ColorReading(xyz, Range.OK, integration_s, WAVELENGTHS_NM, radiance)

    def status(self) -> str:
        try:
            speed, sync, _, nd_filter, *_ = self._fields("MEDR,0,0,1")
        except (InstrumentError, ValueError):
            return f"{self.identity}: remote control is on, nothing measured yet"
        return f"{self.identity}: speed mode {speed}, sync mode {sync}, internal ND {nd_filter}"

    def close(self) -> None:
        with suppress(InstrumentError):  # a line that is gone cannot be given back in order
            self._line.send(b"RMTS,0\r\n")
            self._line.read_line(1.0)
        super().close()

    # -- the conversation ----------------------------------------------------------------------

    def _connect(self) -> None:
        deadline = time.monotonic() + self._settings.connect_timeout_s
        heard = ""
        while True:
            reply = self._ask("RMTS,1", min(2.0, self._settings.reply_timeout_s)) or ""
            if reply[:4] == "OK00":
                break
            heard = reply or heard
            if reply[:4] == "ER02":  # measuring for a program that is gone
                self._ask("MEAS,0", _CANCEL_S)
            if time.monotonic() > deadline:
                raise ConnectionLostError(
                    f"{self._name}: no CS-2000 answered at {self._line.settings.baud} baud"
                    + (f", but something said {heard[:40]!r}" if heard else "")
                    + "; check the port, the baud rate and that it is switched on"
                )
        self._line.drain(0.02)
        self.identity = self._read_identity()

    def _read_identity(self) -> str:
        fields: list[str] = []
        for _ in range(_ATTEMPTS):  # a bare OK00 was for a command of a program that was killed
            try:
                fields = self._fields("IDDR")
            except ConnectionLostError:
                raise
            except InstrumentError:  # still measuring for it, where the OK00 was taken for RMTS's
                self._ask("MEAS,0", _CANCEL_S)
                continue
            if len(fields) >= 3 and all(map(str.isascii, fields)):
                break
        name, variation, number, *_ = [*(field.strip() for field in fields), "", "", ""]
        model = {"1": "CS-2000", "2": "CS-2000A"}.get(variation, name or "CS-2000")
        return f"Konica Minolta {model}" + (f", serial number {number}" if number else "")

    def _run(self) -> str:
        """Measure once: how it ended. Where replies were garbled, it is cancelled and repeated."""
        for _ in range(_ATTEMPTS):
            code = self._measured()
            if code is not None:
                return code
            self._ask("MEAS,0", _CANCEL_S)
        raise ConnectionLostError(
            f"{self._name}: 'MEAS,1' was answered {_ATTEMPTS} times with something else than OK00 "
            "or an error; check the cable and the baud rate"
        )

    def _measured(self) -> str | None:
        """`MEAS,1` and its two replies: `OK00` or an error; None where they were garbled.

        The first, `OK00,nnn`, comes 1…10 s late and announces how many seconds remain until the
        second.
        """
        self._line.discard_received()
        self._line.send(b"MEAS,1\r\n")
        deadline = time.monotonic() + self._settings.reply_timeout_s
        announced = garbled = False
        while (line := self._line.read_line(deadline - time.monotonic())) is not None:
            announcement = re.fullmatch(r"OK00, *(\d{1,3})", line)
            if announcement:
                announced = True
                seconds = min(int(announcement[1]), _LONGEST_MEASUREMENT_S)
                deadline = time.monotonic() + seconds + self._settings.reply_timeout_s
            elif line == "OK00" and not (announced or garbled):
                continue  # of an earlier command, late
            elif line == "OK00" or line[:4] in _ERRORS:
                return line[:4]
            else:  # noise, or the reply itself
                garbled = True
                deadline = time.monotonic() + self._grace_s
        if garbled:
            return None
        self._ask("MEAS,0", _CANCEL_S)
        raise ConnectionLostError(f"{self._name}: no reply in time to 'MEAS,1'")

    def _integration_s(self) -> float | None:
        """The third field of the measuring conditions, in microseconds."""
        try:
            microseconds = float(self._fields("MEDR,0,0,1")[2])
        except (IndexError, ValueError):
            return None
        return microseconds * 1e-6 if 0 < microseconds < 1e9 else None

    def _spectrum_that_agrees_with(self, own: Floats) -> Floats:
        """The spectrum, read again where its XYZ is not the instrument's: a garbled digit."""
        for _ in range(_ATTEMPTS):
            radiance = np.concatenate([self._numbers(f"MEDR,1,0,{n}", k) for n, k in PARTS])
            away = np.abs(xyz_of(radiance, WAVELENGTHS_NM) - own).max()
            scale = np.abs(own).max()
            if away <= _SPECTRUM_TOLERANCE * scale + _SPECTRUM_FLOOR:
                return radiance
            own = self._numbers("MEDR,2,0,1", 3)
        raise InstrumentError(
            f"{self._name}: the XYZ of its spectrum is {100 * away / scale:.0f} % off its own XYZ; "
            "check the instrument, or set spectrum = false to take its XYZ alone"
        )

    def _numbers(self, command: str, count: int) -> Floats:
        """`count` finite numbers of a stored result; a garbled reply is asked for again."""
        for _ in range(_ATTEMPTS):
            fields = self._fields(command)
            try:
                values = [float(field) for field in fields]
            except ValueError:
                continue
            plausible = all(math.isfinite(v) and v < _LARGEST for v in values)
            if len(values) == count and plausible:
                return np.array(values)
        raise ConnectionLostError(
            f"{self._name}: {command!r} was answered {_ATTEMPTS} times with something else than "
            f"{count} numbers; check the cable and the baud rate"
        )

    def _fields(self, command: str) -> list[str]:
        """The comma-separated values after `OK00`."""
        code = ""
        for _ in range(_ATTEMPTS):
            reply = self._ask(command, self._settings.reply_timeout_s)
            if reply is None:
                break
            code, *fields = reply.split(",")
            if code == "OK00":
                return fields
            if code in _ERRORS:
                self._check(code, command)
        raise ConnectionLostError(
            f"{self._name}: no reply to {command!r}"
            + (f" but {code[:20]!r}; check the cable and the baud rate" if code else "")
        )

    def _ask(self, command: str, timeout_s: float) -> str | None:
        """Send a command and take the next line that can be a reply; after a grace, any line."""
        self._line.discard_received()
        self._line.send(command.encode("ascii") + b"\r\n")
        deadline = time.monotonic() + timeout_s
        first = None
        while (line := self._line.read_line(deadline - time.monotonic())) is not None:
            if line[:4] == "OK00" or line[:4] in _ERRORS:
                return line
            first = first or line
            deadline = min(deadline, time.monotonic() + self._grace_s)
        return first

    def _check(self, code: str, command: str) -> None:
        if code == "OK00":
            return
        if code not in _ERRORS:
            raise ConnectionLostError(
                f"{self._name}: {command!r} was answered {code[:20]!r}; check the cable"
            )
        kind = InstrumentBusyError if code == "ER02" else InstrumentError
        raise kind(f"{self._name}: {command!r} was answered {code}: {_ERRORS[code]}")

    @property
    def _grace_s(self) -> float:
        """How much longer to wait after a garbled line, which may have been the reply."""
        return self._settings.reply_timeout_s / 10
