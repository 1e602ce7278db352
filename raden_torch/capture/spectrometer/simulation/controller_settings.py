"""What the recorded grblHAL controller says of itself: its build, and its settings."""

from __future__ import annotations

import re

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.simulation.stage import AXES

BUILD_INFO = (
    "[VER:1.1f.simulated:]",
    "[OPT:VNML+,100,1024,6,0]",
    "[AXS:6:XYZABC]",
    "[NEWOPT:ENUMS,RT+,TC,SED]",
    "[FIRMWARE:grblHAL]",
    "[SIGNALS:D]",
    "[NVS STORAGE:*EEPROM]",
    "[DRIVER:raden_torch simulation]",
    "[DRIVER VERSION:1]",
)
"""The lines of its answer to `$I`."""

DEFAULT_SETTINGS: dict[int, str] = {
    **dict.fromkeys((2, 3, 5, 6, 13, 14, 15, 17, 18, 19, 20, 21, 22, 23), "0"),
    **{0: "5.0", 1: "25", 4: "63", 9: "1", 10: "511", 11: "0.010", 12: "0.002"},
    **{24: "25.0", 25: "500.0", 26: "250", 27: "1.000", 28: "0.100", 29: "0.0"},
    **{30: "1000.000", 31: "0.000", 32: "0", 33: "5000.0", 34: "0.0", 35: "0.0", 36: "100.0"},
    **{37: "0", 39: "1", 40: "0", 41: "0", 42: "2", 43: "1", 44: "4", 45: "3"},
    **dict.fromkeys((46, 47, 48, 49, 60, 61, 62, 64, 65), "0"),
    **{56: "5.0", 57: "100.0", 58: "-5.0", 59: "500.0", 63: "3"},
    **{n: "250.00000" for n in range(100, 106)},
    **{n: "500.000" for n in range(110, 116)},
    **{n: "10.000" for n in range(120, 126)},
    **{n: "200.000" for n in range(130, 136)},
    **{341: "0", 342: "30.0", 343: "25.0", 344: "200.0", 345: "200.0", 346: "1", 376: "7"},
    **{384: "0", 392: "4.0", 393: "1.0", 394: "0.0", 398: "100"},
    **{481: "0", 485: "0", 486: "0", 538: "0", 539: "0.0", 673: "0.0", 676: "15"},
    **{680: "0", 701: "0"},
}
"""The settings that the recorded controller lists, with its values."""


class ControllerSettings:
    """The settings of one controller, and what it answers when it is asked for them.

    Args:
        changes: to `DEFAULT_SETTINGS`.
    """

    def __init__(self, changes: dict[int, str]) -> None:
        self._values = DEFAULT_SETTINGS | changes

    @property
    def homing(self) -> bool:
        """Whether the axes can be homed; they are locked after power-up then."""
        return self._values[22] != "0"

    @property
    def rates(self) -> Floats:
        """`[AXES]`, units per second: the most that each axis does."""
        return np.array([float(self._values[110 + i]) for i in range(AXES)]) / 60.0

    @property
    def accelerations(self) -> Floats:
        """`[AXES]`, units per second squared."""
        return np.array([float(self._values[120 + i]) for i in range(AXES)])

    def answer(self, text: str) -> str:
        """To `$I`, `$$` or `$number=value`, which changes a setting."""
        if text == "$I":
            return "\r\n".join((*BUILD_INFO, "ok\r\n"))
        if text == "$$":
            return "".join(f"${n}={v}\r\n" for n, v in sorted(self._values.items())) + "ok\r\n"
        setting = re.fullmatch(r"\$(\d+)=(-?[\d.]+)", text)
        if setting is None:
            return "error:3\r\n"
        if int(setting[1]) not in self._values:
            return "error:53\r\n"
        self._values[int(setting[1])] = setting[2]
        return "ok\r\n"
