"""What files say of their colours: ICC profiles, PNG's chunks, EXIF, OpenEXR's chromaticities."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image, ImageCms

from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.capture.photo.photograph import read_linear
from raden_torch.errors import InputError
from raden_torch.images.colour_space import (
    SRGB_SPACE,
    colour_space_of,
    exr_matrix,
    float_matrix,
    in_srgb,
    srgb_curve,
)
from raden_torch.images.header import ColourTags
from raden_torch.images.icc import has_lookup_tables
from raden_torch.images.lookup_profile import LookupProfile
from raden_torch.images.pixels import read_image
from tests.tiff import tiff

# published colorants under D50 (Apple's Display P3; Adobe RGB 1998; ROMM RGB), red, green, blue
P3 = [(0.51512, 0.2412, -0.00105), (0.29198, 0.69225, 0.04189), (0.1571, 0.06657, 0.78407)]
ADOBE = [(0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457)]
PROPHOTO = [(0.79767, 0.28804, 0.0), (0.13519, 0.71188, 0.0), (0.03134, 0.00009, 0.82491)]
SRGB_XYZ = [(0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.7141)]
P3_TO_SRGB = [[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]]
"""As CSS Color 4 has it, rounded."""


def fixed(*numbers: float) -> bytes:
    return struct.pack(f">{len(numbers)}i", *(round(65536 * v) for v in numbers))


def para(kind: int, *numbers: float) -> bytes:
    return b"para" + bytes(4) + struct.pack(">HH", kind, 0) + fixed(*numbers)


def curv(*numbers: int) -> bytes:
    return b"curv" + bytes(4) + struct.pack(f">I{len(numbers)}H", len(numbers), *numbers)


SRGB_PARA = para(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
SRGB_TABLE = curv(*np.rint(65535 * srgb_curve(np.linspace(0, 1, 1024))).astype(int))


def icc(tags: dict[bytes, bytes], space: bytes = b"RGB ") -> bytes:
    """A version 4 display profile (ICC.1:2022)."""
    tags = {
        b"desc": b"mluc" + bytes(4) + struct.pack(">II2s2sII", 1, 12, b"en", b"US", 2, 28) + b"\0x",
        b"wtpt": b"XYZ " + bytes(4) + fixed(0.9642, 1, 0.8249),
        **tags,
    }
    start, table, body = 132 + 12 * len(tags), b"", b""
    for name, tag in tags.items():
        table += struct.pack(">4sII", name, start + len(body), len(tag))
        body += tag + bytes(-len(tag) % 4)
    head = struct.pack(
        ">I4sI4s4s4s12s4s4sI4sIQI12s4s",
        *(start + len(body), b"none", 0x04200000, b"mntr", space, b"XYZ ", bytes(12), b"acsp"),
        *(bytes(4), 0, bytes(4), 0, 0, 0, fixed(0.9642, 1, 0.8249), bytes(4)),
    )
    return head.ljust(128, b"\0") + struct.pack(">I", len(tags)) + table + body


def rgb_icc(colorants: list[tuple[float, ...]], curve: bytes) -> bytes:
    tags = {bytes([c]) + b"TRC": curve for c in b"rgb"}
    for c, column in zip(b"rgb", colorants, strict=True):
        tags[bytes([c]) + b"XYZ"] = b"XYZ " + bytes(4) + fixed(*column)
    return icc(tags)


def converted(tags: ColourTags, stored: np.ndarray) -> np.ndarray:
    """`[…, 3]` 0…1 → linear sRGB."""
    space = colour_space_of(tags, "a.png") or SRGB_SPACE
    linear = np.stack([curve(stored[..., c]) for c, curve in enumerate(space.curves)], -1)
    return in_srgb(linear, space.matrix)


CURVES = {
    "sRGB": SRGB_PARA,
    "table": SRGB_TABLE,
    "gamma": para(0, 2.2),
    "u8Fixed8": curv(round(2.2 * 256)),
    "linear": curv(),
    "offset": para(1, 2.0, 1.1, -0.1),
    "raised": para(2, 2.0, 0.9, 0.0, 0.1),
    "seven": para(4, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0.0, 0.0),
}


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("colorants", [P3, ADOBE, PROPHOTO, SRGB_XYZ])
def test_profiles_agree_with_littlecms(curve: str, colorants: list[tuple[float, ...]]) -> None:
    """Expected: LittleCMS's sRGB, to a level of 255, where that clips nothing."""
    profile = rgb_icc(colorants, CURVES[curve])
    stored = np.random.default_rng(0).integers(0, 256, (40, 50, 3)).astype(np.uint8)
    shown = np.asarray(
        ImageCms.profileToProfile(
            Image.fromarray(stored),
            ImageCms.ImageCmsProfile(io.BytesIO(profile)),
            ImageCms.createProfile("sRGB"),
            ImageCms.Intent.RELATIVE_COLORIMETRIC,
        )
    )
    linear = converted(ColourTags(icc=profile), stored / 255)
    inside = (shown > 0).all(axis=2) & (shown < 255).all(axis=2)
    assert inside.mean() > 0.1
    coded = np.where(
        linear <= 0.0031308,
        12.92 * linear,
        1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055,
    )
    away = np.abs(255 * coded - shown)[inside]
    assert np.quantile(away, 0.99) < 1.2
    assert away.max() < 3  # LittleCMS is coarse in the dark


