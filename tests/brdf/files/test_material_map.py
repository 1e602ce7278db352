"""Maps of a palette's materials as files: indices and weights, in the G-buffer or beside it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import Display
from raden_torch.brdf.files.gbuffer_file import GBufferFile, read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.brdf.files.material_map import MaterialMap, read_material
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.errors import InputError
from raden_torch.images.exr import read_channels, write_channels
from raden_torch.pictures import render_gbuffer_file, render_shape
from raden_torch.relighting import relight_files

H, W = 96, 40
Y, X = np.mgrid[:H, :W].astype(np.float32)
NORMAL = np.stack([0.5 * np.sin(X / 3 + Y / 40), 0.4 * np.cos(Y / 7), np.ones_like(X)])
NORMAL = NORMAL / np.linalg.norm(NORMAL, axis=0)
LAYERS = {f"N.{c}": n.astype(np.float32) for c, n in zip("XYZ", NORMAL, strict=True)}
INDEX = ((X // 5 + Y // 7) % 3).astype(np.uint8)
WEIGHTS = np.random.default_rng(0).dirichlet((1, 1, 1), (H, W)).astype(np.float32)
ALBEDOS = ((0.1, 0.2, 0.3), (0.8, 0.5, 0.2), (0.4, 0.4, 0.9))
NAMES = ("akoya", "Yakogai", "urushi")
SUN = rt.DirectionalLight((0.3, 0.2, 1.0))


@pytest.fixture(scope="module")
def palette() -> Palette:
    return Palette([Lambertian(albedo) for albedo in ALBEDOS], NAMES)


def indices(path: Path, values: np.ndarray = INDEX) -> Path:
    assert cv2.imwrite(str(path), values)
    return path


def expected(weights: np.ndarray) -> np.ndarray:
    """`[3, H, W]`: three matt bodies under the sun, by Lambert's law."""
    toward = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    cosine = np.clip(np.einsum("chw,c->hw", NORMAL, toward), 0, None)
    return np.einsum("hwk,kc->chw", weights, np.array(ALBEDOS)) * cosine


INSIDE = {
    "an index": {"material": INDEX},
    "Blender's index": {"View Layer.IndexMA.X": INDEX},
    "weights by names": {
        f"material.{n}": WEIGHTS[..., k] for k, n in enumerate(("AKOYA", "yakogai", "urushi"))
    },
    "weights by numbers": {f"shot.material.{k}": WEIGHTS[..., k] for k in range(3)},
    "not of this palette's order": {f"material.{NAMES[k]}": WEIGHTS[..., k] for k in (2, 0, 1)},
}


@pytest.mark.parametrize("what", INSIDE)
def test_a_layer_of_the_gbuffer_says_which(palette: Palette, tmp_path: Path, what: str) -> None:
    maps = {k: v.astype(np.float32) for k, v in INSIDE[what].items()}
    write_channels(tmp_path / "shot.exr", LAYERS | maps)
    gbuffer = read_gbuffer(tmp_path / "shot.exr", palette=palette)
    image = rt.shade(palette, gbuffer, SUN)
    weights = np.eye(3)[INDEX] if len(maps) == 1 else WEIGHTS
    np.testing.assert_allclose(image[0], expected(weights), atol=2e-6)


@pytest.mark.parametrize("named", ["map8.png", "map16.png", "map.tif", "index.exr", "weights.exr"])
def test_a_file_of_its_own_says_which(palette: Palette, tmp_path: Path, named: str) -> None:
    write_channels(tmp_path / "shot.exr", LAYERS)
    path = tmp_path / named
    if named == "index.exr":
        write_channels(path, {"R": INDEX.astype(np.float32)})
    elif named == "weights.exr":
        write_channels(path, {NAMES[k]: WEIGHTS[..., k] for k in range(3)})
    else:
        indices(path, INDEX.astype(np.uint16) if "16" in named else INDEX)
    gbuffer = read_gbuffer(tmp_path / "shot.exr", palette=palette, material=path)
    weights = WEIGHTS if named == "weights.exr" else np.eye(3)[INDEX]
    np.testing.assert_allclose(rt.shade(palette, gbuffer, SUN)[0], expected(weights), atol=2e-6)


