"""Adds to a catalogue in processes that are killed. A line `folder file k` on stdin: kill -9 at the
k-th call that changes the folder; `folder file -ms`: after so many milliseconds of adding. Answers
with what ended the process: a signal's number, or 0.

Its own process, with no torch and no threads, so that forking it is quick and safe.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute
import pyarrow.parquet  # noqa: F401  # before the processes are forked

from raden_torch.catalogue import Catalogue, indexing
from raden_torch.catalogue.lab_grid import SHAPE

CHANGES = ("open", "fsync", "replace", "unlink", "mkdir", "rmdir", "ftruncate", "pwrite")


def plain(path: Path, assume: None) -> indexing.Indexed:
    lab = np.zeros(SHAPE, np.float16)
    return indexing.Indexed("measurement", "plain", "", "", True, {}, {}, (), lab, b"no picture")


def kill_at(count: int) -> None:
    """Before the `count`-th of the calls, from 1."""
    made = 0

    def counted(call: Callable[..., Any]) -> Callable[..., Any]:
        def instead(*args: Any, **kwargs: Any) -> Any:
            nonlocal made
            made += 1
            if made == count:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*args, **kwargs)

        return instead

    for name in CHANGES:
        setattr(os, name, counted(getattr(os, name)))


def kill_after(milliseconds: float) -> None:
    def kill() -> None:
        time.sleep(milliseconds / 1e3)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=kill, daemon=True).start()


def main() -> None:
    indexing.index_file = plain
    for line in sys.stdin:
        folder, file, when = line.rstrip("\n").split("\t")
        child = os.fork()
        if child == 0:
            number = 0
            catalogue = Catalogue(folder, create=True)
            (kill_at if int(when) > 0 else kill_after)(abs(int(when)))
            catalogue.add(file)
            while int(when) < 0:
                number += 1
                Path(file).write_text(f"{file} {number}")
                catalogue.add(file)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        print(os.WTERMSIG(status) if os.WIFSIGNALED(status) else status, flush=True)


if __name__ == "__main__":
    main()
