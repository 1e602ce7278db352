"""Photographs of every kind in, relit photographs of every kind out: values, alpha, colours."""

from __future__ import annotations

import io
import math
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image

import raden_torch as rt
from raden_torch.brdf.files.display import Display
from raden_torch.brdf.files.image_file import (
    Photograph,
    read_mask,
    read_normal_map,
    read_photograph,
    write_photograph,
)
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.shading.relight import lamp_ring
from raden_torch.errors import InputError
from raden_torch.images.exr import read_channels, write_channels
from raden_torch.relighting import relight_files

H, W = 6, 7


def srgb_curve(coded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, written out: nothing is shared with the reader."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def rgba(top: int, seed: int = 0) -> np.ndarray:
    """`[H, W, 4]`; some pixels under no alpha keep their colours."""
    stored = np.random.default_rng(seed).integers(0, top, (H, W, 4), endpoint=True)
    stored[0, :3, 3] = (0, top, 0)
    return stored.astype(np.uint8 if top == 255 else np.uint16)


def save(path: Path, pixels: np.ndarray) -> Path:
    """By OpenCV, of which the colours come first in another order."""
    stored = pixels[..., [2, 1, 0, 3][: pixels.shape[2]]] if pixels.ndim == 3 else pixels
    assert cv2.imwrite(str(path), stored)
    return path


def one(image: torch.Tensor) -> np.ndarray:
    """`[1, C, H, W]` → `[H, W, C]`."""
    return image[0].movedim(0, -1).numpy()


SOURCES = {
    "L": lambda p: Image.fromarray(p[..., 0]),
    "LA": lambda p: Image.fromarray(p[..., [0, 3]]),
    "RGB": lambda p: Image.fromarray(p[..., :3]),
    "RGBA": Image.fromarray,
    "P": lambda p: Image.fromarray(p[..., :3]).quantize(64),
}
FLOAT_SUFFIXES = (".exr", ".hdr")


def check_against(expected: np.ndarray, alpha: np.ndarray, path: Path, tolerance: float) -> None:
    """What independent readers find in a file: linear colours, not multiplied, and alpha.

    Args:
        expected: `[H, W, 3]` linear.
        alpha: `[H, W]`, 0…1.
    """
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            maps = {name: channel.pixels for name, channel in file.channels().items()}
        found = np.dstack([maps[c] for c in "RGB"])
        shown = np.where(alpha > 0, alpha, 1)[..., None] * expected
        np.testing.assert_allclose(found, shown, atol=1e-6)
        np.testing.assert_allclose(maps.get("A", np.ones((H, W))), alpha, atol=1e-6)
        return
    if path.suffix == ".hdr":
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
        assert (np.abs(found - expected) <= expected.max(axis=2, keepdims=True) / 100 + 1e-6).all()
        return
    if tolerance > 1 / 300:  # 8 bits
        with Image.open(path) as picture:
            found = np.array(picture.convert("RGBA")) / 255
    else:
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 65535
        found = found[..., [2, 1, 0, 3][: found.shape[2]]]
    coded = np.where(
        expected <= 0.0031308,
        12.92 * expected,
        1.055 * np.maximum(expected, 1e-9) ** (1 / 2.4) - 0.055,
    )
    np.testing.assert_allclose(found[..., :3], coded, atol=tolerance)
    if found.shape[2] == 4 and path.suffix != ".jpg":
        np.testing.assert_allclose(found[..., 3], alpha, atol=tolerance)
    else:
        assert path.suffix == ".jpg" or (alpha == 1).all()


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("stored_as", [".png", ".tif", ".bmp", ".webp"])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".exr", ".hdr"])
def test_eight_bits(tmp_path: Path, source: str, stored_as: str, suffix: str) -> None:
    if stored_as == ".bmp" and source in ("LA", "RGBA"):
        pytest.skip("Pillow writes no alpha into a BMP")
    if suffix == ".jpg":
        smooth = np.linspace(40, 200, H * W).reshape(H, W, 1).repeat(4, 2)
        pixels = np.rint(smooth).astype(np.uint8)
    else:
        pixels = rgba(255)
    picture = SOURCES[source](pixels)
    path = tmp_path / f"in{stored_as}"
    picture.save(path, **({"lossless": True, "exact": True} if stored_as == ".webp" else {}))
    truth = np.array(picture.convert("RGBA")) / 255
    photo = read_photograph(path)
    expected = srgb_curve(truth[..., :3])
    np.testing.assert_allclose(one(photo.linear), expected, atol=1e-6)
    assert photo.levels == 255
    out = tmp_path / f"out{suffix}"
    if suffix in (".jpg", ".hdr") and (truth[..., 3] < 1).any():
        with pytest.warns(UserWarning, match=f"alpha is left out: {suffix} has none"):
            write_photograph(photo, out)
    else:
        write_photograph(photo, out)
    check_against(expected, truth[..., 3], out, 0.02 if suffix == ".jpg" else 1 / 254)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("stored_as", [".png", ".tif"])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".exr", ".hdr"])
