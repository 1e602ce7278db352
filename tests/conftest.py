"""Fixtures that every test may use; device and dtypes come from the command line."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TextIO
from unittest import mock

# before torch is loaded, here and in every process that a test starts: threads that have nothing to
# do sleep; those that spin take the cores from whatever else runs, and each region tenfold the time
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, settings

from raden_torch.measurement import BrdfMeasurement

SHARED = Path(__file__).resolve().parents[2] / "shared"

TOLERANCE = {torch.float64: 1e-12, torch.float32: 1e-5, torch.bfloat16: 2e-2, torch.float16: 3e-3}
"""One table: the relative error that rounding may cause, by the dtype of the inputs."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", default="cpu", help="the torch device to test on")
    parser.addoption("--dtype", default="float32,float64", help="comma-separated dtypes")


def pytest_configure(config: pytest.Config) -> None:
    """The same examples in every run, however long they take; --hypothesis-seed=N looks for
    others. Workers of pytest-xdist share the cores; two threads each, so that no test of what
    threads do is left without."""
    if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
        torch.set_num_threads(max(2, (os.cpu_count() or 1) // workers))
    patient = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
    settings.register_profile("other seeds", **patient)
    settings.register_profile("seeded", derandomize=True, **patient)
    seed = config.getoption("--hypothesis-seed")
    settings.load_profile("seeded" if seed is None else "other seeds")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Under pytest-xdist with `--dist loadgroup`, tests that share costly fixtures stay on one
    worker: those of a module, and those of the whole folder where exports are kept."""
    if not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        together = item.path.parent if item.path.parent.name == "export" else item.path
        item.add_marker(pytest.mark.xdist_group(together.relative_to(config.rootpath).as_posix()))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Groups come to nothing, and nobody notices but the clock, where pytest-xdist does not find
    the node ids where it looks for them."""
    if getattr(session.config.option, "loadgroup", False):
        alone = next((item.nodeid for item in session.items if "@" not in item.nodeid), None)
        assert alone is None, f"pytest-xdist: expected a group of each test, got none of {alone}"


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "dtype" in metafunc.fixturenames:
        names = metafunc.config.getoption("--dtype").split(",")
        metafunc.parametrize("dtype", [getattr(torch, name) for name in names], ids=names)


@pytest.fixture(autouse=True)
def _the_same_random_numbers_in_any_order() -> None:
    """A test draws what it draws when it runs alone, whichever ran before it in this process."""
    torch.manual_seed(0)


@pytest.fixture
def device(request: pytest.FixtureRequest) -> torch.device:
    return torch.device(request.config.getoption("--device"))


@pytest.fixture
def tolerance(dtype: torch.dtype) -> float:
    return TOLERANCE[dtype]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real inputs that are not part of the project."""
    if not SHARED.is_dir():
        pytest.skip("no folder `shared` beside the project: real inputs are not here")
    return SHARED


@contextlib.contextmanager
def _caught(name: str) -> Iterator[TextIO]:
    """A file with all that is written to "stdout" or "stderr", by libraries in C, too."""
    number = {"stdout": 1, "stderr": 2}[name]
    kept = os.dup(number)
    with tempfile.TemporaryFile("w+", encoding="utf-8") as file:
        file.reconfigure(write_through=True)
        os.dup2(file.fileno(), number)
        try:
            with mock.patch.object(sys, name, file):
                yield file
        finally:
            os.dup2(kept, number)
            os.close(kept)


@pytest.fixture(scope="session")
def dng() -> ModuleType:
    """`tests/dng.py`, which writes raw files of known values."""
    spec = importlib.util.spec_from_file_location("dng", Path(__file__).with_name("dng.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def raden() -> Callable[..., subprocess.CompletedProcess[str]]:
    """The command as a shell runs it, but in this process: nothing is imported again.

    `warn` stands for Python's option -W: "error", or "default" to show warnings. What escapes as an
    exception, a shell's user would see as a traceback.
    """

    def run(
        *arguments: object, cwd: Path | None = None, warn: str = "error"
    ) -> subprocess.CompletedProcess[str]:
        from raden_torch.cli import main

        words, before = ["raden", *map(str, arguments)], Path.cwd()
        with (
            _caught("stdout") as out,
            _caught("stderr") as err,
            mock.patch.object(sys, "argv", words),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter(warn)  # type: ignore[arg-type]
            os.chdir(cwd or before)
            try:
                with pytest.raises(SystemExit) as ended:
                    main()
            finally:
                os.chdir(before)
            said = [file.seek(0) or file.read() for file in (out, err)]
        return subprocess.CompletedProcess(words, int(ended.value.code or 0), *said)

    return run


@pytest.fixture
def random_vectors(device: torch.device):
    """Seeded directions `[1, 3, n, 1]` in float64 from the upper hemisphere of N = +z."""

    def make(n: int, seed: int = 0) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        v = torch.randn(1, 3, n, 1, generator=generator, dtype=torch.float64)
        v[:, 2] = v[:, 2].abs() + 1e-3
        return torch.nn.functional.normalize(v, dim=1).to(device)

    return make


@pytest.fixture
def analytic():
    """A measurement of an analytic specimen on the raden grid: body plus a lobe around the mirror.

    Smooth, reciprocal and equal on equivalent geometries; named simulated.
    """

    def make(body: float = 20.0, peak: float = 80.0, step: float = 5.0) -> BrdfMeasurement:
        a, r, t = (
            x.ravel()
            for x in np.meshgrid(
                np.arange(0, 70.1, step),
                np.arange(-70, 70.1, step),
                np.arange(-70, 70.1, step),
                indexing="ij",
            )
        )
        # the half vector's angle to the normal: cos = cos((r − a)/2) cos t
        cosine = np.cos(np.deg2rad(r - a) / 2) * np.cos(np.deg2rad(t))
        lobe = np.exp(-(np.arccos(np.clip(cosine, -1, 1)) ** 2) / (2 * 0.2**2))
        colour = np.array([0.8, 1.0, 1.2])
        from raden_torch.measurement import Metadata

        return BrdfMeasurement(
            a,
            r,
            t,
            body + peak * lobe[:, None] * colour,
            metadata=Metadata("analytic", simulated=True),
        )

    return make
