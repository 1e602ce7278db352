"""Shells whose colour is known: matt ones, named simulated, and catalogues of them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.catalogue import Catalogue
from raden_torch.catalogue.indexing import Indexed
from raden_torch.catalogue.lab_grid import SHAPE

ALBEDO = {
    "red": (0.6, 0.1, 0.1),
    "green": (0.1, 0.6, 0.2),
    "grey": (0.3, 0.3, 0.3),
    "blue": (0.1, 0.2, 0.6),
}


@pytest.fixture(scope="session")
def matt(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The model of a matt surface, by the name of its colour, as a file."""
    folder = tmp_path_factory.mktemp("matt")

    @cache
    def make(name: str) -> Path:
        path = folder / f"{name}.safetensors"
        rt.save_model(Lambertian(ALBEDO[name]), path)
        return path

    return make


@pytest.fixture(scope="session")
def three(tmp_path_factory: pytest.TempPathFactory, matt: Callable[[str], Path]) -> Path:
    made = Catalogue(tmp_path_factory.mktemp("three") / "shells", create=True)
    for name in ("red", "green", "grey"):
        made.add(matt(name), tags=["matt", name], note=f"a {name} one")
    return made.folder


@pytest.fixture
def catalogue(tmp_path: Path, three: Path) -> Catalogue:
    """Of red, green and grey, in this order."""
    return Catalogue(shutil.copytree(three, tmp_path / "shells"))


@pytest.fixture(scope="session")
def albedo() -> dict[str, tuple[float, float, float]]:
    return ALBEDO


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Additions that do not look at the file: each is a shell of L* = 50."""
    monkeypatch.setattr("raden_torch.catalogue.indexing.index_file", lambda path, assume: plain())


def plain() -> Indexed:
    """What an addition without a look finds."""
    lab = np.zeros(SHAPE, np.float16)
    lab[..., 0] = 50
    return Indexed("measurement", "plain", "", "", True, {}, {}, (), lab, b"no picture")
