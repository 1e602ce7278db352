"""What can go wrong on a simulated line, and when: seeded, and written down as it happens."""

from __future__ import annotations

from enum import Enum


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
