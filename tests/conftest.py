"""Fixtures that every test may use; device and dtypes come from the command line."""

from __future__ import annotations

from pathlib import Path

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
    others."""
    patient = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
    settings.register_profile("other seeds", **patient)
    settings.register_profile("seeded", derandomize=True, **patient)
    seed = config.getoption("--hypothesis-seed")
    settings.load_profile("seeded" if seed is None else "other seeds")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "dtype" in metafunc.fixturenames:
        names = metafunc.config.getoption("--dtype").split(",")
        metafunc.parametrize("dtype", [getattr(torch, name) for name in names], ids=names)


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
