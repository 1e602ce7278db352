"""Every kind of image file: read with the right values, or refused in one line."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels
from raden_torch.images.mask import read_mask_pixels
from raden_torch.images.pixels import (
    oriented,
    read_image,
    read_pixels,
    turned_to,
    write_pixels,
)
from tests.tiff import tiff

H, W = 6, 7


def values(kind: str, channels: int = 3, seed: int = 0) -> np.ndarray:
    """`[H, W]` or `[H, W, channels]` of all that the type holds; floats 0…2."""
    rng, dtype = np.random.default_rng(seed), np.dtype(kind)
    shape = (H, W) if channels == 1 else (H, W, channels)
    if dtype.kind == "f":
        return (2 * rng.random(shape)).astype(dtype)
    return rng.integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)


def png(pixels: np.ndarray, colour_type: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG of 8 or 16 bits, with chunks before its pixels."""
    height, width = pixels.shape[:2]
    depth = 8 * pixels.dtype.itemsize
    rows = b"".join(b"\0" + row.astype(row.dtype.newbyteorder(">")).tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, depth, colour_type, 0, 0, 0)
    parts = [(b"IHDR", header), *chunks, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    out = b"\x89PNG\r\n\x1a\n"
    for name, data in parts:
        out += struct.pack(">I", len(data)) + name + data
        out += struct.pack(">I", zlib.crc32(name + data))
    return out


def put(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def refused(path: Path, read: Callable[[Path], Any] = read_image) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("kind", ["u1", "u2", "f4", "f8", "i2", "i4", "u4"])
@pytest.mark.parametrize(("channels", "extra"), [(1, ()), (3, ()), (4, (2,)), (4, (0,)), (4, ())])
def test_tiffs(tmp_path: Path, kind: str, channels: int, extra: tuple[int, ...]) -> None:
    stored = values(kind, channels)
    image = read_image(put(tmp_path / "a.tif", tiff(stored, extra=extra)))
    assert image.pixels.dtype == stored.dtype
    np.testing.assert_array_equal(image.pixels, stored if channels == 1 else stored[..., :3])
    if channels == 4 and extra != (0,):  # 0: what the channel means is not said
        np.testing.assert_array_equal(image.alpha, stored[..., 3])
    else:
        assert image.alpha is None


@pytest.mark.parametrize(("kind", "top"), [("u1", 255), ("u2", 65535), ("f4", 1)])
def test_associated_alpha_is_divided_out(tmp_path: Path, kind: str, top: int) -> None:
    """TIFF 6.0, ExtraSamples 1. Expected: colour over alpha, within half a stored step over alpha;
    floats under no alpha keep their colour."""
    rng = np.random.default_rng(1)
    alpha = rng.integers(top // 4 + 1, top, (H, W), endpoint=True) / top
    alpha = alpha if top > 1 else 0.25 + 0.75 * rng.random((H, W))
    colour = rng.random((H, W, 3))
    stored = np.dstack([colour * alpha[..., None], alpha]) * top
    stored = np.rint(stored).astype(kind) if top > 1 else stored.astype(kind)
    stored[0, 0] = (0, 0, 0, 0) if top > 1 else (3, 2, 1, 0)
    image = read_image(put(tmp_path / "a.tif", tiff(stored, extra=(1,))))
    step = (1 / alpha.min() if top > 1 else 1e-5) + 0.5
    away = np.abs(image.pixels.astype(float) / top - colour)[1:]
    assert away.max() < step / top if top > 1 else away.max() < 1e-5
    assert image.pixels[0, 0].tolist() == ([0, 0, 0] if top > 1 else [3, 2, 1])
    np.testing.assert_array_equal(image.alpha, stored[..., 3])


def test_a_grey_tiff_that_counts_down(tmp_path: Path) -> None:
    for kind, top in (("u1", 255), ("u2", 65535)):
        stored = values(kind, 1)
        image = read_image(put(tmp_path / "a.tif", tiff(stored, photometric=0)))
        np.testing.assert_array_equal(image.pixels, top - stored)


def test_tiffs_that_are_grey_with_alpha_or_in_planes(tmp_path: Path) -> None:
    both = values("u1", 2)
    image = read_image(put(tmp_path / "a.tif", tiff(both, extra=(2,))))
    np.testing.assert_array_equal(np.dstack([image.pixels, image.alpha]), both)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.tif", colour=False), both)
    planes = values("u1")
    image = read_image(put(tmp_path / "b.tif", tiff(planes, planar=True)))
    np.testing.assert_array_equal(image.pixels, planes)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (tiff(values("u2", 2), extra=(2,)), "2 channels of 16 bits"),
        (tiff(values("u2"), planar=True), "planes of 16 bits"),
        (tiff(values("f4"), planar=True), "planes of 32 bits"),
        (tiff(values("u1"), photometric=8), "got Lab"),
        (tiff(values("u2"), photometric=8), "got Lab"),
        (tiff(values("u1", 4), photometric=5), "got CMYK"),
        (tiff(values("u2", 4), photometric=5), "got CMYK"),
        (tiff(values("f2")), "got float 16 bits"),
        (tiff(values("i1")), "got signed 8 bits"),
        (tiff(values("f4", 1), photometric=0), "got float 32 bits"),
        (tiff(values("u2", 5), extra=(2, 0)), "5 channels"),
        (tiff(values("u2"), pages=2), "expected one image, got 2 frames"),
        (tiff(values("u2"))[:-40], "damaged"),
        (tiff(values("u2"))[:40], "damaged"),
        (tiff(values("u2"), _277=(2, [0x58])), "damaged"),
        (tiff(values("u2"), _257=(4, [2**30])), "pixels in all"),
        (tiff(values("u2", 1), _259=(3, [4711])), "damaged"),
    ],
)
def test_tiffs_that_would_be_spoiled_are_refused(
    tmp_path: Path, content: bytes, words: str
) -> None:
    assert words in refused(put(tmp_path / "a.tif", content))


def test_a_deep_tiffs_profile_is_found(tmp_path: Path) -> None:
    content = tiff(values("u2"), _34675=(1, list(b"a profile")))
    image = read_image(put(tmp_path / "a.tif", content))
    assert image.header.colour.icc == b"a profile"


def test_a_preview_beside_the_image_does_not_count(tmp_path: Path) -> None:
    picture, preview = Image.fromarray(values("u1")), Image.new("RGB", (2, 2))
    preview.encoderinfo = {"tiffinfo": {254: 1}}
    picture.save(tmp_path / "a.tif", save_all=True, append_images=[preview])
    assert read_image(tmp_path / "a.tif").pixels.shape == (H, W, 3)


@pytest.mark.parametrize("kind", ["u1", "u2"])
@pytest.mark.parametrize(("colour_type", "channels"), [(0, 1), (4, 2), (2, 3), (6, 4)])
def test_pngs(tmp_path: Path, kind: str, colour_type: int, channels: int) -> None:
    stored = values(kind, channels)
    image = read_image(put(tmp_path / "a.png", png(stored, colour_type)))
    assert image.pixels.dtype == stored.dtype
    if channels == 1:
        np.testing.assert_array_equal(image.pixels, stored)
        return
    colour = stored[..., :1].repeat(3, 2) if channels == 2 else stored[..., :3]
    np.testing.assert_array_equal(image.rgb, colour)
    if channels % 2 == 0:
        np.testing.assert_array_equal(image.alpha, stored[..., -1])


def test_transparent_colours_of_a_png(tmp_path: Path) -> None:
    for kind, top in (("u1", 255), ("u2", 65535)):
        stored = values(kind)
        key = struct.pack(">3H", *(int(v) for v in stored[2, 3]))
        image = read_image(put(tmp_path / "a.png", png(stored, 2, (b"tRNS", key))))
        np.testing.assert_array_equal(image.pixels, stored)
        expected = np.full((H, W), top)
        expected[2, 3] = 0
        np.testing.assert_array_equal(image.alpha, expected)
    grey = png(values("u2", 1), 0, (b"tRNS", b"\0\1"))
    assert "transparent grey" in refused(put(tmp_path / "g.png", grey))


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "PA", "LA", "RGBA", "RGBX"])
@pytest.mark.parametrize("suffix", ["png", "tif", "bmp", "gif", "ppm", "webp"])
def test_pillows_modes(tmp_path: Path, mode: str, suffix: str) -> None:
    """Expected: what Pillow shows in RGBA."""
    rgba = Image.fromarray(values("u1", 4))
    if mode == "PA":
        picture = rgba.convert("RGB").quantize(16).convert("PA")
    elif mode == "P":
        picture = rgba.convert("RGB").quantize(16)
    else:
        picture = rgba.convert(mode if mode in ("LA", "RGBA") else "RGB").convert(mode)
    path = tmp_path / f"a.{suffix}"
    try:
        picture.save(path, **({"lossless": True, "exact": True} if suffix == "webp" else {}))
    except (OSError, ValueError):
        pytest.skip("the format has no such pixels")
    with Image.open(path) as opened:
        expected = np.array(opened.convert("RGBA"))
    image = read_image(path)
    np.testing.assert_array_equal(image.rgb, expected[..., :3])
    alpha = 255 if image.alpha is None else image.alpha
    np.testing.assert_array_equal(np.broadcast_to(alpha, (H, W)), expected[..., 3])


