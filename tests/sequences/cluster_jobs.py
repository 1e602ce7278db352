"""A job for tests of the cluster, in a module that its workers can import."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.files import written_beside
from raden_torch.sequences.job import Job


@dataclass(frozen=True)
class Stamped(Job[int, bytes, int, bytes]):
    """Item n is a file with the shared bytes and n, which takes a while to write."""

    folder: Path
    stamp: Path
    seconds: float = 0.0
    broken: int | None = None

    @property
    def shared(self) -> tuple[Path, ...]:
        return (self.stamp,)

    def relocated(self, places: Mapping[Path, Path]) -> Stamped:
        return replace(self, stamp=places[self.stamp])

    def inputs(self, item: int) -> tuple[Path, ...]:
        return ()

    def output(self, item: int) -> Path:
        return self.folder / f"{item:03d}.bin"

    def prepare(self) -> bytes:
        return self.stamp.read_bytes()

    def is_done(self, item: int) -> bool:
        return self.output(item).exists()

    def read(self, prepared: bytes, item: int) -> int:
        if item == self.broken:
            raise InputError(f"{self.stamp}: item {item} is broken")
        return item

    def work(self, prepared: bytes, read: int) -> bytes:
        return prepared + bytes([read % 256])

    def write(self, prepared: bytes, worked: bytes, item: int) -> bool:
        with written_beside(self.output(item)) as temporary:
            temporary.write_bytes(worked[:1])
            time.sleep(self.seconds)
            temporary.write_bytes(worked)
        with (self.folder / "done.log").open("a") as log:
            log.write(f"{item} {os.getpid()}\n")
        return True