def test_sixteen_bits(tmp_path: Path, channels: int, stored_as: str, suffix: str) -> None:
    pixels = rgba(65535)
    pixels = pixels[..., 0] if channels == 1 else pixels[..., :channels]
    truth = np.dstack([pixels] * 3) if channels == 1 else pixels
    photo = read_photograph(save(tmp_path / f"in{stored_as}", pixels))
    expected = srgb_curve(truth[..., :3] / 65535)
    np.testing.assert_allclose(one(photo.linear), expected, atol=1e-6)
    alpha = truth[..., 3] / 65535 if channels == 4 else np.ones((H, W))
    out = tmp_path / f"out{suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if suffix == ".hdr" else "error")
        write_photograph(photo, out)
    check_against(expected, alpha, out, 1.1 / 65535)


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("suffix", [".exr", ".tif", ".hdr"])
def test_an_exrs_alpha_multiplies_its_colours(tmp_path: Path, half: bool, suffix: str) -> None:
    """OpenEXR's colours are multiplied by alpha. Expected: they come back bit by bit as halves,
    also what glows under no alpha and what is above 1 or below 0."""
    rng = np.random.default_rng(0)
    alpha = rng.random((H, W)).astype(np.float16)
    alpha[0, :3] = (0, 1, 0)
    maps = {c: (3 * rng.random((H, W)) - 0.5).astype(np.float16) for c in "RGB"} | {"A": alpha}
    maps["R"][0, 0] = 40000
    write_channels(tmp_path / "in.exr", maps, half=half)
    photo = read_photograph(tmp_path / "in.exr")
    assert photo.levels is None
    np.testing.assert_array_equal(photo.alpha[0, 0].numpy(), alpha)
    out = tmp_path / f"out{suffix}"
    if suffix == ".hdr":
        with pytest.warns(UserWarning, match="alpha is left out"):
            write_photograph(photo, out)
        return
    write_photograph(photo, out)
    if suffix == ".tif":
        bgra = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(bgra[..., [2, 1, 0]], one(photo.linear))
        np.testing.assert_array_equal(bgra[..., 3], alpha)
        np.testing.assert_array_equal(one(read_photograph(out).linear), one(photo.linear))
        return
    found = read_channels(out)
    for name, stored in maps.items():
        np.testing.assert_array_equal(found[name].astype(np.float16), stored)


