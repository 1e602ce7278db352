"""Palettes from the command line: fitted, described, and shown by maps."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

import raden_torch as rt

Command = Callable[..., subprocess.CompletedProcess[str]]
SCALES = {"rim": 0.9, "middle": 1.0, "eye": 1.1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three measured points of one shell."""
    path = tmp_path_factory.mktemp("points")
    for name, scale in SCALES.items():
        rt.simulate_specimen("mexican", step_deg=35, tablet_scale=scale).save(path / f"{name}.csv")
    return path


@pytest.fixture(scope="module")
def shells(folder: Path) -> list[rt.RadenBrdf]:
    return [rt.fit(rt.load_measurement(folder / f"{name}.csv")).model for name in SCALES]


def test_several_measurements_make_a_palette(
    raden: Command, folder: Path, shells: list[rt.RadenBrdf], tmp_path: Path
) -> None:
    points = [folder / f"{name}.csv" for name in SCALES]
    out = tmp_path / "shell.safetensors"
    done = raden("fit", *points, "-o", out)
    assert done.returncode == 0, done.stderr
    palette = rt.load_model(out)
    assert palette.names == tuple(SCALES)
    for member, shell in zip(palette, shells, strict=True):
        assert torch.equal(member.runtime_table(), shell.runtime_table())
    for name in SCALES:
        assert done.stdout.count(f"{name}: BrdfMeasurement") == 1
    assert done.stdout.count("reading") >= 3  # each member has its report
    done = raden("fit", *points[:2], "--names", "one, two", "-o", out)
    assert rt.load_model(out).names == ("one", "two")
    assert "one: model of mexican" in raden("info", out).stdout
    assert raden("fit", points[0], "-o", out).returncode == 0
    assert isinstance(rt.load_model(out), rt.RadenBrdf)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("rim.csv", "--names", "a"), "--names: expected with several measurements, got one"),
        (("rim.csv", "eye.csv", "--names", "a"), "--names: expected 2 names, got 1"),
        (("rim.csv", "eye.csv", "--names", "a,a"), "got 'a' twice"),
        (("rim.csv", "eye.csv", "--names", "a,,b"), "--names: expected names as rim,middle,eye"),
        (("rim.csv", "rim.csv"), "got 'rim' twice"),
        (("rim.csv", "eye.csv", "--validation", "middle.csv"), "--validation: expected with one"),
        (("rim.csv", "eye.csv", "--interpolation", "lobe"), "rim.csv: "),
        (("rim.csv", "none.csv"), "none.csv: "),
    ],
)
def test_what_makes_no_palette(
    raden: Command, folder: Path, tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    here = [folder / word if word.endswith(".csv") else word for word in words]
    done = raden("fit", *here, "-o", tmp_path / "p.safetensors")
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
