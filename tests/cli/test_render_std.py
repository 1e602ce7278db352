"""`raden fit --std` and `raden render --std`: a map, layers, and what is refused in one line."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.images.exr import read_channels
from raden_torch.measurement.systematic_errors import SystematicErrors

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated measurement whose only error is a scale of 5 % and nearly no own one."""
    made = tmp_path_factory.mktemp("std")
    m = rt.simulate_specimen("yakogai", step_deg=35)
    m = replace(m, metadata=replace(m.metadata, systematic=SystematicErrors(scale_std=0.05)))
    replace(m, std=1e-6 * m.values).save(made / "shell.csv")
    return made


def test_from_a_measurement_to_a_map_and_layers(raden: Command, folder: Path) -> None:
    model = folder / "shell.safetensors"
    fitted = raden(
        *("fit", str(folder / "shell.csv"), "-o", str(model), "--std", "--outside", "diffuse")
    )
    assert fitted.returncode == 0, fitted.stderr
    assert (
        "standard deviations: own errors, zeros of 0 axes, a scale of 5 %"
        in raden("info", str(model)).stdout
    )
    for suffix in (".exr", ".svg"):
        words = ("-o", str(folder / "s.exr"), "--std", str(folder / f"std{suffix}"))
        done = raden("render", str(model), "--size", "24", *words)
        assert done.returncode == 0, done.stderr
        assert f"wrote {folder / f'std{suffix}'}" in done.stdout
    image, std = read_channels(folder / "s.exr"), read_channels(folder / "std.exr")
    assert set(std) == {f"{layer}.{c}" for layer in ("own", "systematic") for c in "RGB"}
    lit = image["G"] > 0.01
    np.testing.assert_allclose(std["systematic.G"][lit] / image["G"][lit], 0.05, rtol=2e-3)
    assert not std["systematic.G"][image["G"] == 0].any()
    assert std["own.G"].max() < 1e-4 * image["G"].max()
    assert (folder / "std.svg").read_bytes().startswith(b"<?xml")
    plate = raden(*("render", str(model), "--shape", "plate", "--std", str(folder / "p.png")))
    assert plate.returncode == 2
    assert "--std: expected the shape sphere" in plate.stderr
    assert not (folder / "p.png").exists()


def test_a_model_without_says_so_in_one_line(raden: Command, folder: Path) -> None:
    plain = rt.fit(rt.simulate_specimen("yakogai", step_deg=35), outside="diffuse").model
    rt.save_model(plain, folder / "plain.safetensors")
    words = ("-o", str(folder / "n.png"), "--std", str(folder / "n_std.png"))
    done = raden("render", str(folder / "plain.safetensors"), "--size", "16", *words)
    assert done.returncode == 2
    assert "raden fit --std" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (folder / "n.png").exists()
    assert not (folder / "n_std.png").exists()
