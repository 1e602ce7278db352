"""Targa, PSD, DPX, SGI, JPEG 2000 and JPEG XL: the values that an independent writer wrote."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageCms

from raden_torch.brdf.files.image_file import read_mask, read_normal_map, read_photograph
from raden_torch.errors import InputError
from raden_torch.images.pixels import read_image
from raden_torch.info.image_info import describe_image, recognises_image

H, W = 9, 11
RANDOM = np.random.default_rng(0)
RGBA = RANDOM.integers(0, 256, (H, W, 4), dtype=np.uint8)
DEEP = RANDOM.integers(0, 65536, (H, W, 3), dtype=np.uint16)


def psd(pixels: np.ndarray, mode: int = 3, icc: bytes = b"") -> bytes:
    """A flat file without layers, by Adobe's specification of the format."""
    height, width = pixels.shape[:2]
    planes = np.moveaxis(pixels.reshape(height, width, -1), 2, 0)
    depth = 8 * pixels.dtype.itemsize
    resource = b""
    if icc:
        padded = icc + bytes(len(icc) % 2)
        resource = b"8BIM" + struct.pack(">HHI", 1039, 0, len(icc)) + padded
    return (
        b"8BPS"
        + struct.pack(">H6xHIIHH", 1, len(planes), height, width, depth, mode)
        + struct.pack(">II", 0, len(resource))
        + resource
        + struct.pack(">IH", 0, 0)
        + planes.astype(planes.dtype.newbyteorder(">")).tobytes()
    )


def by_openimageio(path: Path, pixels: np.ndarray, kind: Any, **said: object) -> Path:
    spec = oiio.ImageSpec(W, H, pixels.shape[2], kind)
    for name, value in said.items():
        spec.attribute(name.replace("_", ":"), value)
    file = oiio.ImageOutput.create(path.suffix[1:])
    assert file.open(str(path), spec)
    assert file.write_image(pixels)
    assert file.close()
    return path


WRITTEN = {
    "a.tga": {},
    "rle.tga": {"compression": "tga_rle"},
    "down.tga": {"orientation": 1},
    "a.sgi": {},
    "a.jp2": {"irreversible": False},
    "a.j2k": {"irreversible": False},
}


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pillows_files(tmp_path: Path, name: str, channels: int) -> None:
    pixels = RGBA[..., 0] if channels == 1 else RGBA[..., :channels]
    path = tmp_path / name
    Image.fromarray(pixels).save(path, **WRITTEN[name])
    image = read_image(path)
    if channels == 4:
        assert image.header.alpha == ("associated" if name == "a.sgi" else "straight")
    if image.header.alpha != "associated":
        np.testing.assert_array_equal(image.pixels, pixels if channels < 4 else pixels[..., :3])
    assert (image.alpha is not None) == (channels == 4)
    if image.alpha is not None:
        np.testing.assert_array_equal(image.alpha, pixels[..., 3])


def test_a_psd_of_16_bits_and_its_profile(tmp_path: Path) -> None:
    path = tmp_path / "a.psd"
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    path.write_bytes(psd(DEEP, icc=icc))
    image = read_image(path)
    np.testing.assert_array_equal(image.pixels, DEEP)
    assert image.header.colour.icc == icc
    path.write_bytes(psd(RGBA, mode=4))
    with pytest.raises(InputError, match=r"a\.psd: expected grey or RGB, got .*convert it to sRGB"):
        read_image(path)
    path.write_bytes(psd(DEEP)[:-40])
    with pytest.raises(InputError, match=r"a\.psd: a damaged PSD file"):
        read_image(path)


@pytest.mark.parametrize("curve", ["Linear", "Undefined", "Printing density", "Logarithmic"])
def test_the_curve_of_a_dpx(tmp_path: Path, curve: str) -> None:
    path = by_openimageio(tmp_path / "a.dpx", DEEP, oiio.UINT16, dpx_Transfer=curve)
    if curve in ("Printing density", "Logarithmic"):
        with pytest.raises(InputError, match=f"expected a DPX in linear light.*got {curve}"):
            read_photograph(path)
        return
    coded = DEEP / 65535
    srgb = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    found = read_photograph(path).linear[0].movedim(0, -1).numpy()
    np.testing.assert_allclose(found, coded if curve == "Linear" else srgb, atol=1e-6)


def test_a_jpeg_xl_of_floats(tmp_path: Path) -> None:
    bright = DEEP.astype(np.float32) / 999
    path = by_openimageio(tmp_path / "a.jxl", bright, oiio.FLOAT)
    np.testing.assert_allclose(read_image(path).pixels, bright, rtol=1e-5)


def test_photographs_masks_and_normals_take_them(tmp_path: Path) -> None:
    up = np.full((H, W, 3), (128, 128, 255), np.uint8)
    Image.fromarray(up).save(tmp_path / "n.tga")
    normal = read_normal_map(tmp_path / "n.tga")
    assert float((normal[0, 2] - 1).abs().max()) < 1e-4
    mask = np.zeros((H, W), np.uint8)
    mask[2:5] = 255
    Image.fromarray(mask).save(tmp_path / "m.jp2", irreversible=False)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.jp2")[0, 0].numpy(), mask / 255)
    Image.fromarray(RGBA).save(tmp_path / "p.tga")
    alpha = read_photograph(tmp_path / "p.tga").alpha
    assert alpha is not None
    np.testing.assert_allclose(alpha[0, 0].numpy(), RGBA[..., 3] / 255, rtol=1e-6)


def test_a_png_by_another_name_is_a_png(tmp_path: Path) -> None:
    for name in ("a.tga", "a.psd", "a.dpx"):
        Image.fromarray(RGBA).save(tmp_path / name, format="PNG")
        image = read_image(tmp_path / name)
        assert image.header.format == "PNG"
        np.testing.assert_array_equal(image.pixels, RGBA[..., :3])


def test_they_are_described(tmp_path: Path) -> None:
    path = by_openimageio(tmp_path / "a.dpx", DEEP, oiio.UINT16)
    assert recognises_image(path.read_bytes()[:64])
    lines = describe_image(path).splitlines()
    assert lines[:2] == [
        "DPX image: 11 x 9 pixels (width x height)",
        "RGB; 16 bits a channel, whole numbers",
    ]


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("formats")
    for name in ("a.tga", "rle.tga", "a.sgi", "a.jp2"):
        Image.fromarray(RGBA[..., :3]).save(folder / name, **WRITTEN[name])
    (folder / "a.psd").write_bytes(psd(DEEP))
    by_openimageio(folder / "a.dpx", DEEP, oiio.UINT16)
    by_openimageio(folder / "a.jxl", RGBA[..., :3].copy(), oiio.UINT8)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_noise_is_read_or_an_input_error(contents, tmp_path_factory, data) -> None:
    name = data.draw(st.sampled_from(sorted(contents)))
    noisy = bytearray(contents[name])
    for _ in range(data.draw(st.integers(0, 6))):
        at = data.draw(st.integers(min(4, len(noisy) - 1), len(noisy) - 1))
        noisy[at] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / f"noisy_{name}"
    path.write_bytes(noisy[: data.draw(st.sampled_from([len(noisy), len(noisy) // 2, 20]))])
    with contextlib.suppress(InputError):
        read_image(path)
