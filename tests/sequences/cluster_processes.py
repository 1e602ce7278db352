"""A Dask cluster of real processes on loopback, for tests and benchmarks."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

_SETTINGS = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING_INTERVAL": "100ms",
    "OMP_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
}


class Cluster:
    """A scheduler and its workers.

    Args:
        folder: for logs and the workers' own files.
        modules: folders that workers import from, too.
    """

    def __init__(self, folder: Path, modules: tuple[Path, ...] = ()) -> None:
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._modules = modules
        self.workers: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()

    def start_scheduler(self) -> None:
        port = ("--host", "127.0.0.1", "--port", str(self._port))
        self.scheduler = self._start("scheduler", "scheduler", *port)

    def add_worker(self, threads: int = 1, **environment: str) -> subprocess.Popen[bytes]:
        """A process without a nanny, which would start it again."""
        options = ("--nthreads", str(threads), "--no-nanny", "--memory-limit", "0")
        name = f"worker-{len(self.workers)}"
        place = ("--name", name, "--local-directory", str(self.folder / "scratch"))
        worker = self._start(name, "worker", self.address, *options, *place, **environment)
        self.workers.append(worker)
        return worker

    def log(self, name: str) -> str:
        """Of "scheduler", or of "worker-0"."""
        return (self.folder / f"{name}.log").read_text("utf-8")

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
            process.wait(timeout=30)

    def _start(self, name: str, *command: str, **environment: str) -> subprocess.Popen[bytes]:
        path = os.pathsep.join(map(str, self._modules))
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *command, "--no-dashboard"],
                env={**os.environ, **_SETTINGS, "PYTHONPATH": path, **environment},
                cwd=self.folder,
                stdout=log,
                stderr=log,
            )