@pytest.mark.parametrize("own_file", [False, True])
def test_bands_are_the_whole(palette: Palette, tmp_path: Path, own_file: bool) -> None:
    maps = {f"material.{k}": WEIGHTS[..., k] for k in range(3)}
    write_channels(tmp_path / "shot.exr", LAYERS | ({} if own_file else maps))
    write_channels(tmp_path / "map.exr", maps)
    material = tmp_path / "map.exr" if own_file else None
    reading = GBufferReading(material=material)
    scene = GBufferFile(tmp_path / "shot.exr", reading, palette=palette, memory=32 * W * 900)
    assert len(scene.bands) == 3
    out = tmp_path / "lit.exr"
    render_gbuffer_file(palette, tmp_path / "shot.exr", out, [SUN], reading, memory=32 * W * 900)
    lit = np.stack([read_channels(out)[c] for c in "RGB"])
    np.testing.assert_allclose(lit, expected(WEIGHTS), atol=1e-3)


def test_what_is_masked_out_does_not_matter(palette: Palette, tmp_path: Path) -> None:
    mask, odd = np.ones((H, W), np.float32), INDEX.astype(np.float32)
    mask[:9], odd[:9] = 0, np.nan
    odd[0, 0] = 77
    write_channels(tmp_path / "shot.exr", LAYERS | {"A": mask, "material": odd})
    gbuffer = read_gbuffer(tmp_path / "shot.exr", palette=palette)
    image = rt.shade(palette, gbuffer, SUN)[0]
    np.testing.assert_allclose(image, expected(np.eye(3)[INDEX]) * mask, atol=2e-6)


def _with(values: np.ndarray, at: tuple[int, ...], to: float) -> np.ndarray:
    values = values.copy()
    values[at] = to
    return values


