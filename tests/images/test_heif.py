"""HEIC pictures, written losslessly by libheif's encoder, come back with their values."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pillow_heif
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, ImageCms

from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.capture.photo.photograph import read_linear
from raden_torch.errors import InputError
from raden_torch.images.heif import is_heic
from raden_torch.images.pixels import read_image
from raden_torch.info import describe_file

H, W = 64, 80
BITS = {8: "RGB", 10: "RGB;16", 12: "RGB;16"}


def picture(bits: int, channels: int = 3) -> np.ndarray:
    """Levels of all kinds, rising along each row."""
    rng = np.random.default_rng(bits)
    values = np.sort(rng.integers(0, 1 << bits, (H, W, channels)), axis=1)
    return values.astype(np.uint8 if bits == 8 else np.uint16)


def write(path: Path, values: np.ndarray, bits: int, **options: Any) -> Path:
    """RGB as it is: no luma and chroma, no loss."""
    mode = BITS[bits].replace("RGB", "RGBA") if values.shape[2] == 4 else BITS[bits]
    top = values if bits == 8 else values << (16 - bits)
    as_they_are = {"quality": -1, "chroma": 444, "matrix_coefficients": 0}
    before = pillow_heif.options.SAVE_HDR_TO_12_BIT
    pillow_heif.options.SAVE_HDR_TO_12_BIT = bits == 12
    try:
        with open(path, "wb") as file:
            pillow_heif.encode(mode, (W, H), top.tobytes(), file, **{**as_they_are, **options})
    finally:
        pillow_heif.options.SAVE_HDR_TO_12_BIT = before
    return path


def srgb(coded: np.ndarray) -> np.ndarray:
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("bits", BITS)
def test_values_come_back(tmp_path: Path, bits: int) -> None:
    """Expected: white is white, whatever the depth."""
    values = picture(bits)
    path = write(tmp_path / "a.heic", values, bits)
    stored = read_image(path)
    most = 255 if bits == 8 else 65535
    np.testing.assert_array_equal(stored.pixels, np.rint(values / ((1 << bits) - 1) * most))
    assert stored.pixels.max() == most
    assert stored.header.bits == (8 if bits == 8 else 16)
    linear = srgb(values / ((1 << bits) - 1))
    np.testing.assert_allclose(read_linear(path).linear, linear, atol=2e-5)
    shown = read_photograph(path)
    np.testing.assert_allclose(shown.linear[0].movedim(0, -1), linear, atol=2e-5)
    assert shown.levels == most


def test_primaries_and_curves(tmp_path: Path) -> None:
    """Display P3 by numbers; HDR, and what nobody can be sure of, are refused."""
    values = picture(10)
    p3 = {"color_primaries": 12, "transfer_characteristics": 13}
    found = read_linear(write(tmp_path / "a.heic", values, 10, **p3)).linear
    to_srgb = np.array([[1.2249, -0.2247, 0], [-0.0420, 1.0419, 0], [-0.0197, -0.0786, 1.0979]])
    np.testing.assert_allclose(found, srgb(values / 1023) @ to_srgb.T, atol=5e-4)
    for curve in (16, 18):
        path = write(tmp_path / "b.heic", values, 10, **{**p3, "transfer_characteristics": curve})
        with pytest.raises(InputError, match=rf"got cICP 12-{curve}-0-1 \(HDR\?\)"):
            read_linear(path)


def test_a_profile_comes_before_numbers(tmp_path: Path) -> None:
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    image = Image.fromarray(picture(8))
    file = pillow_heif.from_pillow(image)
    numbers = {"color_primaries": 9, "transfer_characteristics": 16}
    lossless = {"quality": -1, "chroma": 444, "matrix_coefficients": 0}
    file.info["icc_profile"] = profile
    file.save(tmp_path / "a.heic", **lossless, **numbers)
    np.testing.assert_allclose(
        read_linear(tmp_path / "a.heic").linear, srgb(picture(8) / 255), atol=1e-5
    )


def test_it_is_turned_once(tmp_path: Path) -> None:
    """Rationale: the file's own transformation counts; EXIF's orientation repeats it."""
    exif = Image.Exif()
    exif[274] = 6
    exif[272] = "Phone"
    exif.get_ifd(0x8769).update({33434: 0.01, 34855: 50})
    values = picture(8)
    path = tmp_path / "a.heic"
    file = pillow_heif.from_pillow(Image.fromarray(values))
    file.save(path, exif=exif.tobytes(), quality=-1, chroma=444, matrix_coefficients=0)
    photo = read_linear(path)
    np.testing.assert_allclose(photo.linear, srgb(np.rot90(values, -1) / 255), atol=1e-5)
    assert photo.exposure_s == pytest.approx(0.01)
    assert (photo.settings.iso, photo.settings.camera) == (50, "Phone")
    assert photo.settings.orientation == 6
    np.testing.assert_allclose(photo.turned_to(1).linear, srgb(values / 255), atol=1e-5)


@pytest.mark.parametrize("bits", [8, 10])
def test_alpha(tmp_path: Path, bits: int) -> None:
    values = picture(bits, 4)
    stored = read_image(write(tmp_path / "a.heic", values, bits))
    assert stored.alpha is not None
    most = 255 if bits == 8 else 65535
    np.testing.assert_array_equal(stored.alpha, np.rint(values[..., 3] / ((1 << bits) - 1) * most))
    assert stored.header.alpha == "straight"


def test_info(tmp_path: Path) -> None:
    lines = describe_file(write(tmp_path / "a.heic", picture(12), 12)).splitlines()
    assert lines == [
        "HEIC image: 80 x 64 pixels (width x height)",
        "RGB; 16 bits a channel, whole numbers",
        "ICC profile: none",
    ]


def test_brands() -> None:
    def start(brand: bytes, *others: bytes) -> bytes:
        body = b"ftyp" + brand + bytes(4) + b"".join(others)
        return struct.pack(">I", 4 + len(body)) + body

    assert is_heic(start(b"heic", b"mif1"))
    assert is_heic(start(b"mif1", b"mif1", b"heic"))
    assert not is_heic(start(b"avif", b"mif1"))
    assert not is_heic(start(b"crx "))
    assert not is_heic(b"\x89PNG\r\n\x1a\n")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_are_input_errors(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "a.heic"
    if not path.exists():
        write(path, picture(8), 8)
        (tmp_path / "whole").write_bytes(path.read_bytes())
    content = bytearray((tmp_path / "whole").read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, 400) | st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.just(len(content)) | st.integers(1, len(content)))])
    try:
        photo = read_linear(path, pattern="none")
    except InputError as error:
        said = str(error)
    else:
        said = ""
        assert np.isfinite(photo.linear).all()
    assert "\n" not in said