def test_alpha_of_a_layer(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    maps = {f"View.Combined.{c}": rng.random((H, W)).astype(np.float32) for c in "RGBA"}
    write_channels(tmp_path / "a.exr", maps | {"View.Depth.Z": np.ones((H, W), np.float32)})
    photo = read_photograph(tmp_path / "a.exr")
    np.testing.assert_array_equal(photo.alpha[0, 0].numpy(), maps["View.Combined.A"])


@pytest.mark.parametrize("has_alpha", [False, True])
def test_a_grey_exr(tmp_path: Path, has_alpha: bool) -> None:
    maps = {c: np.random.default_rng(0).random((H, W)).astype(np.float32) + 0.1 for c in "YA"}
    maps["A"] = np.minimum(maps["A"], 1)
    write_channels(tmp_path / "a.exr", maps if has_alpha else {"Y": maps["Y"]})
    photo = read_photograph(tmp_path / "a.exr")
    expected = maps["Y"] / maps["A"] if has_alpha else maps["Y"]
    np.testing.assert_allclose(one(photo.linear), np.dstack([expected] * 3), rtol=1e-6)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_float_tiffs(tmp_path: Path, channels: int) -> None:
    """Grey and RGBA too; nothing that is not finite goes on."""
    pixels = (3 * np.random.default_rng(0).random((H, W, 4)) - 1).astype(np.float32)
    pixels[..., 3] = np.clip(pixels[..., 3], 0, 1)
    pixels = pixels[..., 0] if channels == 1 else pixels[..., :channels]
    photo = read_photograph(save(tmp_path / "a.tif", pixels))
    truth = np.dstack([pixels] * 3) if channels == 1 else pixels
    np.testing.assert_array_equal(one(photo.linear), truth[..., :3])
    write_photograph(photo, tmp_path / "b.tif")
    again = read_photograph(tmp_path / "b.tif")
    assert torch.equal(again.linear, photo.linear)
    assert (again.alpha is None) == (channels < 4)
    broken = pixels.copy()
    broken[0, 0] = np.nan
    broken[0, 1] = np.inf
    photo = read_photograph(save(tmp_path / "c.tif", broken))
    assert photo.linear.isfinite().all()
    assert (photo.linear[..., 0, :2] == 0).all()


def test_whole_numbers_of_other_sizes(tmp_path: Path) -> None:
    Image.fromarray(np.arange(H * W, dtype=np.int32).reshape(H, W)).save(tmp_path / "a.tif")
    for read in (read_photograph, read_mask):
        with pytest.raises(InputError, match=r"a\.tif: expected .*int32"):
            read(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("levels", "suffix"),
    [(255, ".webp"), (65535, ".bmp"), (None, ".png"), (None, ".jpg"), (255, "")],
)
def test_a_suffix_that_cannot_hold_it(tmp_path: Path, levels: int | None, suffix: str) -> None:
    photo = Photograph(torch.zeros(1, 3, H, W), levels)
    with pytest.raises(
        InputError, match=r"photograph: expected a file name that ends in \."
    ) as caught:
        write_photograph(photo, tmp_path / f"a{suffix}")
    assert "\n" not in str(caught.value)


def test_a_caption_shows_on_what_is_transparent(tmp_path: Path) -> None:
    photo = Photograph(torch.full((1, 3, 40, 300), 0.5), 65535, torch.zeros(1, 1, 40, 300))
    write_photograph(photo, tmp_path / "a.png", "simulated specimen")
    alpha = read_photograph(tmp_path / "a.png").alpha
    assert 0.02 < (alpha > 0.5).float().mean() < 0.5
    assert (alpha[..., :20, :] == 0).all()
    tiny = Photograph(torch.full((1, 3, 3, 2), 0.5), 255)
    write_photograph(tiny, tmp_path / "b.png", "simulated specimen")


def png_with(pixels: np.ndarray, *chunks: tuple[bytes, bytes]) -> bytes:
    """OpenCV's PNG with chunks after its header."""
    ok, data = cv2.imencode(".png", pixels[..., ::-1])
    assert ok
    content = data.tobytes()
    added = b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )
    return content[:33] + added + content[33:]


P3_TO_SRGB = np.array([[1.2249, -0.2247, 0], [-0.0420, 1.0419, 0], [-0.0197, -0.0786, 1.0979]])
"""As CSS Color 4 has it, rounded."""
CICP_P3 = (b"cICP", bytes([12, 13, 0, 1]))


def test_a_wide_gamut_photograph_becomes_srgb(tmp_path: Path) -> None:
    """Expected: P3 through the published matrix, unclipped; and said, where sRGB cannot hold it."""
    pixels = rgba(65535)[..., :3]
    (tmp_path / "a.png").write_bytes(png_with(pixels, CICP_P3))
    with pytest.warns(UserWarning, match=r"a\.png: .* of its pixels are outside sRGB"):
        photo = read_photograph(tmp_path / "a.png")
    expected = srgb_curve(pixels / 65535) @ P3_TO_SRGB.T
    np.testing.assert_allclose(one(photo.linear), expected, atol=5e-4)
    dull = (32768 + pixels // 16).astype(np.uint16)  # inside sRGB: nothing to say
    (tmp_path / "b.png").write_bytes(png_with(dull, CICP_P3))
    photo = read_photograph(tmp_path / "b.png")
    write_photograph(photo, tmp_path / "c.png")
    again = read_photograph(tmp_path / "c.png")
    torch.testing.assert_close(again.linear, photo.linear, atol=5e-5, rtol=0)
    linear = read_photograph(tmp_path / "b.png", coded="linear")
    np.testing.assert_allclose(one(linear.linear), dull / 65535 @ P3_TO_SRGB.T, atol=5e-4)


def test_a_png_of_linear_light(tmp_path: Path) -> None:
    pixels = rgba(65535)[..., :3]
    (tmp_path / "a.png").write_bytes(png_with(pixels, (b"gAMA", struct.pack(">I", 100000))))
    np.testing.assert_allclose(
        one(read_photograph(tmp_path / "a.png").linear), pixels / 65535, atol=1e-6
    )


def test_an_exrs_primaries(tmp_path: Path) -> None:
    rgb = np.random.default_rng(0).random((H, W, 3)).astype(np.float32)
    header: dict[str, Any] = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "chromaticities": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    }
    channels = {c: np.ascontiguousarray(rgb[..., i]) for i, c in enumerate("RGB")}
    OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
    photo = read_photograph(tmp_path / "a.exr")
    np.testing.assert_allclose(one(photo.linear), rgb @ P3_TO_SRGB.T, atol=5e-4)


