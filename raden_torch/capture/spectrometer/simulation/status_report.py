"""What the simulated controller answers to `?`."""

from __future__ import annotations

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.simulation.stage import AXES

PLANNER_BLOCKS = 100
RECEIVE_BYTES = 1023

_OFFSETS_EVERY = 10  # reports; the work offsets are told in the second of them


class StatusReport:
    """Successive reports: overrides and accessories are told when they are new, offsets now and
    then."""

    def __init__(self) -> None:
        self.told_accessories = False
        self._count = 0

    def text(
        self, state: str, position: Floats, speed: float, blocks: int, shutter_closed: bool
    ) -> str:
        """The next one.

        Args:
            position: `[AXES]`, of the machine.
            speed: units per minute.
            blocks: how many of the planner are taken.
        """
        fields = [
            state,
            "MPos:" + ",".join(f"{value:.3f}" for value in position + 0.0),  # −0 becomes 0
            f"Bf:{PLANNER_BLOCKS - blocks},{RECEIVE_BYTES}",
            f"FS:{speed:.0f},0",
        ]
        if not self.told_accessories:
            self.told_accessories = True
            fields += ["Ov:100,100,100", f"A:{'F' if shutter_closed else ''}"]
        elif self._count % _OFFSETS_EVERY == 1:
            fields.append("WCO:" + ",".join(["0.000"] * AXES))
        self._count += 1
        return f"<{'|'.join(fields)}>\r\n"
