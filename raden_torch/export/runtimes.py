"""The programs that can run a file on this machine, behind one call."""

from __future__ import annotations

import importlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError
from raden_torch.export.workers.worker import PROGRAMS, Worker, WorkerError
from raden_torch.packages import quiet_stderr, require

Arrays = dict[str, NDArray[np.float32]]
Run = Callable[[Arrays], NDArray[np.float32]]
Timed = Callable[[Arrays, int], tuple[NDArray[np.float32], list[float]]]


@dataclass(frozen=True)
class Runtime:
    """A loaded file.

    Attributes:
        name, version: of the program.
        run: named inputs → the one output; raises what the program raises.
        takes_all: it takes values for optional inputs, and must run every case that has pixels and
            lights.
        timed: the same, and the milliseconds of each of several runs; where None, `run` is timed.
    """

    name: str
    version: str
    run: Run
    takes_all: bool = True
    timed: Timed | None = None


@dataclass(frozen=True)
class SkippedRuntime:
    """A runtime that was not used, and why."""

    name: str
    reason: str


def onnx_session(data: bytes, threads: int = 0) -> Any:
    """A CPU session of ONNX Runtime that says nothing about the optional inputs.

    Raises:
        InputError: onnxruntime is not installed, or it cannot load the file.
    """
    require("exported shaders", "export")
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads
    try:
        return ort.InferenceSession(
            data,
            options,
            providers=["CPUExecutionProvider"],
            enable_fallback=False,  # which prints, and tries the same again
        )
    except Exception as error:  # its errors share no base class but this one
        raise InputError(f"onnxruntime {ort.__version__} cannot load it: {one_line(error)}") from (
            None
        )


def load_onnxruntime(data: bytes) -> Runtime:
    """ONNX Runtime on the CPU."""
    session = onnx_session(data)
    import onnxruntime

    return Runtime(
        "onnxruntime", onnxruntime.__version__, lambda inputs: session.run(None, inputs)[0]
    )


def load_others(
    data: bytes, *, node_modules: Path | None = None, pythons: Sequence[Path] = ()
) -> Iterator[Runtime | SkippedRuntime]:
    """Every other runtime that we know how to call; each is closed when the next is asked for.

    Args:
        node_modules: with onnxruntime-node, onnxruntime-web and playwright-core.
        pythons: the programs of other environments that have onnxruntime.
    """
    yield from _in_this_process(data)
    for python in pythons:
        name = f"onnxruntime ({python.parent.parent.name})"
        command = [str(python), str(PROGRAMS / "other_python.py")]
        yield from _worker(name, command, data, takes_all=True)
    yield from _in_javascript(data, node_modules)


def _in_this_process(data: bytes) -> Iterator[Runtime | SkippedRuntime]:
    for name, module, load in (
        ("OpenVINO", "openvino", _openvino),
        ("OpenCV dnn", "cv2", _opencv),
    ):
        try:
            found = importlib.import_module(module)
        except ImportError:
            yield SkippedRuntime(name, "not installed")
            continue
        try:
            with quiet_stderr():
                runtime = load(found, data)
        except Exception as error:  # whatever a foreign runtime raises is its reason
            yield SkippedRuntime(name, f"cannot load it: {one_line(error)}")
            continue
        yield runtime


def _in_javascript(data: bytes, node_modules: Path | None) -> Iterator[Runtime | SkippedRuntime]:
    # onnxruntime-web refuses values for optional inputs; onnxruntime-node ignores them
    names, node = ("onnxruntime-node", "onnxruntime-web"), shutil.which("node")
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    for name, packages in zip(names, ((), ("playwright-core",)), strict=True):
        missing = [
            package
            for package in (name, *packages)
            if node_modules is None or not (node_modules / package).is_dir()
        ]
        if node is None:
            yield SkippedRuntime(name, "Node.js is not installed")
        elif missing:
            yield SkippedRuntime(name, f"not installed; npm install {' '.join(missing)}")
        elif packages and browser is None:
            yield SkippedRuntime(name, "Chromium is not installed")
        elif not packages:
            command = [node, str(PROGRAMS / "node.cjs"), str(node_modules)]
            yield from _worker(name, command, data)
        else:
            command = [node, str(PROGRAMS / "browser.mjs"), str(node_modules), str(browser), "2"]
            yield from _worker(name, command, data)


def _worker(
    name: str, command: list[str], data: bytes, takes_all: bool = False
) -> Iterator[Runtime | SkippedRuntime]:
    try:
        worker = Worker(command, {"model.onnx": data})
    except WorkerError as error:
        yield SkippedRuntime(name, f"cannot load it: {one_line(error)}")
        return
    version = f"{worker.version} ({worker.note})" if worker.note else worker.version
    try:
        yield Runtime(name, version, worker.run, takes_all, worker.timed)
    finally:
        worker.close()


def _openvino(ov: ModuleType, data: bytes) -> Runtime:
    core = ov.Core()
    compiled = core.compile_model(core.read_model(data), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return Runtime("OpenVINO", ov.__version__, lambda inputs: compiled(inputs)[0], False)


def _opencv(cv2: ModuleType, data: bytes) -> Runtime:
    if not hasattr(cv2.dnn, "ENGINE_NEW"):
        raise RuntimeError(f"OpenCV {cv2.__version__} has no graph engine; 5.0 or newer has")
    buffer = np.frombuffer(data, np.uint8)

    def run(inputs: Arrays) -> NDArray[np.float32]:
        # a new net a call: it keeps the sizes that it was first run with
        with quiet_stderr():
            net = cv2.dnn.readNetFromONNX(buffer, cv2.dnn.ENGINE_NEW)
            for name, value in inputs.items():
                net.setInput(value, name)
            return np.asarray(net.forward())

    cv2.dnn.readNetFromONNX(buffer, cv2.dnn.ENGINE_NEW)
    return Runtime("OpenCV dnn", cv2.__version__, run, False)


def one_line(error: Exception) -> str:
    """The first line of what a library said, at most 200 characters."""
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__
