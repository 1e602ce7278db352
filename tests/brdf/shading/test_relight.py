"""Relighting photographs: linear light, exact outside the mask, and every way to store a normal."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.image_file import (
    Photograph,
    read_mask,
    read_normal_map,
    read_photograph,
    write_photograph,
)
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.shading.relight import lamp_ring, matching_gain, relight, relit_under, tiled
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.relighting import Surface


@pytest.fixture(scope="module")
def lambertian() -> rt.RadenBrdf:
    table = torch.full((10, 19, 19, 3), 1 / math.pi)
    return rt.RadenBrdf(None, ReflectanceTable(table, (0.0, -90.0, -90.0), (10.0, 10.0, 10.0)))


def ball(n: int = 64) -> tuple[torch.Tensor, torch.Tensor]:
    """Normals and mask of a ball that fills a picture; y is up."""
    x = (torch.arange(n) + 0.5) / n * 2 - 1
    y, x = torch.meshgrid(-x, x, indexing="ij")
    square = x * x + y * y
    mask = (square < 0.9)[None, None].float()
    return torch.stack([x, y, (1 - square).clamp(min=0).sqrt()])[None] * mask, mask


def photo(n: int = 64, batch: int = 1) -> torch.Tensor:
    return torch.rand(batch, 3, n, n, generator=torch.Generator().manual_seed(0))


def test_outside_the_mask_nothing_changes(lambertian) -> None:
    normal, mask = ball()
    before = photo()
    after = relight(lambertian, before, normal, mask, [rt.DirectionalLight((1, 0, 1))])
    outside = (mask == 0).expand_as(before)
    assert torch.equal(after[outside], before[outside])
    assert not torch.equal(after, before)


def test_a_soft_edge_blends_in_linear_light(lambertian) -> None:
    normal = torch.zeros(1, 3, 1, 3)
    normal[:, 2] = 1
    mask = torch.tensor([0.0, 0.25, 1.0]).view(1, 1, 1, 3)
    before = torch.full((1, 3, 1, 3), 0.2)
    after = relight(lambertian, before, normal, mask, [rt.DirectionalLight((0, 0, 1))], gain=1.0)
    assert after[0, 0, 0].tolist() == pytest.approx([0.2, 0.75 * 0.2 + 0.25, 1.0])


def test_the_masked_part_keeps_its_mean_luminance(lambertian) -> None:
    normal, mask = ball()
    before = photo(batch=2) * torch.tensor([1.0, 0.1]).view(2, 1, 1, 1)
    lamp = [rt.DirectionalLight((0.5, 0.5, 1), (3.0, 2.0, 1.0))]
    after = relight(lambertian, before, normal, mask, lamp)
    weights = torch.tensor([0.2126, 0.7152, 0.0722]).view(3, 1, 1)
    mean = lambda image: (image * weights * mask).sum(dim=(1, 2, 3))  # noqa: E731
    torch.testing.assert_close(mean(after), mean(before))
    black = torch.zeros_like(before)
    assert (matching_gain(before, black, mask) == 1).all()


def test_two_lights_and_the_side_they_come_from(lambertian) -> None:
    normal, mask = ball()
    right = relight(lambertian, photo() * 0, normal, mask, [rt.DirectionalLight((1, 0, 0.2))])
    assert right[..., 32:].sum() > 5 * right[..., :32].sum()
    above = relight(lambertian, photo() * 0, normal, mask, [rt.DirectionalLight((0, 1, 0.2))])
    assert above[..., :32, :].sum() > 5 * above[..., 32:, :].sum()
    lamps = [rt.DirectionalLight((1, 0, 0.2)), rt.DirectionalLight((0, 1, 0.2))]
    both = relight(lambertian, photo() * 0, normal, mask, lamps)
    torch.testing.assert_close(both, right + above)


def test_strip_goes_round(lambertian) -> None:
    normal, mask = ball(32)
    strip = tiled(relit_under(lambertian, photo(32) * 0.1, normal, mask, lamp_ring(12)), 12)
    assert strip.shape == (1, 3, 32, 12 * 32)
    tiles = strip.view(1, 3, 32, 12, 32) * mask.view(1, 1, 32, 1, 32)
    across = (torch.arange(32) - 15.5).view(1, 1, 1, 1, 32)
    balance = (tiles * across).sum(dim=(0, 1, 2, 4))
    assert balance.argmax() == 0  # the first lamp is on the right
    assert balance.argmin() == 6
    with pytest.raises(InputError, match="1…360"):
        lamp_ring(0)


def coded(normal: torch.Tensor, levels: int, dtype: type) -> np.ndarray:
    rgb = ((normal[0] + 1) / 2 * (normal[0] != 0).any(dim=0)).movedim(0, -1).numpy()
    return np.ascontiguousarray(np.rint(rgb * levels).astype(dtype)[..., ::-1])


def test_normal_maps_of_every_kind(tmp_path: Path) -> None:
    normal, mask = ball()
    cv2.imwrite(str(tmp_path / "8.png"), coded(normal, 255, np.uint8))
    cv2.imwrite(str(tmp_path / "16.png"), coded(normal, 65535, np.uint16))
    flipped = normal * torch.tensor([1.0, -1.0, 1.0]).view(3, 1, 1)
    cv2.imwrite(str(tmp_path / "dx.png"), coded(flipped, 65535, np.uint16))
    alpha = (mask[0].movedim(0, -1).numpy() * 255).astype(np.uint8)
    noisy = np.where(alpha > 0, coded(normal, 255, np.uint8), 200).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "alpha.png"), np.concatenate([noisy, alpha], axis=2))
    bgr = normal[0].movedim(0, -1).numpy()[..., ::-1]
    cv2.imwrite(str(tmp_path / "signed.tiff"), np.ascontiguousarray(bgr))
    inside = mask.expand_as(normal) > 0
    for name, green, error in (
        ("8.png", "opengl", 0.01),
        ("16.png", "opengl", 1e-4),
        ("dx.png", "directx", 1e-4),
        ("alpha.png", "opengl", 0.01),
        ("signed.tiff", "opengl", 1e-6),
    ):
        found = read_normal_map(tmp_path / name, green)
        assert (found - normal).abs()[inside].max() < error
        assert (found[~inside] == 0).all()
    with pytest.raises(InputError, match="opengl or directx"):
        read_normal_map(tmp_path / "8.png", "vulkan")
    cv2.imwrite(str(tmp_path / "n.jpg"), coded(normal, 255, np.uint8))
    with pytest.warns(UserWarning, match="JPEG holds normals badly"):
        assert (read_normal_map(tmp_path / "n.jpg") - normal).abs()[inside].median() < 0.05
    cv2.imwrite(str(tmp_path / "grey.png"), alpha)
    with pytest.raises(InputError, match="three channels"):
        read_normal_map(tmp_path / "grey.png")


def test_layers_that_lie_in_the_surface_are_turned_as_it_is(lambertian, tmp_path: Path) -> None:
    """Where an EXR's layer normal is zero it is the surface's, also of a map with green down."""
    normal, _ = ball()
    x, y, z = normal[0].numpy()
    names = ("normal.X", "normal.Y", "normal.Z", "layer_normal.X", "layer_normal.Y")
    channels = dict(zip(names, (x, -y, z, 0 * x, 0 * x), strict=True))
    write_channels(tmp_path / "n.exr", {**channels, "layer_normal.Z": 0 * x})
    surface = Surface.read(lambertian, tmp_path / "m", tmp_path / "n.exr", None, "directx")
    torch.testing.assert_close(surface.normal, normal, atol=1e-3, rtol=0)
    inside = (normal != 0).any(1)[0]
    layers = surface.layers["layer_normal"]
    torch.testing.assert_close(layers[..., inside], normal[..., inside], atol=1e-3, rtol=0)


@pytest.mark.parametrize(("levels", "kind"), [(255, np.uint8), (65535, np.uint16)])
def test_photographs_come_back_to_the_bit(tmp_path: Path, levels: int, kind: type) -> None:
    generator = np.random.default_rng(0)
    pixels = generator.integers(0, levels + 1, (64, 80, 3)).astype(kind)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    read = read_photograph(tmp_path / "a.png")
    assert read.levels == levels
    write_photograph(read, tmp_path / "b.png")
    assert np.array_equal(cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_UNCHANGED), pixels)
    middle = read_photograph(tmp_path / "a.png").linear.flatten()
    assert 0 <= middle.min() < middle.max() <= 1


def test_float_photographs_are_linear(tmp_path: Path) -> None:
    linear = torch.rand(1, 3, 9, 7) * 10
    write_photograph(Photograph(linear, None), tmp_path / "a.tiff")
    assert torch.equal(read_photograph(tmp_path / "a.tiff").linear, linear)
    write_photograph(Photograph(linear, None), tmp_path / "a.hdr")
    torch.testing.assert_close(
        read_photograph(tmp_path / "a.hdr").linear, linear, rtol=0.02, atol=0.1
    )
    with pytest.raises(InputError, match="floating-point photograph"):
        write_photograph(Photograph(linear, None), tmp_path / "a.png")


def test_masks(tmp_path: Path) -> None:
    grey = np.array([[0, 128, 255]], np.uint8)
    cv2.imwrite(str(tmp_path / "m.png"), grey)
    assert read_mask(tmp_path / "m.png").flatten().tolist() == pytest.approx([0, 128 / 255, 1])
    with_alpha = np.full((1, 3, 4), 255, np.uint8)
    with_alpha[..., 3] = grey
    cv2.imwrite(str(tmp_path / "a.png"), with_alpha)
    assert torch.equal(read_mask(tmp_path / "a.png"), read_mask(tmp_path / "m.png"))
    cv2.imwrite(str(tmp_path / "none.png"), grey * 0)
    with pytest.raises(
        InputError, match="expected a mask that is white on the object, got an empty one"
    ):
        read_mask(tmp_path / "none.png")


def test_sizes_that_differ_are_named(lambertian) -> None:
    normal, mask = ball()
    lamp = [rt.DirectionalLight((0, 0, 1))]
    with pytest.raises(
        InputError, match="`normals`: expected the photograph's 32 x 32 pixels, got 64 x 64"
    ):
        relight(lambertian, photo(32), normal, mask, lamp)
    with pytest.raises(
        InputError, match=r"mask: expected shape \[B, 1, H, W\], got \[1, 3, 64, 64\]"
    ):
        relight(lambertian, photo(64), normal, normal, lamp)
    with pytest.raises(InputError, match="empty"):
        relight(lambertian, photo(64), normal, mask * 0, lamp)


@pytest.mark.parametrize("content", [b"", b"no image at all", b"\x89PNG\r\n\x1a\n" + b"x" * 40])
def test_what_is_no_image_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    for read in (read_photograph, read_normal_map, read_mask):
        with pytest.raises(InputError, match="not an image"):
            read(path)
    with pytest.raises(InputError, match="No such file"):
        read_photograph(tmp_path / "none.png")


def test_a_real_photograph_is_relit(shared: Path, analytic) -> None:
    """The grey sphere of the photometric set: its normals follow from its outline."""
    folder = shared / "data/photometric_stereo"
    mask = read_mask(folder / "gray.mask.png").round()
    rows, columns = torch.nonzero(mask[0, 0], as_tuple=True)
    x0, y0 = columns.float().mean(), rows.float().mean()
    radius = math.sqrt(len(rows) / math.pi)
    h, w = mask.shape[2:]
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    x, y = (x - x0) / radius, (y0 - y) / radius
    normal = torch.stack([x, y, (1 - x * x - y * y).clamp(min=0).sqrt()])[None] * mask
    model = rt.fit(analytic(), interpolation="trilinear").model
    before = read_photograph(folder / "gray.0.png").linear
    with torch.no_grad():
        after = relight(model, before, normal, mask, [rt.DirectionalLight((-1, 0.5, 1))])
    assert torch.isfinite(after).all()
    assert torch.equal(after * (1 - mask), before * (1 - mask))
    lit = (after * mask).mean(dim=1)[0]
    assert lit[:, : int(x0)].sum() > lit[:, int(x0) :].sum()
