"""A pseudo-terminal that stands where a serial port would, at a path that stays the same."""

from __future__ import annotations

import os
import select
import tty
from contextlib import suppress
from pathlib import Path


class PtyPort:
    """The instrument's end of a pty; the other end is the symbolic link `path`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ours = self._theirs = -1
        self.appear()

    def appear(self) -> None:
        """Open a new pty and point the path at it."""
        self._ours, self._theirs = os.openpty()  # ours to keep: no hang-up between two programs
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        beside = self._path.with_suffix(".new")
        with suppress(FileNotFoundError):
            beside.unlink()
        beside.symlink_to(os.ttyname(self._theirs))
        beside.replace(self._path)

    def vanish(self) -> None:
        """Close the pty and remove the path: whoever has it open loses the line."""
        with suppress(FileNotFoundError):
            self._path.unlink()
        for handle in (self._ours, self._theirs):
            if handle >= 0:
                os.close(handle)
        self._ours = self._theirs = -1

    @property
    def present(self) -> bool:
        return self._ours >= 0

    def receive(self, timeout_s: float, also: int) -> tuple[bytes, bool]:
        """Bytes that came within the time, and whether the handle `also` is readable."""
        watched = [also, *([self._ours] if self.present else [])]
        ready, _, _ = select.select(watched, [], [], max(timeout_s, 0.0))
        data = b""
        if self.present and self._ours in ready:
            with suppress(BlockingIOError):
                data = os.read(self._ours, 65536)
        return data, also in ready

    def send(self, data: bytes) -> None:
        """Write; what finds no room, since nobody reads, is lost as on a real line."""
        if self.present:
            with suppress(BlockingIOError):
                os.write(self._ours, data)
