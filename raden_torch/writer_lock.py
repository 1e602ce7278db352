"""One writer at a time: a lock that ends with the process that holds it, however that ends."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from raden_torch.errors import InputError

_AGAIN_S = 0.05


@contextmanager
def writer_lock(path: Path, wait_s: float, hint: str = "") -> Iterator[None]:
    """Hold the lock on a file, which stays there, in the block: the one writer of its folder.

    Args:
        wait_s: how long to wait for the process that holds it; ≥ 0.
        hint: ends the message where the wait was in vain.

    Raises:
        InputError: it is still held after that; the system has no such locks.
    """
    try:
        import fcntl
    except ImportError:
        raise InputError(
            f"{path}: expected a system with flock (Linux, macOS), got one without"
        ) from None
    lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        until = time.monotonic() + wait_s
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= until:
                    holder = os.pread(lock, 200, 0).decode(errors="replace").strip()
                    raise InputError(
                        f"{path.parent}: expected to be its only writer within {wait_s:g} s, but "
                        f"{holder or 'another process'} is writing{hint}"
                    ) from None
                time.sleep(_AGAIN_S)
        with suppress(OSError):  # a full disk; it is only told to others
            os.ftruncate(lock, 0)
            os.pwrite(lock, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
        yield
    finally:
        os.close(lock)