def test_display_p3_in_sixteen_bits() -> None:
    stored = np.random.default_rng(0).integers(0, 65536, (100, 3)) / 65535
    linear = converted(ColourTags(icc=rgb_icc(P3, SRGB_PARA)), stored)
    np.testing.assert_allclose(linear, srgb_curve(stored) @ np.transpose(P3_TO_SRGB), atol=5e-4)
    np.testing.assert_allclose(linear.sum(), srgb_curve(stored).sum(), rtol=0.02)
    white = converted(ColourTags(icc=rgb_icc(P3, SRGB_PARA)), np.ones((1, 3)))
    np.testing.assert_allclose(white, 1, atol=2e-4)


@pytest.mark.parametrize("curve", [SRGB_PARA, SRGB_TABLE])
def test_an_srgb_profile_changes_nothing(curve: bytes) -> None:
    assert colour_space_of(ColourTags(icc=rgb_icc(SRGB_XYZ, curve)), "a.png") is None
    built_in = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    assert colour_space_of(ColourTags(icc=built_in), "a.png") is None


def test_a_grey_profile_has_a_curve() -> None:
    profile = icc({b"kTRC": para(0, 1.8)}, b"GRAY")
    stored = np.linspace(0, 1, 9)[:, None].repeat(3, 1)
    np.testing.assert_allclose(converted(ColourTags(icc=profile), stored), stored**1.8, atol=1e-5)


@pytest.mark.parametrize(
    ("profile", "got"),
    [
        (icc({b"A2B0": b"mft2" + bytes(40)}, b"GRAY"), "got GRAY profile of lookup tables"),
        (icc({b"A2B0": b"mft2" + bytes(40)}, b"CMYK"), "got CMYK profile of lookup tables"),
        (rgb_icc(P3, b"what" + bytes(8)), "a curve of type b'what'"),
        (rgb_icc(P3, SRGB_TABLE)[:700], "a damaged profile"),
        (b"no profile", "a damaged profile"),
    ],
)
def test_other_profiles_are_refused(profile: bytes, got: str) -> None:
    with pytest.raises(InputError) as caught:
        colour_space_of(ColourTags(icc=profile), "a.tif")
    message = str(caught.value)
    assert message.startswith("a.tif: expected an RGB or grey profile")
    assert got in message
    assert message.endswith("convert it to sRGB first")


SRGB_PLACES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
P3_PLACES = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)


@pytest.mark.parametrize(
    ("tags", "exponent", "is_p3"),
    [
        (ColourTags(cicp=(12, 13, 0, 1)), None, True),
        (ColourTags(cicp=(12, 8, 0, 1)), 1.0, True),
        (ColourTags(cicp=(1, 4, 0, 1)), 2.2, False),
        (ColourTags(cicp=(12, 13, 0, 1), icc=b"not looked at", srgb=True), None, True),
        (ColourTags(icc=rgb_icc(P3, SRGB_PARA), srgb=True, gamma=1.0), None, True),
        (ColourTags(srgb=True, gamma=1.0, chromaticities=P3_PLACES), None, False),
        (ColourTags(gamma=1.0), 1.0, False),
        (ColourTags(gamma=0.5), 2.0, False),
        (ColourTags(gamma=0.45455), None, False),
        (ColourTags(gamma=0.45455, chromaticities=P3_PLACES), None, True),
        (ColourTags(chromaticities=P3_PLACES), None, True),
        (ColourTags(chromaticities=SRGB_PLACES), None, False),
    ],
)
def test_pngs_chunks(tags: ColourTags, exponent: float | None, is_p3: bool) -> None:
    """Rationale: PNG's third edition: cICP before iCCP before sRGB before gAMA and cHRM."""
    stored = np.random.default_rng(0).random((50, 3))
    linear = srgb_curve(stored) if exponent is None else stored**exponent
    expected = linear @ np.transpose(P3_TO_SRGB) if is_p3 else linear
    np.testing.assert_allclose(converted(tags, stored), expected, atol=6e-4)