def test_normal_maps_and_masks_are_no_colours(tmp_path: Path) -> None:
    """Expected: chunks and profiles change nothing in them."""
    pixels = rgba(65535)[..., :3]
    save(tmp_path / "plain.png", pixels)
    linear = (b"gAMA", struct.pack(">I", 100000))
    for name, chunk in (("p3", CICP_P3), ("gamma", linear), ("icc", (b"iCCP", b"x\0\0broken"))):
        (tmp_path / f"{name}.png").write_bytes(png_with(pixels, chunk))
        for read in (read_normal_map, read_mask):
            found = read(tmp_path / f"{name}.png")
            assert torch.equal(found, read(tmp_path / "plain.png"))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """White, and Lambertian: what a lamp straight ahead makes of it is its irradiance over π."""
    table = torch.full((10, 19, 19, 3), 1 / math.pi)
    path = tmp_path_factory.mktemp("model") / "m.safetensors"
    white = ReflectanceTable(table, (0.0, -90.0, -90.0), (10.0, 10.0, 10.0))
    rt.save_model(rt.RadenBrdf(None, white), path)
    return path


@pytest.fixture
def scene(tmp_path: Path, model: Path) -> dict[str, Any]:
    """Normals that face the camera, the right half relit."""
    save(tmp_path / "n.png", np.full((H, W, 3), (32768, 32768, 65535), np.uint16))
    mask = np.zeros((H, W), np.uint8)
    mask[:, 4:] = 255
    save(tmp_path / "m.png", mask)
    lamp = rt.DirectionalLight((0, 0, 1), irradiance=math.pi / 2)
    return {
        "normals": tmp_path / "n.png",
        "mask": tmp_path / "m.png",
        "model": model,
        "lights": [lamp],
        "display": Display(0.0),
    }


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_alpha_is_kept_when_relit(tmp_path: Path, scene: dict[str, Any], name: str) -> None:
    pixels = rgba(65535)
    save(tmp_path / name, pixels)
    out = tmp_path / f"out_{name}"
    relight_files([tmp_path / name], output=out, **scene)
    found = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)[..., [2, 1, 0, 3]]
    np.testing.assert_array_equal(found[..., 3], pixels[..., 3])
    np.testing.assert_array_equal(found[:, :4], pixels[:, :4])
    half = 65535 * (1.055 * 0.5 ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(found[:, 4:, :3], half, atol=5)
    strip, three = tmp_path / f"strip_{name}", scene | {"lights": lamp_ring(3)}
    relight_files([tmp_path / name], output=strip, **three, layout="strip")
    found = cv2.imread(str(strip), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found[..., 3], np.tile(pixels[..., 3], 3))
    with pytest.warns(UserWarning, match="a contact sheet is opaque"):
        relight_files([tmp_path / name], output=tmp_path / f"sheet_{name}", **three, layout="sheet")


def test_what_an_exr_covers_in_part_is_relit_in_part(tmp_path: Path, scene: dict[str, Any]) -> None:
    """Expected: colours times alpha, so the relit radiance of 0.5 times alpha; 0.5 where something
    glows under no alpha; the rest as it was."""
    rng = np.random.default_rng(0)
    maps = {c: rng.random((H, W)).astype(np.float32) for c in "RGBA"}
    maps["A"][0] = 0
    write_channels(tmp_path / "a.exr", maps)
    relight_files([tmp_path / "a.exr"], output=tmp_path / "b.exr", **scene)
    found = read_channels(tmp_path / "b.exr")
    assert set(found) == set("RGBA")
    np.testing.assert_array_equal(found["A"], maps["A"])
    for c in "RGB":
        np.testing.assert_allclose(found[c][:, :4], maps[c][:, :4], rtol=1e-6)
        cover = np.where(maps["A"] > 0, maps["A"], 1)
        np.testing.assert_allclose(found[c][:, 4:], 0.5 * cover[:, 4:], atol=1e-4)


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_a_turned_photograph_meets_its_mask(
    tmp_path: Path, scene: dict[str, Any], orientation: int
) -> None:
    """EXIF turns the photograph; mask and normals were drawn on what is seen. Expected: the mask's
    part is relit, upright."""
    shown = rgba(255)[..., :3]
    ways = {3: Image.Transpose.ROTATE_180, 6: Image.Transpose.ROTATE_90}
    way = ways.get(orientation, Image.Transpose.ROTATE_270)
    exif = Image.Exif()
    exif[274] = orientation
    picture = Image.fromarray(shown).transpose(way)
    picture.save(tmp_path / "a.png", exif=exif)
    relight_files([tmp_path / "a.png"], output=tmp_path / "b.png", **scene)
    with Image.open(tmp_path / "b.png") as relit:
        found = np.array(relit)
        assert relit.getexif().get(274, 1) == 1
    np.testing.assert_array_equal(found[:, :4], shown[:, :4])
    np.testing.assert_allclose(found[:, 4:], 188, atol=1)


def test_a_suffix_is_refused_before_the_work(
    tmp_path: Path, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    save(tmp_path / "a.png", rgba(255))
    monkeypatch.setattr("raden_torch.relighting.relight", None)
    with pytest.raises(InputError, match=r"expected a file name that ends in \.png.*, got \.webp"):
        relight_files([tmp_path / "a.png"], output=tmp_path / "b.webp", **scene)


def test_profiles_are_told_by_every_format(tmp_path: Path) -> None:
    """Expected: an sRGB profile changes no value, in PNG, TIFF, JPEG and WebP."""
    from PIL import ImageCms

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    picture = Image.fromarray(rgba(255)[..., :3])
    for name in ("a.png", "a.tif", "a.jpg", "a.webp"):
        picture.save(tmp_path / name)
        plain = read_photograph(tmp_path / name)
        picture.save(tmp_path / name, icc_profile=profile)
        assert torch.equal(read_photograph(tmp_path / name).linear, plain.linear)
        data = io.BytesIO(b"a lookup table")
        picture.save(tmp_path / name, icc_profile=data.getvalue())
        with pytest.raises(InputError, match=f"{name}: expected an RGB or grey profile"):
            read_photograph(tmp_path / name)


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_relit_photographs_have_the_options_of_pictures(
    tmp_path: Path, scene: dict[str, Any], suffix: str
) -> None:
    """The masked half is exposed and toned, in whole numbers; the rest stays; P3 is read back."""
    save(tmp_path / "a.png", np.full((H, W, 3), 100 * 257, np.uint16))
    before = read_photograph(tmp_path / "a.png").linear
    out = tmp_path / f"out{suffix}"
    shown = Display(1.0, "aces", colour_space="display-p3")
    relight_files([tmp_path / "a.png"], output=out, **{**scene, "display": shown})
    found = read_photograph(out).linear
    assert torch.allclose(found[..., :4], before[..., :4], atol=1e-3)
    x = 0.6 * 1.0  # half of white, a stop brighter
    toned = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    wanted = toned if suffix == ".png" else 1.0
    assert torch.allclose(found[..., 4:], torch.tensor(wanted), atol=2e-3)
    scene["display"] = Display(colour_space="acescg")
    with pytest.raises(InputError, match=r"acescg: expected a file name that ends in \.exr"):
        relight_files([tmp_path / "a.png"], output=tmp_path / "b.png", **scene)


def test_relit_by_key(tmp_path: Path, scene: dict[str, Any]) -> None:
    save(tmp_path / "a.png", np.full((H, W, 3), 100 * 257, np.uint16))
    relight_files(
        [tmp_path / "a.png"], output=tmp_path / "o.png", **{**scene, "display": Display("key")}
    )
    found = read_photograph(tmp_path / "o.png").linear[..., 4:]
    assert torch.allclose(found, torch.tensor(0.18), atol=1e-3)
