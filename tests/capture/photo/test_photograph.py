"""Photograph files of every kind, written here with known values, come back as linear light."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from raden_torch.capture.photo.development import Development, developed
from raden_torch.capture.photo.photograph import check_same_size, read_linear, read_stored
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.mosaic import (
    BAYER_PATTERNS,
    demosaiced,
    looks_like_mosaic,
    possible_patterns,
)
from tests.dng import mosaic_of

H, W = 24, 32


def srgb_curve(coded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, written out: the reader's comes from colour-science."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def ramp(levels: int) -> np.ndarray:
    """`[H, W, 3]` smooth and different in each channel."""
    x = np.linspace(0.05, 0.95, H * W).reshape(H, W)
    return np.rint(levels * np.stack([x, x[::-1], 0.5 * x + 0.2], -1)).astype(
        np.uint8 if levels == 255 else np.uint16
    )


def save(path: Path, rgb: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), rgb[..., ::-1] if rgb.ndim == 3 else rgb)
    return path


@pytest.mark.parametrize(("suffix", "levels"), [("png", 255), ("png", 65535), ("tiff", 65535)])
def test_srgb_files_are_decoded(tmp_path: Path, suffix: str, levels: int) -> None:
    stored = ramp(levels)
    photo = read_linear(save(tmp_path / f"a.{suffix}", stored))
    np.testing.assert_allclose(photo.linear, srgb_curve(stored / levels), atol=1e-6)
    assert photo.bits == (8 if levels == 255 else 16)
    assert photo.linear.dtype == np.float32
    assert not photo.saturated.any()
    linear = read_linear(tmp_path / f"a.{suffix}", coded="linear")
    np.testing.assert_allclose(linear.linear, stored / levels, atol=1e-7)
    np.testing.assert_allclose(linear.rounding, 1 / levels / np.sqrt(12), rtol=5e-3)


def test_rounding_follows_the_curve(tmp_path: Path) -> None:
    """Rationale: sRGB spreads the shadows. Expected: rounding as a slope of the curve has it."""
    stored = np.tile(np.arange(256, dtype=np.uint8)[:, None, None], (1, 8, 3))
    photo = read_linear(save(tmp_path / "a.png", stored))
    value = np.arange(1, 255) / 255
    slope = (srgb_curve(value + 1 / 255) - srgb_curve(value - 1 / 255)) / 2
    np.testing.assert_allclose(photo.rounding[1:255, 0, 0], slope / np.sqrt(12), rtol=1e-4)


def test_float_files_are_linear(tmp_path: Path) -> None:
    values = (ramp(255) / 64).astype(np.float32)
    write_channels(tmp_path / "a.exr", {c: values[..., i] for i, c in enumerate("RGB")})
    save(tmp_path / "a.hdr", values)
    save(tmp_path / "a.tiff", values)
    for name, tolerance in (("a.exr", 1e-7), ("a.hdr", 1 / 64), ("a.tiff", 1e-7)):
        photo = read_linear(tmp_path / name)
        assert photo.bits is None
        np.testing.assert_allclose(photo.linear, values, rtol=tolerance, atol=0.02 * tolerance)


def test_a_jpeg_is_close_and_never_linear(tmp_path: Path) -> None:
    stored = ramp(255)
    path = save(tmp_path / "a.jpg", stored)
    photo = read_linear(path)
    assert np.abs(photo.linear - srgb_curve(stored / 255)).mean() < 0.02
    with pytest.raises(InputError, match=r"a\.jpg: a JPEG is never linear; give the raw"):
        read_linear(path, coded="linear")


def test_exif_is_read(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({33434: 1 / 60, 33437: 5.6, 34855: 200})
    Image.fromarray(ramp(255)).save(tmp_path / "a.jpg", exif=exif)
    photo = read_linear(tmp_path / "a.jpg")
    assert photo.exposure_s == pytest.approx(1 / 60, rel=1e-4)
    assert photo.settings.f_number == pytest.approx(5.6)
    assert photo.settings.iso == 200
    assert read_linear(tmp_path / "a.jpg", exposure_s=2.0).exposure_s == 2.0
    with pytest.raises(InputError, match="a positive time"):
        read_linear(tmp_path / "a.jpg", exposure_s=-1.0)


def test_saturation_and_white_level(tmp_path: Path) -> None:
    stored = np.full((H, W, 3), 2000, np.uint16)
    stored[3, 4] = (100, 4095, 100)
    path = save(tmp_path / "a.tiff", stored)
    photo = read_linear(path, coded="linear", white_level=4095)
    assert photo.saturated.sum() == 1
    assert photo.saturated[3, 4]
    assert photo.linear[0, 0, 0] == pytest.approx(2000 / 4095)
    assert not read_linear(path, coded="linear").saturated.any()
    with pytest.raises(InputError, match="white level"):
        read_linear(path, white_level=70000)


@pytest.mark.parametrize("pattern", BAYER_PATTERNS)
def test_demosaicing(pattern: str) -> None:
    """Rationale: bilinear interpolation. Expected: planes of colour come back exactly inside, and
    a constant everywhere; it is linear, so it commutes with subtracting a dark frame."""
    y, x = np.mgrid[0:H, 0:W].astype(float)
    rgb = np.stack([0.2 + 0.01 * x, 0.5 + 0.005 * y, 0.3 + 0.002 * (x + y)], -1)
    mosaic = mosaic_of(rgb, pattern)
    np.testing.assert_allclose(demosaiced(mosaic, pattern)[2:-2, 2:-2], rgb[2:-2, 2:-2], atol=1e-6)
    flat = mosaic_of(np.tile([0.1, 0.2, 0.3], (H, W, 1)), pattern)
    assert (flat == 0.2).sum() == 2 * (flat == 0.1).sum() == 2 * (flat == 0.3).sum()
    np.testing.assert_allclose(demosaiced(flat, pattern), np.tile([0.1, 0.2, 0.3], (H, W, 1)))
    both = demosaiced(mosaic - flat, pattern)
    np.testing.assert_allclose(
        both, demosaiced(mosaic, pattern) - demosaiced(flat, pattern), atol=1e-6
    )


@pytest.mark.parametrize("pattern", BAYER_PATTERNS)
def test_mosaics_are_noticed(tmp_path: Path, pattern: str) -> None:
    rng = np.random.default_rng(1)
    rgb = cv2.GaussianBlur(rng.random((64, 64, 3)), (0, 0), 3) * [1.0, 0.8, 0.4]
    mosaic = np.rint(255 * mosaic_of(rgb, pattern)).astype(np.uint8)
    assert looks_like_mosaic(mosaic)
    assert not looks_like_mosaic(np.rint(255 * rgb[..., 0]).astype(np.uint8))
    assert pattern in possible_patterns(mosaic)
    path = save(tmp_path / "raw.tiff", mosaic)
    with pytest.raises(InputError, match=rf"raw\.tiff: a raw Bayer mosaic.*{pattern}"):
        read_linear(path)
    photo = read_linear(path, pattern=pattern)
    assert photo.pattern == pattern
    # linear without being told, unlike colour files
    green = mosaic_of(np.tile([0, 1, 0], (64, 64, 1)), pattern) == 1
    np.testing.assert_allclose(photo.linear[green, 1], mosaic[green] / 255, atol=1e-6)
    kept = read_linear(path, pattern=pattern, keep_mosaic=True)
    np.testing.assert_allclose(kept.linear[..., 0], mosaic / 255, atol=1e-7)
    tags = {33421: (2, 2), 33422: bytes("RGB".index(c) for c in pattern)}
    Image.fromarray(mosaic).save(tmp_path / "tagged.tiff", tiffinfo=tags)
    assert read_linear(tmp_path / "tagged.tiff").pattern == pattern
    grey = read_linear(path, pattern="none")
    assert grey.pattern is None
    np.testing.assert_array_equal(grey.linear[..., 0], grey.linear[..., 2])


def test_patterns_that_make_no_sense(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", ramp(255))
    with pytest.raises(InputError, match="RGGB, BGGR, GRBG, GBRG or none"):
        read_linear(path, pattern="XYZW")
    with pytest.raises(
        InputError, match="expected a Bayer mosaic of one channel, got an image with colours"
    ):
        read_linear(path, pattern="RGGB")


def test_eight_bits_in_sixteen_are_noticed(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", ramp(255).astype(np.uint16) * 257)
    with pytest.warns(UserWarning, match=r"a\.png: a 16-bit file with 8-bit values"):
        read_linear(path)


def test_a_png_that_says_it_is_linear(tmp_path: Path) -> None:
    values = ramp(255)
    plain = save(tmp_path / "a.png", values).read_bytes()
    chunk = b"gAMA" + (100000).to_bytes(4, "big")
    chunk = (4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    (tmp_path / "b.png").write_bytes(plain[:33] + chunk + plain[33:])  # after IHDR
    assert read_linear(tmp_path / "b.png").linear == pytest.approx(values / 255, abs=1e-6)
    assert read_linear(tmp_path / "b.png", coded="srgb").linear.mean() < values.mean() / 255 - 0.1


P3_TO_SRGB = np.array([[1.2249, -0.2247, 0], [-0.0420, 1.0419, 0], [-0.0197, -0.0786, 1.0979]])
"""As CSS Color 4 has it, rounded."""


@pytest.mark.parametrize(
    ("transfer", "coded", "is_curved"),
    [(13, "auto", True), (8, "auto", False), (8, "srgb", True), (13, "linear", False)],
)
def test_display_p3(tmp_path: Path, transfer: int, coded: str, is_curved: bool) -> None:
    """Expected: `coded` decides the curve, the file the primaries, and rounding errors that are
    independent add up through the matrix."""
    values = ramp(65535)
    plain = save(tmp_path / "a.png", values).read_bytes()
    chunk = b"cICP" + bytes([12, transfer, 0, 1])
    chunk = (4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    (tmp_path / "b.png").write_bytes(plain[:33] + chunk + plain[33:])
    photo = read_linear(tmp_path / "b.png", coded=coded)
    linear = srgb_curve(values / 65535) if is_curved else values / 65535
    np.testing.assert_allclose(photo.linear, linear @ P3_TO_SRGB.T, atol=5e-4)
    as_srgb = read_linear(tmp_path / "a.png", coded="srgb" if is_curved else "linear").rounding
    expected = np.sqrt(as_srgb**2 @ (P3_TO_SRGB**2).T)
    np.testing.assert_allclose(photo.rounding, expected, rtol=2e-3)
    response = np.linspace(0, 2, 65536)
    own = read_linear(tmp_path / "b.png", coded=response)
    np.testing.assert_allclose(own.linear, values / 65535 * 2, atol=1e-5)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P", "L"])
def test_alpha_and_palettes(tmp_path: Path, mode: str) -> None:
    """Expected: colours that alpha does not multiply."""
    values = np.dstack([ramp(255), ramp(255)[..., 0]])
    picture = Image.fromarray(values if mode == "RGBA" else values[..., :3])
    picture = picture.quantize(256) if mode == "P" else picture.convert(mode)
    if mode == "LA":
        picture.putalpha(Image.fromarray(values[..., 3]))
    picture.save(tmp_path / "a.tif")
    expected = np.array(picture.convert("RGBA"))[..., :3]
    linear = read_linear(tmp_path / "a.tif", pattern="none").linear
    np.testing.assert_allclose(linear, srgb_curve(expected / 255), atol=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("size", [(24, 32), (25, 31)])
def test_a_turned_mosaic(tmp_path: Path, orientation: int, size: tuple[int, int]) -> None:
    """The CFA tag is of the pixels as stored. Expected: colours as without the turn, turned."""
    height, width = size
    stored = mosaic_of(np.tile([40, 90, 160], (height, width, 1)), "GRBG").astype(np.uint8)
    tags = {33421: (2, 2), 33422: bytes("RGB".index(c) for c in "GRBG"), 274: orientation}
    Image.fromarray(stored).save(tmp_path / "a.tif", tiffinfo=tags)
    photo = read_linear(tmp_path / "a.tif")
    assert photo.size == ((width, height) if orientation >= 5 else (height, width))
    expected = np.broadcast_to(np.array([40, 90, 160]) / 255, photo.linear.shape)
    np.testing.assert_allclose(photo.linear, expected, atol=1e-6)


def test_low_bytes_are_noticed(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    deep = ramp(65535) + rng.integers(0, 500, (H, W, 3)).astype(np.uint16)
    path = save(tmp_path / "a.png", (deep & 255).astype(np.uint8))
    with pytest.raises(InputError, match=r"a\.png: .*low bytes of 16-bit data"):
        read_linear(path)
    read_linear(save(tmp_path / "b.png", (deep >> 8).astype(np.uint8)))


def test_sizes_have_to_agree(tmp_path: Path) -> None:
    one = read_linear(save(tmp_path / "a.png", ramp(255)))
    two = read_linear(save(tmp_path / "b.png", np.ascontiguousarray(np.rot90(ramp(255)))))
    with pytest.raises(
        InputError,
        match=r"b\.png: .* one size, got 24 x 32 pixels, but .*a\.png has 32 x 24",
    ):
        check_same_size([one, two])


def test_turned_as_exif_says(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[274] = 6  # turn clockwise to look at it
    Image.fromarray(ramp(255)).save(tmp_path / "a.jpg", exif=exif, quality=100, subsampling=0)
    photo = read_linear(tmp_path / "a.jpg")
    assert photo.size == (W, H)
    turned = np.rot90(ramp(255), -1).astype(int)
    assert np.abs(read_stored(tmp_path / "a.jpg").astype(int) - turned).max() < 12


def test_what_is_shown_of_deep_files(tmp_path: Path) -> None:
    stored = ramp(65535)
    eight = read_stored(save(tmp_path / "a.png", stored))
    np.testing.assert_array_equal(eight, stored >> 8)
    light = (srgb_curve(stored / 65535) * 40).astype(np.float32)
    shown = read_stored(save(tmp_path / "a.hdr", light))
    assert shown.dtype == np.uint8
    assert np.corrcoef(shown.ravel(), stored.ravel())[0, 1] > 0.99


def test_missing_and_strange_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_linear(tmp_path / "none.png")
    (tmp_path / "text.jpg").write_text("not a picture")
    with pytest.raises(InputError, match="not an image that is read here"):
        read_linear(tmp_path / "text.jpg")


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data(), suffix=st.sampled_from(["png", "jpg", "tiff", "hdr"]))
def test_damaged_files_are_input_errors(tmp_path: Path, data: st.DataObject, suffix: str) -> None:
    values = ramp(255).astype(np.float32) / 255 if suffix == "hdr" else ramp(255)
    path = save(tmp_path / f"a.{suffix}", values)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(1, len(content)))])
    try:
        photo = read_linear(path, pattern=None)
    except InputError:
        return
    except UserWarning:
        return
    assert np.isfinite(photo.linear).all()


def test_turned_as_another_file(tmp_path: Path) -> None:
    photo = read_linear(tagged(tmp_path / "a.tif", ramp(255), 6))
    upright = read_linear(tagged(tmp_path / "b.tif", ramp(255), 1))
    np.testing.assert_array_equal(photo.turned_to(1).linear, upright.linear)
    stored = mosaic_of(np.tile([40, 90, 160], (H, W, 1)), "GRBG").astype(np.uint8)
    mosaic = read_linear(save(tmp_path / "m.tif", stored), pattern="GRBG", keep_mosaic=True)
    with pytest.raises(InputError, match=r"m\.tif: turning: expected RGB, got a mosaic"):
        mosaic.turned_to(3)


@pytest.mark.parametrize(("photo", "flat"), [(1, 3), (3, 1), (6, 8), (None, None), (1, None)])
def test_flat_and_dark_lie_as_the_photograph(
    tmp_path: Path, photo: int | None, flat: int | None
) -> None:
    """One sensor, whatever EXIF says of each file: an even sheet is even after both. Files that
    state no orientation stay as they are."""
    x = np.linspace(0.4, 1, W)
    falloff = np.broadcast_to((x * np.linspace(0.6, 1, H)[:, None])[..., None], (H, W, 3))
    glow = np.broadcast_to(np.linspace(0.0, 0.01, W)[None, :, None], (H, W, 3))
    a = tagged(tmp_path / "a.tif", stored8(0.5 * falloff + glow), photo)
    f = tagged(tmp_path / "f.tif", stored8(0.8 * falloff + glow), flat)
    d = tagged(tmp_path / "d.tif", stored8(glow), flat)
    light = developed([a], Development(coded="linear", flat=f, darks=(d,)))[0].linear
    middle = light[4:-4, 4:-4]
    assert middle.std() / middle.mean() < 0.03


def stored8(light: np.ndarray) -> np.ndarray:
    return np.rint(light * 255).astype(np.uint8)


def tagged(path: Path, rgb: np.ndarray, orientation: int | None) -> Path:
    Image.fromarray(rgb).save(path, tiffinfo={} if orientation is None else {274: orientation})
    return path
