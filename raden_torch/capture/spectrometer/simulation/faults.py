"""What can go wrong on a simulated line, and when: seeded, and written down as it happens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from enum import Enum
from pathlib import Path

import numpy as np


class Fault(Enum):
    """A fault that the simulated instruments can be told to have."""

    LATE = "late"  # a reply comes late, within what the protocol allows
    SPLIT = "split"  # a reply comes in pieces with pauses between them
    GARBAGE = "garbage"  # bytes that nobody sent come before or within a reply
    BUSY = "busy"  # ER02: the colorimeter is not ready
    OVER_RANGE = "over range"  # ER10 once: a glint that the next reading does not have
    ALARM = "alarm"  # a hard limit in mid-motion: ALARM:1, locked until reset and unlock
    RESET = "reset"  # the controller restarts by itself and forgets where it stands
    VANISH = "vanish"  # the port disappears, and comes back a while later


class FaultPlan:
    """Draws faults and appends each to a log, one name a line."""

    def __init__(self, chances: Mapping[Fault, float], seed: int, log: Path | None = None) -> None:
        self._chances = dict(chances)
        self._log = log
        self.random = np.random.default_rng(seed)

    def strikes(self, fault: Fault) -> bool:
        """Whether the fault happens at this opportunity."""
        chance = self._chances.get(fault, 0.0)
        if chance <= 0.0 or self.random.random() >= chance:
            return False
        if self._log is not None:
            with self._log.open("a") as file:
                file.write(fault.value + "\n")
        return True


def read_log(*logs: Path) -> dict[Fault, int]:
    """How often each fault has happened, from the logs that exist."""
    lines = [line for log in logs if log.exists() for line in log.read_text().splitlines()]
    counts = Counter(lines)
    return {fault: counts[fault.value] for fault in Fault}