@pytest.mark.parametrize("cicp", [(9, 16, 0, 1), (9, 18, 0, 1), (1, 13, 0, 0), (4, 13, 0, 1)])
def test_hdr_pictures_are_refused(cicp: tuple[int, int, int, int]) -> None:
    with pytest.raises(InputError, match=r"got cICP .*convert it to sRGB first"):
        colour_space_of(ColourTags(cicp=cicp), "a.png")


def test_adobe_rgb_by_exif() -> None:
    stored = np.random.default_rng(0).random((50, 3))
    by_profile = converted(ColourTags(icc=rgb_icc(ADOBE, para(0, 563 / 256))), stored)
    np.testing.assert_allclose(converted(ColourTags(adobe=True), stored), by_profile, atol=2e-4)


def test_floats_are_linear_whatever_their_primaries() -> None:
    linear = ColourTags(icc=rgb_icc(P3, curv()))
    np.testing.assert_allclose(
        float_matrix(linear, "a.tif", is_linear=False), P3_TO_SRGB, atol=4e-4
    )
    assert float_matrix(ColourTags(), "a.tif", is_linear=False) is None
    assert float_matrix(ColourTags(icc=rgb_icc(SRGB_XYZ, curv())), "a", is_linear=False) is None
    for colorants in (SRGB_XYZ, P3):
        curved = ColourTags(icc=rgb_icc(colorants, SRGB_PARA))
        with pytest.raises(InputError, match=r"a\.tif: expected linear light in floats"):
            float_matrix(curved, "a.tif", is_linear=False)
    found = float_matrix(curved, "a.tif", is_linear=True)
    np.testing.assert_allclose(found, P3_TO_SRGB, atol=4e-4)


def test_an_exrs_chromaticities(tmp_path: Path) -> None:
    """ACES AP0, whose white is near D60. Expected: colour-science's matrix; white stays white."""
    import colour

    def write(header: dict[str, object]) -> None:
        pixels = {c: np.ones((2, 2), np.float32) for c in "RGB"}
        OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, pixels).write(str(path))

    ap0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
    path = tmp_path / "a.exr"
    write({"chromaticities": ap0})
    matrix = exr_matrix(path)
    expected = colour.matrix_RGB_to_RGB(
        colour.RGB_COLOURSPACES["ACES2065-1"], colour.RGB_COLOURSPACES["sRGB"], "Bradford"
    )
    np.testing.assert_allclose(matrix, expected, atol=2e-3)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-5)
    write({"chromaticities": SRGB_PLACES})
    assert exr_matrix(path) is None
    write({})
    assert exr_matrix(path) is None
    write({"chromaticities": (0.3,) * 8})
    with pytest.raises(InputError, match=r"a\.exr: expected x, y of three primaries"):
        exr_matrix(path)