BAD = {
    "outside": (
        lambda p: indices(p / "m.png", _with(INDEX, (40, 3), 3)),
        r"got 3 in row 40, col.*3",
    ),
    "half": (
        lambda p: write_channels(p / "m.exr", {"Y": _with(INDEX * 1.0, (70, 2), 1.5)}),
        "expected indices 0…2 of the palette.*got 1.5 in row 70, column 2",
    ),
    "sum": (
        lambda p: write_channels(
            p / "m.exr", {f"{k}": _with(WEIGHTS, (50, 6, 0), 1.5)[..., k] for k in range(3)}
        ),
        "expected.*indices, or material.NAME",
    ),
    "sum of a layer": (
        lambda p: write_channels(
            p / "m.exr",
            {f"material.{k}": _with(WEIGHTS, (50, 6, 0), 1.5)[..., k] for k in range(3)},
        ),
        "weights of 0 or more that sum to 1, got 1.5, .* row 50, column 6",
    ),
    "two of three": (
        lambda p: write_channels(p / "m.exr", {f"material.{k}": WEIGHTS[..., k] for k in (0, 1)}),
        "material.NAME of weights for each of akoya, Yakogai, urushi, got the channels material.0",
    ),
    "size": (lambda p: indices(p / "m.png", INDEX[:-1]), "map of 40 x 96 pixels.*got 40 x 95"),
    "colours": (
        lambda p: indices(p / "m.png", np.dstack([INDEX, INDEX + 1, INDEX])),
        "one channel of 8 or 16 bits, whose values are indices, got 3 of uint8",
    ),
    "kind": (lambda p: (p / "m.jpg").write_bytes(b"x"), "in .exr, .png, .tif or .tiff, got .jpg"),
    "nothing": (lambda p: None, "No such file|cannot be read|expected"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_does_not_fit_is_one_line(palette: Palette, tmp_path: Path, what: str) -> None:
    make, words = BAD[what]
    make(tmp_path)
    path = next(tmp_path.iterdir(), tmp_path / "none.png")
    with pytest.raises(InputError, match=words) as error:
        MaterialMap(path, palette, (H, W)).rows(30, H)
    assert "\n" not in str(error.value)
    assert path.name in str(error.value)


def test_a_gbuffer_without_a_map_or_a_model_with_one(palette: Palette, tmp_path: Path) -> None:
    write_channels(tmp_path / "shot.exr", LAYERS)
    with pytest.raises(InputError, match=r"channel material of indices.*got the channels N\.X"):
        read_gbuffer(tmp_path / "shot.exr", palette=palette)
    path = indices(tmp_path / "m.png")
    with pytest.raises(InputError, match=r"m\.png: material: expected a palette to choose of"):
        read_gbuffer(tmp_path / "shot.exr", material=path)
    assert read_gbuffer(tmp_path / "shot.exr", palette=Palette([palette[0]])).material is None


def test_relighting_a_photograph_by_a_map(tmp_path: Path) -> None:
    names = ("akoya", "yakogai")
    shells = [rt.fit(rt.simulate_specimen(name, step_deg=35)).model for name in names]
    rt.save_model(Palette(shells), tmp_path / "p.safetensors")
    rt.save_model(shells[1], tmp_path / "one.safetensors")
    coded = np.rint((NORMAL.transpose(1, 2, 0)[..., ::-1] + 1) / 2 * 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "n.png"), coded)
    cv2.imwrite(str(tmp_path / "photo.png"), np.full((H, W, 3), 120, np.uint8))
    path = indices(tmp_path / "m.png", (X > 20).astype(np.uint8))

    def lit(model: str, out: str, **more: object) -> torch.Tensor:
        relight_files(
            [tmp_path / "photo.png"], tmp_path / "n.png", None, tmp_path / model, tmp_path / out,
            [SUN], display=Display(0.0), **more,
        )  # fmt: skip
        return read_photograph(tmp_path / out).linear

    both = lit("p.safetensors", "both.png", reading=GBufferReading(material=path))
    one = lit("one.safetensors", "one.png")
    above = slice(0, H // 2)  # the captions, which name the shells
    assert torch.equal(both[..., above, 21:], one[..., above, 21:])
    assert not torch.equal(both[..., above, :21], one[..., above, :21])
    with pytest.raises(InputError, match="which of akoya, yakogai each pixel shows, got none"):
        lit("p.safetensors", "no.png")
    with pytest.raises(InputError, match=r"m\.png: material: expected a palette"):
        lit("one.safetensors", "no.png", reading=GBufferReading(material=path))
    assert not (tmp_path / "no.png").exists()


@pytest.mark.parametrize("shape", ["sphere", "plate", "board"])
def test_a_shape_shows_every_material(shape: str, palette: Palette) -> None:
    with_all = render_shape(palette, shape, [SUN], size=96, samples=1)
    only = [
        render_shape(Palette([m], [palette.names[k]]), shape, [SUN], size=96, samples=1)
        for k, m in enumerate(palette)
    ]
    assert torch.isfinite(with_all).all()
    assert (with_all >= 0).all()
    if shape == "board":  # its layout depends on the number
        thirds = with_all.tensor_split(3, -1)
        means = torch.stack([third.amax((0, 2, 3)) for third in thirds])
        assert (means.argmax(1) == torch.tensor([2, 0, 2])).all()
        return
    for image in only:  # somewhere it is each one's picture
        same = (with_all == image).all(1) & (image > 0).any(1)
        assert same.float().mean() > 0.02


def test_a_whole_map(palette: Palette, tmp_path: Path) -> None:
    found = read_material(indices(tmp_path / "m.png"), palette, (H, W))
    assert found.dtype == torch.uint8
    assert (found[0, 0].numpy() == INDEX).all()
