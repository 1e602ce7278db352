"""Models of several sample azimuths from the command line: fitted, described, shown, refused."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.fitting.by_azimuth import fit_by_azimuth
from raden_torch.images.exr import read_channels, write_channels
from raden_torch.pictures import render_shape

Command = Callable[..., subprocess.CompletedProcess[str]]
LAMP = ("--light", "1,1,2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measurement at three azimuths, one at none, and the models of both."""
    path = tmp_path_factory.mktemp("azimuths")
    shell = rt.simulate_specimen("yakogai", step_deg=35, azimuth_deg=(0, 60, 120))
    shell.save(path / "turned.csv")
    plain = rt.simulate_specimen("yakogai", step_deg=35)
    plain.save(path / "plain.csv")
    rt.save_model(fit_by_azimuth(shell).model, path / "turned.safetensors")
    rt.save_model(rt.fit(plain).model, path / "plain.safetensors")
    normal = np.zeros((3, 32, 32), np.float32)
    normal[2] = 1
    tangent = np.zeros((3, 32, 32), np.float32)
    tangent[0], tangent[1, :, 16:] = 1, 2
    layers = {f"N.{c}": m for c, m in zip("XYZ", normal, strict=True)}
    write_channels(path / "none.exr", layers)
    layers |= {f"Tangent.{c}": m for c, m in zip("XYZ", tangent, strict=True)}
    write_channels(path / "shot.exr", layers)
    return path


def test_each_azimuth_is_fitted_and_reported(raden: Command, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "shell.safetensors"
    done = raden("fit", folder / "turned.csv", "--by-azimuth", "-o", out)
    assert done.returncode == 0, done.stderr
    for azimuth in (0, 60, 120):
        assert done.stdout.count(f"azimuth {azimuth} deg\n") == 1
    assert "azimuths 0, 60, 120 deg, linear between them, period 180 deg" in done.stdout
    stored = rt.load_model(folder / "turned.safetensors")
    assert torch.equal(rt.load_model(out).tables(), stored.tables())
    assert "model of 3 sample azimuths" in raden("info", out).stdout


@pytest.mark.parametrize("shape", ["sphere", "plate"])
def test_a_shape_turns_with_the_tangent(
    raden: Command, folder: Path, tmp_path: Path, shape: str
) -> None:
    model, lamp = rt.load_model(folder / "turned.safetensors"), [rt.DirectionalLight((1, 1, 2))]
    for words, tangent in (((), None), (("--tangent", "0,1,0"), (0.0, 1.0, 0.0))):
        out = tmp_path / "shape.exr"
        asked = ("--shape", shape, "--size", 24, "--samples", 1, *LAMP, *words)
        done = raden("render", folder / "turned.safetensors", *asked, "-o", out)
        assert done.returncode == 0, done.stderr
        image = render_shape(model, shape, lamp, size=24, samples=1, tangent=tangent)
        found = np.stack([read_channels(out)[c] for c in "RGB"])
        np.testing.assert_allclose(found, image[0].numpy(), rtol=1e-3, atol=1e-3)


def test_a_gbuffer_has_its_layer_a_direction_or_neither(
    raden: Command, folder: Path, tmp_path: Path
) -> None:
    model = rt.load_model(folder / "turned.safetensors")
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)

    def pixel(tangent: tuple[float, ...] | None) -> list[float]:
        along = None if tangent is None else torch.tensor(tangent).view(1, 3, 1, 1)
        seen = rt.GBuffer(normal, view=(0, 0, 1), tangent=along)
        with torch.no_grad():
            return rt.shade(model, seen, rt.DirectionalLight((1, 1, 2))).flatten().tolist()

    for file, words, left, right in (
        ("shot.exr", (), (1.0, 0.0, 0.0), (1.0, 2.0, 0.0)),
        ("shot.exr", ("--tangent", "0,1,0"), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)),
        ("none.exr", (), None, None),
    ):
        out = tmp_path / "lit.exr"
        words = ("--gbuffer", folder / file, *LAMP, *words)
        done = raden("render", folder / "turned.safetensors", *words, "-o", out)
        assert done.returncode == 0, done.stderr
        found = np.stack([read_channels(out)[c] for c in "RGB"])
        np.testing.assert_allclose(found[:, 5, 5], pixel(left), rtol=2e-3)
        np.testing.assert_allclose(found[:, 5, 25], pixel(right), rtol=2e-3)


def test_a_photograph_is_relit_with_a_tangent(raden: Command, folder: Path, tmp_path: Path) -> None:
    grey = np.full((32, 32), 0.2, np.float32)
    write_channels(tmp_path / "photo.exr", {c: grey for c in "RGB"})
    found = []
    for words in ((), ("--tangent", "1,0,0"), ("--tangent", "1,1,0")):
        out = tmp_path / "relit.exr"
        done = raden(
            *("relight", tmp_path / "photo.exr", "--normals", folder / "none.exr", *LAMP),
            *("--model", folder / "turned.safetensors", "--exposure", 0, "-o", out, *words),
        )
        assert done.returncode == 0, done.stderr
        found.append(read_channels(out)["G"][9, 9])
    assert len(set(found)) == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("fit plain.csv --by-azimuth -o x.safetensors", "several sample azimuths, got 1"),
        ("render plain.safetensors --tangent 1,0,0 -o x.png", "knows no azimuth"),
        ("render plain.safetensors --gbuffer shot.exr --tangent 1,0,0 -o x.png", "no azimuth"),
        ("render turned.safetensors --tangent 0,0,0 -o x.png", "a direction, got zero"),
        ("render turned.safetensors --tangent nan,0,0 -o x.png", "tangent: expected"),
        ("render turned.safetensors --shape board --tangent 1,0,0 -o x.png", "sphere or plate"),
        ("render turned.safetensors --gbuffer shot.exr --channel tangent=no -o x.png", "'no'"),
        ("export turned.safetensors -o x.onnx", "got an AnisotropicBrdf, which turns"),
        ("export turned.safetensors -o x.glsl", "got AnisotropicBrdf"),
        ("export turned.safetensors -o x.wgsl", "got AnisotropicBrdf"),
        ("export turned.safetensors -o x.html", "got AnisotropicBrdf"),
        ("export turned.safetensors -o x.gltf", "got AnisotropicBrdf"),
        ("export turned.safetensors -o x.osl", "AnisotropicBrdf"),
        ("plot turned.safetensors -o x.png", "got AnisotropicBrdf"),
        ("analyse turned.safetensors", "got AnisotropicBrdf"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(
    raden: Command, folder: Path, words: str, message: str
) -> None:
    done = raden(*words.split(), cwd=folder)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.strip().count("\n") == 0
    assert not list(folder.glob("x.*"))
