"""What runs on a worker of a cluster: a job with its shared files, and its items one by one."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from raden_torch.brdf.materials.pearl import PEARL
from raden_torch.errors import InputError
from raden_torch.sequences.job import Job, Outcome, done_alone, message_of
from raden_torch.sequences.machine import Machine, this_machine

_SEEN_WITHIN_S = 5.0
"""How long a file that was just made may take to show on another machine of a network folder."""


@dataclass(frozen=True)
class SharedFile:
    """A file's bytes on their way to every worker.

    Attributes:
        path: absolute, on the machine that asked.
        sha256: hexadecimal.
    """

    path: str
    sha256: str
    content: bytes

    @classmethod
    def read(cls, path: Path) -> SharedFile:
        content = path.read_bytes()
        return cls(os.path.abspath(path), hashlib.sha256(content).hexdigest(), content)

    def put(self, folder: Path) -> Path:
        """Write it below a folder, at the place that it has below the root: what refers to a
        neighbour finds it.

        Raises:
            InputError: other bytes than were sent.
        """
        if hashlib.sha256(self.content).hexdigest() != self.sha256:
            raise InputError(f"{self.path}: expected the SHA-256 {self.sha256}, got another")
        place = folder / Path(self.path).relative_to(Path(self.path).anchor)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(self.content)
        return place


@dataclass(frozen=True)
class Order:
    """All that a worker is sent once.

    Attributes:
        job: with absolute paths.
        visible: files that the asking machine sees, so the worker must.
        machine: the asking one.
        mixed: whether machines that compute other bytes do, and GPUs are used.
    """

    job: Job[Any, Any, Any, Any]
    files: tuple[SharedFile, ...]
    visible: tuple[str, ...]
    machine: Machine
    mixed: bool


class Station:
    """An order on this worker.

    Raises:
        InputError: this worker is not fit for it: it computes otherwise, or sees other files.
    """

    def __init__(self, order: Order, folder: Path) -> None:
        _check_fit(order)
        self._folder = folder
        self._job = order.job.relocated({Path(f.path): f.put(folder) for f in order.files})
        if order.mixed and _has_gpu():
            self._job = on_device(self._job, "cuda")
        self._prepared: Any = None
        self._is_prepared = False
        self._preparing, self._working = threading.Lock(), threading.Lock()

    def done(self, item: Any) -> Outcome[Any]:
        """An item through all stages; of several threads one is at work, the others read or
        write."""
        try:
            with self._preparing:
                if not self._is_prepared:
                    self._prepared, self._is_prepared = self._job.prepare(), True
        except Exception as error:  # a plain one travels, where a library's own may not
            raise InputError(self._told(message_of(error))) from None
        outcome = done_alone(self._job, self._prepared, item, self._working)
        return replace(outcome, message=self._told(outcome.message))

    def _told(self, message: str) -> str:
        """With the paths of the machine that asked."""
        return message.replace(str(self._folder), "")

    def close(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


_stations: dict[str, Station] = {}
"""By the order's name; of this process."""


def open_station(name: str, order: bytes, folder: Path) -> None:
    """Take an order, a pickled `Order`."""
    _stations[name] = Station(pickle.loads(order), folder / name)


def close_station(name: str) -> None:
    if name in _stations:
        _stations.pop(name).close()


def do_item(name: str, item: Any) -> Outcome[Any]:
    """The task: an item of an order that this worker has."""
    return _stations[name].done(item)


def _check_fit(order: Order) -> None:
    different = this_machine().difference(order.machine, answers=not order.mixed)
    if different:
        raise InputError(different)
    latest = time.monotonic() + _SEEN_WITHIN_S
    for path in order.visible:
        while not os.path.exists(path):
            if time.monotonic() > latest:
                raise InputError(f"does not see {path}")
            time.sleep(0.2)


def _has_gpu() -> bool:
    import torch

    return torch.cuda.is_available()


def on_device(job: Job[Any, Any, Any, Any], device: str) -> Job[Any, Any, Any, Any]:
    """The job on a GPU, where it is one that shades: it has a field `device`."""
    names = [field.name for field in fields(job)]  # type: ignore[arg-type]
    return replace(job, device=device) if "device" in names else job  # type: ignore[type-var]


def absolute(value: Any, names: Collection[str] = ()) -> Any:
    """A job or an item with absolute paths, as other machines need them.

    Args:
        names: texts that are paths, too.
    """
    return _with_paths(value, os.path.abspath, names)


def _with_paths(value: Any, place: Callable[[Any], Any], names: Collection[str]) -> Any:
    """The same with other paths, in dataclasses and tuples, too."""
    if isinstance(value, Path):
        is_pearl = str(value) == PEARL and not value.exists()  # a name, no file
        return value if is_pearl else Path(place(value))
    if isinstance(value, str):
        return str(place(value)) if value in names else value
    if is_dataclass(value) and not isinstance(value, type):
        changed = {
            field.name: _with_paths(getattr(value, field.name), place, names)
            for field in fields(value)
            if field.init
        }
        return replace(value, **changed)
    if type(value) is tuple:
        return tuple(_with_paths(part, place, names) for part in value)
    return value


def shared_files(job: Job[Any, Any, Any, Any], most_bytes: int) -> tuple[SharedFile, ...]:
    """The files of a job that every worker is sent.

    Raises:
        InputError: together they are larger than `most_bytes`.
        OSError: one cannot be read.
    """
    paths: Sequence[Path] = [path for path in dict.fromkeys(job.shared) if path.exists()]
    size = sum(path.stat().st_size for path in paths)
    if size > most_bytes:
        raise InputError(
            f"shared files: expected at most {most_bytes >> 20} MiB together, which every worker "
            f"is sent, got {size >> 20} MiB ({', '.join(path.name for path in paths)})"
        )
    return tuple(SharedFile.read(path) for path in paths)
