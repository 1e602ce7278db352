"""Palettes from the command line: fitted, described, and shown by maps."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.palette import Palette
from raden_torch.images.exr import read_channels, write_channels

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


def test_a_map_chooses_pixel_by_pixel(
    raden: Command, shells: list[rt.RadenBrdf], tmp_path: Path
) -> None:
    rt.save_model(Palette(shells, tuple(SCALES)), tmp_path / "p.safetensors")
    rt.save_model(shells[2], tmp_path / "one.safetensors")
    index = np.repeat([[0, 2]], 32, 0).repeat(16, 1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "m.png"), index)
    normal = {
        f"N.{c}": np.full((32, 32), v, np.float32) for c, v in zip("XYZ", (0, 0, 1), strict=True)
    }
    write_channels(tmp_path / "shot.exr", normal | {"which": index.astype(np.float32)})

    def lit(model: str, *options: object) -> np.ndarray:
        path = tmp_path / "lit.exr"
        words = ("--gbuffer", tmp_path / "shot.exr", "--light", "0,1,2", "-o", path)
        done = raden("render", tmp_path / model, *words, *options)
        assert done.returncode == 0, done.stderr
        return np.stack([read_channels(path)[c] for c in "RGB"])

    one = lit("one.safetensors")
    for options in (("--material", tmp_path / "m.png"), ("--channel", "material=which")):
        image = lit("p.safetensors", *options)
        assert (image[..., 16:] == one[..., 16:]).all()
        assert (image[..., :16] != one[..., :16]).any(0).all()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--gbuffer", "shot.exr"), "shot.exr: material: expected a channel material of indices"),
        (("--gbuffer", "shot.exr", "--channel", "material=no"), "expected a channel no of indices"),
        (("--material", "shot.exr"), "--material: expected with --gbuffer"),
        (("--gbuffer", "shot.exr", "--material", "far.png"), "far.png: material: expected indices"),
    ],
)
def test_what_chooses_nothing(
    raden: Command,
    shells: list[rt.RadenBrdf],
    tmp_path: Path,
    words: tuple[str, ...],
    message: str,
) -> None:
    rt.save_model(Palette(shells, tuple(SCALES)), tmp_path / "p.safetensors")
    normal = {
        f"N.{c}": np.full((8, 8), v, np.float32) for c, v in zip("XYZ", (0, 0, 1), strict=True)
    }
    write_channels(tmp_path / "shot.exr", normal)
    cv2.imwrite(str(tmp_path / "far.png"), np.full((8, 8), 3, np.uint8))
    here = [tmp_path / word if "." in word else word for word in words]
    done = raden("render", tmp_path / "p.safetensors", *here, "-o", tmp_path / "lit.exr")
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "lit.exr").exists()
