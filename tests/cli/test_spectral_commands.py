"""Spectral models from the command line: fitted, described, lit, refused elsewhere."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.images.exr import read_channels, write_channels

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def folder(raden: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`bands.safetensors` of a simulated shell, and `rgb.safetensors` of the same readings."""
    path = tmp_path_factory.mktemp("bands")
    rt.simulate_specimen("akoya", step_deg=35, spectral=True).save(path / "bands.csv")
    done = raden("fit", path / "bands.csv", "--spectral", "-o", path / "bands.safetensors")
    assert done.returncode == 0, done.stderr
    assert "380nm" in done.stdout
    assert "runtime table" in done.stdout
    rt.save_model(rt.fit(rt.load_measurement(path / "bands.csv")).model, path / "rgb.safetensors")
    return path


def test_info_says_what_is_in_it(raden: Command, folder: Path) -> None:
    told = raden("info", folder / "bands.safetensors").stdout
    assert "spectral model of akoya (simulated specimen)" in told
    assert "81 bands: 380…780 nm by 5" in told
    assert "incidence 0…70" in told


def test_a_sphere_under_illuminants(raden: Command, folder: Path, tmp_path: Path) -> None:
    model = folder / "bands.safetensors"
    loaded = rt.load_model(model)
    assert isinstance(loaded, SpectralBrdf)
    for name, options in (
        ("day", ()),
        ("fluorescent", ("--illuminant", "F11")),
        ("warm", ("--illuminant", "A", "--white", "D65")),
    ):
        out = tmp_path / f"{name}.exr"
        done = raden("render", model, *options, "--size", "32", "--samples", "1", "-o", out)
        assert done.returncode == 0, done.stderr
    day, fluorescent, warm = (
        np.stack(list(read_channels(tmp_path / f"{name}.exr").values()))
        for name in ("day", "fluorescent", "warm")
    )
    assert abs(day - fluorescent).max() > 0.01 * day.max()
    assert abs(day - warm).max() > 0.1 * day.max()
    done = raden("render", model, "--illuminant", "A", "--size", "64", "-o", tmp_path / "a.png")
    assert done.returncode == 0, done.stderr
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image is not None
    assert image.max() > 200


def test_a_gbuffer_under_a_lamp_from_a_file(raden: Command, folder: Path, tmp_path: Path) -> None:
    lamp = tmp_path / "lamp.csv"
    rows = "".join(f"{nm},{1 + nm / 500}\n" for nm in range(400, 701, 10))
    lamp.write_text("wavelength_nm,power\n" + rows)
    normal = np.zeros((4, 4, 3), np.float32)
    normal[..., 2] = 1
    shot = tmp_path / "shot.exr"
    write_channels(shot, {f"N.{c}": normal[..., i] for i, c in enumerate("XYZ")})
    out = tmp_path / "lit.exr"
    model = folder / "bands.safetensors"
    done = raden("render", model, "--gbuffer", shot, "--illuminant", lamp, "-o", out)
    assert done.returncode == 0, done.stderr
    found = read_channels(out)
    gbuffer = rt.GBuffer(torch.from_numpy(normal).movedim(-1, 0)[None], view=(0, 0, 1))
    material = rt.load_model(model).under(str(lamp))
    image = rt.shade(material, gbuffer, rt.DirectionalLight((1, 1, 2)))
    for channel, wanted in zip("RGB", image[0], strict=True):
        assert found[channel] == pytest.approx(wanted.numpy(), rel=1e-3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("render", "rgb.safetensors", "--illuminant", "A"),
            "--illuminant: expected with a spectral model, of `raden fit --spectral`, got a model",
        ),
        (
            ("render", "bands.safetensors", "--illuminant", "FL13"),
            "expected a name of the CIE's or a .csv file, got 'FL13'; did you mean FL",
        ),
        (
            ("render", "pearl", "--illuminant", "A"),
            "--illuminant: expected with a spectral model, got the pearl",
        ),
        (
            ("export", "bands.safetensors", "-o", "out.onnx"),
            ".onnx file: expected a model in RGB, got a spectral one of 81 bands; `raden fit` "
            "without --spectral makes one",
        ),
        (("export", "bands.safetensors", "-o", "out.glsl"), ".glsl file: expected a model in RGB"),
        (
            ("fit", "bands.csv", "bands.csv", "--spectral", "-o", "out.safetensors"),
            "--spectral: expected with one measurement",
        ),
        (
            ("fit", "bands.csv", "--spectral", "--diffuse", "surface", "-o", "out.safetensors"),
            "--spectral: expected without --diffuse",
        ),
        (
            ("fit", "xyz.csv", "--spectral", "-o", "out.safetensors"),
            "expected spectral bands (as 550nm) for a spectral model, got channels X, Y, Z",
        ),
    ],
)
def test_what_is_refused(
    raden: Command, folder: Path, words: tuple[str, ...], message: str
) -> None:
    rt.simulate_specimen("akoya", step_deg=35).save(folder / "xyz.csv")
    files = (".csv", ".safetensors", ".onnx", ".glsl")
    done = raden(*(folder / word if word.endswith(files) else word for word in words))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(folder.glob("out*"))
