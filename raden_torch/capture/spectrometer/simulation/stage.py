"""Where the simulated stage really stands: told by the controller's process, read by the other."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

AXES = 6
_LAYOUT = struct.Struct(f"<{2 * AXES + 3}d")
_CHECKSUM = struct.Struct("<I")
_READ_ATTEMPTS = 1000


@dataclass(frozen=True, slots=True)
class Stage:
    """A motion in a straight line, and whether the shutter is closed.

    Attributes:
        start, end: the axes' true positions in degrees, in the controller's order.
        began_s, ends_s: on the system's monotonic clock, which all processes share.
    """

    start: tuple[float, ...]
    end: tuple[float, ...]
    began_s: float = 0.0
    ends_s: float = 0.0
    shutter_closed: bool = False

    def at(self, now_s: float) -> tuple[float, ...]:
        """The axes' positions at a moment."""
        span = self.ends_s - self.began_s
        done = 1.0 if span <= 0 else min(max((now_s - self.began_s) / span, 0.0), 1.0)
        return tuple(a + (b - a) * done for a, b in zip(self.start, self.end, strict=True))


def write_stage(path: Path, stage: Stage) -> None:
    """One write of a fixed size, with a checksum against a reader in its middle."""
    data = _LAYOUT.pack(
        *stage.start, *stage.end, stage.began_s, stage.ends_s, float(stage.shutter_closed)
    )
    handle = os.open(path, os.O_WRONLY | os.O_CREAT, 0o600)
    try:
        os.pwrite(handle, data + _CHECKSUM.pack(zlib.crc32(data)), 0)
    finally:
        os.close(handle)


def read_stage(path: Path) -> Stage:
    """The stage now."""
    for _ in range(_READ_ATTEMPTS):
        content = path.read_bytes()
        data, checksum = content[: _LAYOUT.size], content[_LAYOUT.size :]
        if len(content) == _LAYOUT.size + 4 and _CHECKSUM.unpack(checksum)[0] == zlib.crc32(data):
            values = _LAYOUT.unpack(data)
            return Stage(
                values[:AXES], values[AXES : 2 * AXES], values[-3], values[-2], values[-1] != 0.0
            )
    raise RuntimeError(f"{path}: no whole state of the stage in {_READ_ATTEMPTS} attempts")