@pytest.mark.parametrize("index", ["R98", "R03"])
def test_what_a_camera_says_in_exif(tmp_path: Path, index: str) -> None:
    """DCF: R98 stands for sRGB, R03 for Adobe RGB."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA005] = {1: index}
    Image.new("RGB", (8, 8), (90, 140, 60)).save(tmp_path / "a.jpg", exif=exif)
    assert read_image(tmp_path / "a.jpg").header.colour.adobe == (index == "R03")


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "webp"])
def test_a_profile_is_found_in_every_format(tmp_path: Path, suffix: str) -> None:
    profile = rgb_icc(P3, SRGB_PARA)
    path = tmp_path / f"a.{suffix}"
    Image.new("RGB", (8, 8), (90, 140, 60)).save(path, icc_profile=profile)
    assert read_image(path).header.colour == ColourTags(icc=profile)


def lookup_icc(nodes: np.ndarray, curve: np.ndarray) -> bytes:
    """A profile of one lut16Type (ICC.1:2022, 10.10): input curves, then `[g, g, g, 3]` XYZ."""
    grid = len(nodes)
    head = b"mft2" + bytes(4) + bytes((3, 3, grid, 0)) + fixed(1, 0, 0, 0, 1, 0, 0, 0, 1)
    head += struct.pack(">HH", len(curve), 2)
    table = np.rint(65535 * np.concatenate([curve] * 3)).astype(">u2").tobytes()
    cells = np.rint(32768 * nodes).clip(0, 65535).astype(">u2").tobytes()
    straight = struct.pack(">6H", *(0, 65535) * 3)
    return icc({b"A2B0": head + table + cells + straight})


def of_colorants(colorants: list[tuple[float, ...]], grid: int = 2) -> np.ndarray:
    """`[g, g, g, 3]` XYZ of a matrix, red slowest: interpolation is exact between its nodes."""
    axes = np.linspace(0, 1, grid)
    rgb = np.stack(np.meshgrid(axes, axes, axes, indexing="ij"), -1)
    return np.clip(rgb @ np.array(colorants), 0, None)


@pytest.mark.parametrize("colorants", [ADOBE, SRGB_XYZ])
def test_tables_agree_with_the_matrix_that_they_were_made_of(
    colorants: list[tuple[float, ...]],
) -> None:
    """Rationale: two ways to one colour, LittleCMS in floats and ours. Expected: the same but for
    rounding of colorants and tables, in colours beyond sRGB, too."""
    curve = srgb_curve(np.linspace(0, 1, 4096))
    profile = lookup_icc(of_colorants(colorants), curve)
    stored = np.random.default_rng(0).integers(0, 65536, (40, 50, 3)).astype(np.uint16)
    space = colour_space_of(ColourTags(icc=profile), "a.png")
    assert isinstance(space, LookupProfile)
    found = space.linear(stored, 65535)
    by_matrix = converted(ColourTags(icc=rgb_icc(colorants, SRGB_PARA)), stored / 65535)
    assert (by_matrix < -0.01).any() == (colorants is ADOBE)
    np.testing.assert_allclose(found, by_matrix, atol=5e-4)


def test_matrix_profiles_by_both_libraries_and_by_us() -> None:
    """Expected: LittleCMS's floats and our 16 bits agree far within a level of 255."""
    for colorants in (P3, ADOBE, PROPHOTO):
        profile = rgb_icc(colorants, SRGB_PARA)
        stored = np.random.default_rng(1).integers(0, 65536, (40, 50, 3)).astype(np.uint16)
        theirs = LookupProfile(profile, "a.png").linear(stored, 65535)
        ours = converted(ColourTags(icc=profile), stored / 65535)
        np.testing.assert_allclose(ours, theirs, atol=2e-4)


def test_tables_come_before_a_matrix() -> None:
    """ICC.1:2022, 8.3: a profile may have both. Expected: the table's colours."""
    grey = np.repeat(np.linspace(0, 1, 2), 4)[:, None] * [0.9642, 1, 0.8249]  # of red alone
    tables = lookup_icc(grey.reshape(2, 2, 2, 3), np.linspace(0, 1, 2))
    assert has_lookup_tables(tables)
    assert not has_lookup_tables(rgb_icc(P3, SRGB_PARA))
    found = LookupProfile(tables, "a.png").linear(np.full((1, 1, 3), 32768, np.uint16), 65535)
    np.testing.assert_allclose(found, 0.5, atol=1e-3)


def test_a_damaged_profile_of_tables_is_an_input_error(tmp_path: Path) -> None:
    profile = lookup_icc(of_colorants(ADOBE), np.linspace(0, 1, 4096))
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(
        tmp_path / "a.png", icc_profile=profile[:300]
    )
    with pytest.raises(InputError, match=r"a\.png: expected a colour profile that LittleCMS can"):
        read_linear(tmp_path / "a.png")


@pytest.mark.parametrize("depth", [8, 16])
def test_photographs_with_tables(tmp_path: Path, depth: int) -> None:
    """Read for capture and for relighting; what is known beside them is refused."""
    profile = lookup_icc(of_colorants(SRGB_XYZ), srgb_curve(np.linspace(0, 1, 4096)))
    levels = (1 << depth) - 1
    stored = np.sort(np.random.default_rng(0).integers(0, levels + 1, (20, 30, 3)), axis=1)
    path = tmp_path / "a.tif"
    kind = np.uint8 if depth == 8 else np.uint16
    path.write_bytes(tiff(stored.astype(kind), _34675=(7, profile)))
    expected = srgb_curve(stored / levels)
    photo = read_linear(path)
    np.testing.assert_allclose(photo.linear, expected, atol=5e-4)
    slope = (srgb_curve(stored / levels + 0.001) - srgb_curve(stored / levels - 0.001)) / 0.002
    inside = (stored > 0.05 * levels).all(axis=2) & (stored < 0.98 * levels).all(axis=2)
    step = slope[inside] / levels / np.sqrt(12)
    np.testing.assert_allclose(photo.rounding[inside], step, rtol=0.1)
    shown = read_photograph(path)
    np.testing.assert_allclose(shown.linear[0].movedim(0, -1), expected, atol=5e-4)
    for read in (read_linear, read_photograph):
        with pytest.raises(InputError, match=r"a\.tif: expected a profile with primaries"):
            read(path, coded="linear")
