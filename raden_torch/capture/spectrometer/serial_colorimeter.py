"""What colorimeters on a serial line share: opening, reopening and closing the line."""

from __future__ import annotations

from abc import abstractmethod

from raden_torch.capture.spectrometer.ports import Colorimeter
from raden_torch.capture.spectrometer.rig import ColorimeterSettings
from raden_torch.capture.spectrometer.serial_line import LineSettings, SerialLine, reopen


class SerialColorimeter(Colorimeter):
    """A `Colorimeter` on a serial line; a driver adds `_connect`, `measure` and `status`.

    Raises:
        ConnectionLostError: the port cannot be opened, or what answers is another device.
    """

    def __init__(self, settings: ColorimeterSettings, line: LineSettings) -> None:
        self._settings = settings
        self._line = SerialLine(line)
        try:
            self._connect()
        except BaseException:
            self._line.close()
            raise

    @abstractmethod
    def _connect(self) -> None:
        """See that it is the instrument, take control of it, and set `identity`."""

    def reconnect(self) -> None:
        reopen(self._line, self._settings.connect_timeout_s)
        self._connect()

    def close(self) -> None:
        self._line.close()

    @property
    def _name(self) -> str:
        return self._settings.port
