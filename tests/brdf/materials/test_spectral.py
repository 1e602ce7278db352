"""Spectral models: folding a light into the table is shading by band; metamers; files."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.caption import caption_of
from raden_torch.brdf.files.model_file import load_brdf
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.model.model import Provenance
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.brdf.shading.by_band import shade_bands
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.errors import InputError
from raden_torch.info import describe_file
from raden_torch.measurement.illuminants import Illuminant

LAYOUT = RuntimeLayout((6, 5, 7), (0.4, 0.3))
SOURCE = Provenance("akoya", "film optics", True, "abc", {"box_deg": [[0, 70], [-70, 70]]})


def _model(bands: int, seed: int = 0) -> SpectralBrdf:
    random = torch.Generator().manual_seed(seed)
    values = torch.rand(*LAYOUT.shape, bands, generator=random)
    return SpectralBrdf(values, LAYOUT, np.linspace(400, 700, bands), SOURCE)


@pytest.fixture(scope="module")
def ball() -> GBuffer:
    return sphere(24, (1.0, 0.5, 5.0), samples=1)


LAMPS = [rt.DirectionalLight((1, 1, 2)), rt.PointLight((-1.0, 2.0, 3.0), 7.0)]


@pytest.mark.parametrize("bands", [3, 7, 11, 12])
@pytest.mark.parametrize("name", ["D65", "A", "FL11"])
def test_a_folded_light_is_shading_by_band(ball: GBuffer, bands: int, name: str) -> None:
    model = _model(bands)
    by_band = shade_bands(model, ball, LAMPS)
    assert by_band.shape == (1, bands, 24, 24)
    weights = torch.from_numpy(Illuminant.of(name).rgb_weights(model.wavelengths_nm)).float()
    integrated = torch.einsum("bnhw,nc->bchw", by_band, weights)
    image = rt.shade(model.under(name), ball, LAMPS)
    assert torch.allclose(image, integrated, atol=3e-6 * float(image.abs().max()))
    assert float(image.abs().max()) > 0.1


def test_each_band_is_its_own_table(ball: GBuffer) -> None:
    model = _model(7)
    by_band = shade_bands(model, ball, LAMPS[0])
    for band in range(7):
        alone = torch.zeros_like(model.values)
        alone[..., band] = model.values[..., band]
        only = SpectralBrdf(alone, LAYOUT, model.wavelengths_nm)
        found = shade_bands(only, ball, LAMPS[0])
        assert torch.equal(found[:, band], by_band[:, band])
        assert float(found.sum()) == pytest.approx(float(by_band[:, band].sum()), rel=1e-6)


def test_lights_of_two_illuminants_are_added(ball: GBuffer) -> None:
    """Under one adaptation an even spectrum is the sum of its parts."""
    model, white = _model(9), Illuminant.of("E")
    power = np.ones(421)
    low, high = power * (np.arange(421) < 200), power * (np.arange(421) >= 200)
    parts = [Illuminant("part", part) for part in (low, high)]
    # `under` makes each of Y = 1 for white: weigh them by the luminance that they have
    nm = model.wavelengths_nm
    y = [part.xyz_weights(nm)[:, 1] for part in parts]
    whole = white.xyz_weights(nm)[:, 1]
    share = np.linalg.lstsq(np.stack(y, 1), whole, rcond=None)[0]
    images = [rt.shade(model.under(p, white=white), ball, LAMPS) for p in parts]
    summed = sum(s * image for s, image in zip(share.tolist(), images, strict=True))
    image = rt.shade(model.under(white), ball, LAMPS)
    assert torch.allclose(torch.as_tensor(summed), image, atol=1e-5 * float(image.abs().max()))


def test_metamers_match_under_one_light_alone() -> None:
    """Two spectra of one colour under D65, of which one has steep bands."""
    nm = np.arange(400.0, 701.0, 10.0)
    day = Illuminant.of("D65").xyz_weights(nm)
    steep = 0.3 + 0.25 * np.cos(nm / 18)
    unseen = np.eye(len(nm)) - day @ np.linalg.pinv(day)
    smooth = steep - unseen @ steep  # of the same X, Y, Z
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    gbuffer, lamp = rt.GBuffer(up, view=(0, 0, 1)), rt.DirectionalLight((0, 0, 1))

    def colour(spectrum: np.ndarray, name: str) -> np.ndarray:
        values = torch.from_numpy(spectrum / np.pi).float().expand(*LAYOUT.shape, -1)
        image = rt.shade(SpectralBrdf(values, LAYOUT, nm).under(name), gbuffer, lamp)
        return image.flatten().double().numpy()

    assert colour(steep, "D65") == pytest.approx(colour(smooth, "D65"), abs=2e-6)
    for name in ("A", "FL11"):
        assert abs(colour(steep, name) - colour(smooth, name)).max() > 0.01


def test_a_palette_takes_it_under_a_light(ball: GBuffer) -> None:
    model = _model(6)
    warm = model.under("A")
    palette = Palette([warm, model.under("D65")], ("warm", "day"))
    index = torch.zeros_like(ball.normal[:, :1]).long()
    image = rt.shade(palette, replace(ball, material=index), LAMPS)
    assert torch.equal(image, rt.shade(warm, ball, LAMPS))
    assert caption_of(palette) == caption_of(warm) == "simulated specimen: akoya"


def test_what_is_refused(ball: GBuffer) -> None:
    model = _model(6)
    with pytest.raises(InputError, match=r'spectral model; model\.under\("D65"\) is one'):
        rt.shade(model, ball, LAMPS)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected a material, got SpectralBrdf"):
        Palette([model])  # type: ignore[list-item]
    coloured = rt.DirectionalLight((0, 0, 1), (1.0, 2.0, 1.0))
    with pytest.raises(InputError, match=r"lights\[1\]: irradiance: expected one number"):
        shade_bands(model, ball, [LAMPS[0], coloured])
    with pytest.raises(InputError, match="expected SpectralBrdf, got RuntimeBrdf"):
        shade_bands(model.under(), ball, LAMPS)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="wavelengths_nm: expected three or more that rise"):
        SpectralBrdf(model.values, LAYOUT, model.wavelengths_nm[::-1])
    with pytest.raises(InputError, match="values: expected shape"):
        SpectralBrdf(model.values[1:], LAYOUT, model.wavelengths_nm)


def test_a_file_gives_it_back(tmp_path: Path) -> None:
    model, path = _model(7), tmp_path / "bands.safetensors"
    rt.save_model(model, path)
    loaded = rt.load_model(path)
    assert isinstance(loaded, SpectralBrdf)
    assert torch.equal(loaded.values, model.values)
    assert loaded.layout == LAYOUT
    assert np.array_equal(loaded.wavelengths_nm, model.wavelengths_nm)
    assert loaded.provenance == model.provenance
    text = describe_file(path)
    assert "spectral model of akoya (simulated specimen)" in text
    assert "7 bands: 400…700 nm by 50" in text
    with pytest.raises(InputError, match="viewer: expected a model in RGB, got a spectral one"):
        load_brdf(path, "viewer")


def test_under_a_light_it_is_saved_as_a_material(tmp_path: Path) -> None:
    material, path = _model(7).under("A"), tmp_path / "warm.safetensors"
    rt.save_model(material, path)
    loaded = rt.load_model(path)
    assert torch.equal(loaded.values, material.values)
    assert caption_of(loaded) == "simulated specimen: akoya"


def _changed(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    data = path.read_bytes()
    size = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + size])
    about = json.loads(header["__metadata__"]["about"])
    change(about)
    header["__metadata__"]["about"] = json.dumps(about)
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + size :])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda about: about["spectral"]["wavelengths_nm"].pop(), "values: expected shape"),
        (lambda about: about["spectral"].pop("runtime"), "spectral"),
        (lambda about: about["spectral"].update(wavelengths_nm=[5] * 7), "three or more that rise"),
        (lambda about: about.update(colour="grey"), "colour: expected spectral bands, got 'grey'"),
        (lambda about: about.update(spectral=3), "spectral"),
    ],
)
def test_a_damaged_file_is_one_line(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    path = tmp_path / "bands.safetensors"
    rt.save_model(_model(7), path)
    _changed(path, change)
    with pytest.raises(InputError, match=message) as error:
        rt.load_model(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
