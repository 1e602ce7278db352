"""A model of several azimuths as a file, alone and in a palette; its tangents in an EXR."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.gbuffer_file import GBufferFile, read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.fitting.by_azimuth import fit_by_azimuth
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.palette import Palette
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.info import describe_file

H, W = 96, 40


@pytest.fixture(scope="module")
def turned() -> AnisotropicBrdf:
    shell = rt.simulate_specimen("yakogai", step_deg=35, azimuth_deg=(0, 60, 120))
    return fit_by_azimuth(shell, interpolation="trilinear").model


def test_a_file_gives_back_the_same_model(turned, tmp_path) -> None:
    path = tmp_path / "shell.safetensors"
    rt.save_model(turned, path)
    loaded = rt.load_model(path)
    assert isinstance(loaded, AnisotropicBrdf)
    assert loaded.azimuth_deg == (0.0, 60.0, 120.0)
    assert loaded.period_deg == 180.0
    assert torch.equal(loaded.tables(), turned.tables())
    said = describe_file(path)
    assert said.startswith("model of 3 sample azimuths: 0, 60, 120 deg, period 180 deg")
    assert "120 deg: " in said


def test_a_palette_may_hold_one(turned, tmp_path) -> None:
    path = tmp_path / "both.safetensors"
    rt.save_model(Palette([turned, turned.models[1]], ("turns", "plain")), path)
    loaded = rt.load_model(path)
    assert loaded[1] is loaded[0].models[1]  # kept once
    assert "0, turns: model of 3 sample azimuths" in describe_file(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"models": [0, 1, 7]}, "expected 0…2, got 7"), ({"azimuth_deg": [0, 60, 180]}, "differ"),
     ({"azimuth_deg": [0, 60]}, "one for each model"), ({"period_deg": 90}, "180 or 360"),
     ({"models": "x"}, "models"), ({"azimuth_deg": [0, 60, "a"]}, "azimuth_deg")],
)  # fmt: skip
def test_damaged_records_are_one_line(turned, tmp_path, change, message) -> None:
    from safetensors.torch import load_file, save_file

    path = tmp_path / "shell.safetensors"
    rt.save_model(turned, path)
    tensors = load_file(path)
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    metadata = json.loads(data[8 : 8 + length])["__metadata__"]
    about = json.loads(metadata["about"])
    about["material"] |= change
    save_file(tensors, path, {**metadata, "about": json.dumps(about)})
    with pytest.raises(InputError, match=message) as error:
        rt.load_model(path)
    assert "\n" not in str(error.value)


def write_shot(path, layer: str, *, coded: bool = False) -> torch.Tensor:
    """A bumpy plane with a layer of tangents; gives these back."""
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(3, H, W)).astype(np.float32) * 0.2
    normal[2] = 1
    normal /= np.linalg.norm(normal, axis=0)
    tangent = rng.normal(size=(3, H, W)).astype(np.float32)
    tangent /= np.linalg.norm(tangent, axis=0)
    channels = dict(zip(("N.X", "N.Y", "N.Z"), normal, strict=True))
    stored = (tangent + 1) / 2 if coded else tangent
    channels |= {f"{layer}.{c}": m for c, m in zip("XYZ", stored, strict=True)}
    write_channels(path, channels)
    return torch.from_numpy(tangent)[None]


@pytest.mark.parametrize(("layer", "coded"), [("Tangent", False), ("tangent", True)])
def test_a_layer_of_an_exr_holds_the_tangents(tmp_path, layer, coded) -> None:
    tangent = write_shot(tmp_path / "shot.exr", layer, coded=coded)
    found = read_gbuffer(tmp_path / "shot.exr", turns=True)
    torch.testing.assert_close(found.tangent, tangent, rtol=1e-5, atol=1e-5)
    assert read_gbuffer(tmp_path / "shot.exr").tangent is None


def test_bands_are_rows_of_the_whole_and_another_name_is_named(tmp_path, turned) -> None:
    tangent = write_shot(tmp_path / "shot.exr", "grain")
    reading = GBufferReading(channels={"tangent": "grain"})
    scene = GBufferFile(tmp_path / "shot.exr", reading, memory=32 * W * 320, turns=True)
    assert len(scene.bands) > 1
    parts = [scene.rows(*band).tangent for band in scene.bands]
    assert torch.equal(torch.cat(parts, 2), tangent)
    assert read_gbuffer(tmp_path / "shot.exr", turns=True).tangent is None
    with pytest.raises(InputError, match="knows no azimuth"):
        read_gbuffer(tmp_path / "shot.exr", channels={"tangent": "grain"})


def test_one_direction_for_all_pixels(tmp_path) -> None:
    write_shot(tmp_path / "shot.exr", "Tangent")
    found = read_gbuffer(tmp_path / "shot.exr", turns=True, tangent=(1.0, 2.0, 0.0))
    assert found.tangent.flatten().tolist() == [1.0, 2.0, 0.0]
    with pytest.raises(InputError, match="knows no azimuth"):
        read_gbuffer(tmp_path / "shot.exr", tangent=(1.0, 0.0, 0.0))
    for direction in ((0, 0, 0), (math.nan, 0, 1)):
        with pytest.raises(InputError, match="tangent: expected"):
            GBufferReading(tangent=direction)
    with pytest.raises(InputError, match="a direction or a layer, got both"):
        GBufferReading(tangent=(1, 0, 0), channels={"tangent": "grain"})
