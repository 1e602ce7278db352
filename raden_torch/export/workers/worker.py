"""One conversation with a program that runs a file in a process of its own.

The program gets a folder with the files that it runs. It answers one JSON line a request:

    (at start)                                  → {"version": "1.30.0", "note": ""}
    {"inputs": {name: [sizes]}, "repeat": n}    → {"shape": [sizes], "milliseconds": [n times]}
    (it cannot)                                 → {"error": "what it says"}

Each input is raw little-endian float32 in `<name>.bin`, the output in `output.bin`. The program
ends when its input does.
"""

from __future__ import annotations

import json
import queue
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_START_S, _ANSWER_S, _END_S = 60, 120, 10

PROGRAMS = Path(__file__).parent


class WorkerError(RuntimeError):
    """The program reported an error, or ended."""


class Worker:
    """A running program with its files loaded.

    Args:
        command: the program and its arguments; the folder is appended.
        files: their contents by name.

    Raises:
        WorkerError: it does not start, or cannot load the files.
    """

    def __init__(self, command: list[str], files: Mapping[str, bytes]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="raden-")
        self._path = Path(self._folder.name)
        for name, data in files.items():
            (self._path / name).write_bytes(data)
        try:
            self._process = subprocess.Popen(
                [*command, self._folder.name],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        except OSError as error:
            self._folder.cleanup()
            raise WorkerError(f"{command[0]}: {error.strerror}") from None
        self._answers: queue.Queue[str] = queue.Queue()
        self._complaints: list[str] = []
        readers = (self._read_answers, self._read_complaints)
        self._readers = [threading.Thread(target=read, daemon=True) for read in readers]
        for reader in self._readers:
            reader.start()
        try:
            hello = self._answer(_START_S)
        except WorkerError:
            self.close()
            raise
        self.version: str = hello["version"]
        self.note: str = hello.get("note", "")

    def run(self, inputs: dict[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """The output for named inputs.

        Raises:
            WorkerError: what the program says.
        """
        return self.timed(inputs, 1)[0]

    def timed(
        self, inputs: dict[str, NDArray[np.float32]], repeat: int
    ) -> tuple[NDArray[np.float32], list[float]]:
        """The output, and the milliseconds of each of `repeat` runs, without the way there."""
        for name, value in inputs.items():
            (self._path / f"{name}.bin").write_bytes(np.asarray(value, "<f4").tobytes())
        sizes = {name: list(value.shape) for name, value in inputs.items()}
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"inputs": sizes, "repeat": repeat}) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise WorkerError(self._last_words()) from None
        answer = self._answer(_ANSWER_S)
        output = np.frombuffer((self._path / "output.bin").read_bytes(), "<f4")
        return output.reshape(answer["shape"]).astype(np.float32), answer["milliseconds"]

    def close(self) -> None:
        """End the program and remove its folder; may be called again."""
        process = self._process
        if process.stdin is not None:
            process.stdin.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for reader in self._readers:
            reader.join(_END_S)
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()
        self._folder.cleanup()

    def _answer(self, seconds: float) -> dict[str, Any]:
        try:
            line = self._answers.get(timeout=seconds)
        except queue.Empty:
            self._process.kill()
            raise WorkerError(f"no answer within {seconds} s") from None
        if not line:
            raise WorkerError(self._last_words())
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise WorkerError(answer["error"])
        return answer

    def _last_words(self) -> str:
        self._readers[1].join(1)
        lines = [line.strip() for line in self._complaints if "Error" in line]
        return lines[0] if lines else f"it ended ({self._process.poll()})"

    def _read_answers(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):  # libraries print there, too
                self._answers.put(line)
        self._answers.put("")

    def _read_complaints(self) -> None:
        assert self._process.stderr is not None
        self._complaints.extend(self._process.stderr)