def test_a_palette_with_transparency(tmp_path: Path) -> None:
    picture = Image.fromarray(values("u1")).quantize(8)
    picture.save(tmp_path / "a.png", transparency=bytes([0, 100, 255, 7]))
    with Image.open(tmp_path / "a.png") as opened:
        expected = np.array(opened.convert("RGBA"))
    image = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(np.dstack([image.pixels, image.alpha]), expected)
    assert set(np.unique(image.alpha)) >= {0, 100}


@pytest.mark.parametrize(("mode", "suffix"), [("CMYK", "jpg"), ("CMYK", "tif"), ("LAB", "tif")])
def test_print_colours_are_refused(tmp_path: Path, mode: str, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    Image.new(mode, (W, H)).save(path)
    assert "expected grey or RGB, got " in refused(path)


@pytest.mark.parametrize("suffix", ["gif", "png", "webp", "tif"])
def test_several_frames_are_refused(tmp_path: Path, suffix: str) -> None:
    frames = [Image.fromarray(values("u1", seed=k)) for k in range(3)]
    path = tmp_path / f"a.{suffix}"
    frames[0].save(path, save_all=True, append_images=frames[1:])
    assert "expected one image, got 3 frames" in refused(path)
    frames[0].save(path, save_all=True)
    assert read_image(path).pixels.shape[:2] == (H, W)


def test_the_main_picture_of_a_phones_jpeg(tmp_path: Path) -> None:
    """An MPO holds the photograph first, then its depth or gain map."""
    first, second = (Image.new("RGB", (16, 8), grey) for grey in ("#808080", "#000000"))
    path = tmp_path / "a.jpg"
    first.save(path, format="MPO", save_all=True, append_images=[second])
    np.testing.assert_allclose(read_image(path).pixels, 128, atol=1)


def test_pnm_and_hdr(tmp_path: Path) -> None:
    deep = values("u2")
    head = b"7 6\n65535\n"
    path = put(tmp_path / "a.ppm", b"P6\n" + head + deep.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(path).pixels, deep)
    path = put(tmp_path / "a.pgm", b"P5\n" + head + deep[..., 0].astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(path).pixels, deep[..., 0])
    path = put(tmp_path / "b.pgm", b"P5\n7 6\n4095\n" + bytes(2 * H * W))
    assert "levels up to 255 or 65535, got 4095" in refused(path)
    bright = 100 * values("f4")
    cv2.imwrite(str(tmp_path / "a.hdr"), bright[..., ::-1])
    near = read_image(tmp_path / "a.hdr").pixels
    assert (np.abs(near - bright) <= bright.max(axis=2, keepdims=True) / 128).all()
    content = (tmp_path / "a.hdr").read_bytes()
    xyze = content.replace(b"rgbe", b"xyze")
    assert "got XYZ" in refused(put(tmp_path / "x.hdr", xyze))
    turned = content.replace(b"-Y 6 +X 7", b"+X 7 -Y 6")
    assert "rows from the top" in refused(put(tmp_path / "t.hdr", turned))


@pytest.mark.parametrize("name", ["a.avif", "a.ico", "a.pcx"])
def test_other_formats_are_refused(tmp_path: Path, name: str) -> None:
    Image.fromarray(values("u1")).save(tmp_path / name)
    assert "expected a PNG, JPEG, TIFF" in refused(tmp_path / name)


@pytest.mark.parametrize("own", range(1, 9))
@pytest.mark.parametrize("wanted", range(1, 9))
def test_one_orientation_instead_of_another(own: int, wanted: int) -> None:
    grey = values("u1", 1)
    found = turned_to(oriented(grey, own), own, wanted)
    np.testing.assert_array_equal(found, oriented(grey, wanted))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_followed_everywhere(tmp_path: Path, orientation: int) -> None:
    """Photographs, normal maps and masks, of every depth. Expected: as Pillow turns them."""
    exif = Image.Exif()
    exif[274] = orientation
    grey = values("u1", 1)
    shown = Image.fromarray(grey)
    shown.getexif()[274] = orientation
    expected = np.asarray(ImageOps.exif_transpose(shown))
    np.testing.assert_array_equal(oriented(grey, orientation), expected)
    block = (b"eXIf", exif.tobytes()[6:])
    tag = {"_274": (3, [orientation])}
    rgb = np.dstack([grey] * 3)
    contents = {
        "8.png": png(rgb, 2, block),
        "16.png": png(rgb * np.uint16(257), 2, block),
        "g.png": png(grey, 0, block),
        "8.tif": tiff(rgb, **tag),
        "16.tif": tiff(rgb * np.uint16(257), **tag),
        "g.tif": tiff(grey, **tag),
        "f.tif": tiff(grey.astype(np.float32), **tag),
    }
    for name, content in contents.items():
        path = put(tmp_path / name, content)
        for colour in (False, True):
            read = read_pixels(path, colour=colour)
            first = read[..., 0] if read.ndim == 3 else read
            scale = 257 if name.startswith("16") else 1
            np.testing.assert_array_equal(first, expected.astype(float) * scale, err_msg=name)
        top = grey.max() if name[0] == "f" else 255 * (257 if name.startswith("16") else 1)
        if name[0] != "f":
            mask = read_mask_pixels(path)
            np.testing.assert_allclose(mask, first / top, atol=1e-6)
    Image.new("RGB", (8, 16)).save(tmp_path / "a.jpg", exif=exif)
    assert read_image(tmp_path / "a.jpg").pixels.shape[:2] == (
        (8, 16) if orientation >= 5 else (16, 8)
    )


@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
@pytest.mark.parametrize("suffix", ["png", "tif", "tiff"])
@pytest.mark.parametrize("has_alpha", [False, True])
def test_what_is_written_is_read(tmp_path: Path, kind: str, suffix: str, has_alpha: bool) -> None:
    """Expected: the same values, by Pillow as well as by this reader."""
    if kind == "f4" and suffix == "png":
        pytest.skip("PNG has no floats")
    stored, path = values(kind, 4), tmp_path / f"a.{suffix}"
    write_pixels(stored[..., :3], path, stored[..., 3] if has_alpha else None)
    image = read_image(path)
    np.testing.assert_array_equal(image.pixels, stored[..., :3])
    assert (image.alpha is not None) == has_alpha
    if has_alpha:
        np.testing.assert_array_equal(image.alpha, stored[..., 3])
        assert suffix == "png" or image.header.tags[338] == (2,)
    if kind == "u1":
        with Image.open(path) as opened:
            by_pillow = np.array(opened)
        np.testing.assert_array_equal(by_pillow, stored if has_alpha else stored[..., :3])
    by_opencv = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if not (has_alpha and kind == "u1" and suffix != "png"):  # which OpenCV multiplies by alpha
        order = [2, 1, 0, 3] if has_alpha else [2, 1, 0]
        np.testing.assert_array_equal(by_opencv, stored[..., order])


MASK = np.linspace(0, 1, H * W).reshape(H, W)


@pytest.mark.parametrize(
    ("content", "tolerance"),
    [
        (tiff(np.rint(MASK * 255).astype("u1")), 1 / 255),
        (tiff(np.rint(MASK * 65535).astype("u2")), 1 / 65535),
        (tiff(MASK.astype("f4")), 1e-6),
        (tiff(MASK.astype("f8")), 1e-6),
        (png(np.dstack([np.zeros((H, W, 3)), np.rint(MASK * 255)]).astype("u1"), 6), 1 / 255),
        (png(np.dstack([np.zeros((H, W)), np.rint(MASK * 65535)]).astype("u2"), 4), 1 / 65535),
        # opaque: the picture is the mask
        (png(np.dstack([*[np.rint(MASK * 255)] * 3, np.full((H, W), 255)]).astype("u1"), 6), 0.004),
    ],
)
def test_masks(tmp_path: Path, content: bytes, tolerance: float) -> None:
    path = put(tmp_path / "a.tif", content)  # its content says what it is
    np.testing.assert_allclose(read_mask_pixels(path), MASK, atol=tolerance)


@pytest.mark.parametrize("kind", ["u1", "u2", "i2", "i4", "u4", "f4"])
def test_masks_of_zeros_and_ones(tmp_path: Path, kind: str) -> None:
    where = (MASK > 0.5).astype(kind)
    path = put(tmp_path / "a.tif", tiff(where))
    np.testing.assert_array_equal(read_mask_pixels(path), where)


@pytest.mark.parametrize(
    ("stored", "got"),
    [
        (np.rint(MASK * 255).astype("u2"), "uint16 from 0 to 255"),
        (np.rint(MASK * 255).astype("i2"), "int16 from 0 to 255"),
        (np.rint(MASK * 255).astype("i4"), "int32 from 0 to 255"),
        (np.rint(MASK * 1e9).astype("u4"), "uint32 from 0 to 1e"),
        ((MASK * 255).astype("f4"), "float32 from 0 to 255"),
        ((MASK - 0.5).astype("f4"), "float32 from -0.5"),
        (np.full((H, W), np.nan, "f4"), "not finite"),
    ],
)
def test_numbers_that_are_no_mask(tmp_path: Path, stored: np.ndarray, got: str) -> None:
    path = put(tmp_path / "a.tif", tiff(stored))
    assert got in refused(path, read_mask_pixels)


def test_masks_in_exr(tmp_path: Path) -> None:
    mask, dark = MASK.astype(np.float32), np.zeros((H, W), np.float32)
    for channels in (
        {"A": mask, "R": dark, "G": dark, "B": dark},
        {"Y": mask},
        {"matte": mask},
        {"R": dark, "G": mask, "B": dark},
    ):
        write_channels(tmp_path / "a.exr", channels)
        np.testing.assert_allclose(read_mask_pixels(tmp_path / "a.exr"), mask)
    write_channels(tmp_path / "a.exr", {"u": mask, "v": mask})
    assert "expected a mask in A, Y or R, G and B" in refused(tmp_path / "a.exr", read_mask_pixels)


@pytest.mark.parametrize("name", ["a.png", "b.png", "a.tif", "b.tif", "a.jpg", "a.gif", "a.bmp"])
def test_damaged_files_are_refused_in_a_line(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Truncations and changed bytes. Expected: an image or one line, and nothing else."""
    rng = np.random.default_rng(2)
    path = tmp_path / name
    if name[0] == "b":
        write_pixels(values("u2"), path, values("u2", 1))
    else:
        Image.fromarray(values("u1")).save(path)
    whole = path.read_bytes()
    cut = [whole[: int(k)] for k in rng.integers(0, len(whole), 20)]
    for _ in range(60):
        changed = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            changed[place] = rng.integers(256)
        cut.append(bytes(changed))
    for content in cut:
        try:
            read_image(put(path, content))
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017
    assert "OpenCV" not in capfd.readouterr().err


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "bmp", "ppm", "hdr"])
@pytest.mark.parametrize("deep", [False, True])
def test_a_file_cut_short_is_no_image(tmp_path: Path, suffix: str, deep: bool) -> None:
    stored = np.random.default_rng(0).integers(0, 65536, (60, 50, 3)).astype(np.uint16)
    stored = stored if deep and suffix in ("png", "tif", "ppm") else (stored >> 8).astype(np.uint8)
    path = tmp_path / f"a.{suffix}"
    write_pixels(stored, path)
    whole = path.read_bytes()
    for share in (0.5, 0.95):
        refused(put(path, whole[: int(share * len(whole))]))
