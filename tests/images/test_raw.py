"""Raw files: DNGs that are written here with known values, and read by LibRaw."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import rawpy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.images.mosaic import BAYER_PATTERNS
from raden_torch.images.other_formats import other_format
from raden_torch.images.pixels import oriented
from raden_torch.images.raw import is_raw, read_raw
from raden_torch.images.raw_image import raw_in_colour
from tests.dng import mosaic_of

H, W = 24, 32
D65 = np.array([0.95047, 1.0, 1.08883])
XYZ_TO_SRGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)


def noise(shape: tuple[int, ...] = (H, W), most: int = 4095) -> np.ndarray:
    return np.random.default_rng(0).integers(0, most + 1, shape).astype(np.uint16)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    pattern=st.sampled_from(BAYER_PATTERNS),
    black=st.tuples(*[st.integers(0, 3600).map(lambda n: n / 4)] * 4) | st.integers(0, 900),
    white=st.integers(1000, 65535),
    orientation=st.integers(1, 8),
    size=st.tuples(st.integers(30, 36), st.integers(30, 36)),
    margin=st.tuples(*[st.integers(0, 3)] * 4),
    order=st.sampled_from("<>"),
)
def test_the_light_of_a_mosaic(
    tmp_path: Path,
    dng: ModuleType,
    pattern: str,
    black: Any,
    white: int,
    orientation: int,
    size: tuple[int, int],
    margin: tuple[int, int, int, int],
    order: str,
) -> None:
    """Rationale: DNG counts pattern and black levels from the active area's corner. Expected: each
    value less its cell's black, 1 at the white level, turned; the area less a pixel at most at an
    odd margin, as LibRaw cuts it."""
    top, left, bottom, right = margin
    stored = noise(size, most=white)
    height, width = size
    area = {50829: (4, (top, left, height - bottom, width - right))}
    path = dng.write_dng(
        tmp_path / "a.dng",
        stored,
        pattern=pattern,
        black=black,
        white=white,
        orientation=orientation,
        order=order,
        tags=area if any(margin) else {},
    )
    dark = np.broadcast_to(np.ravel(black), 4).reshape(2, 2)
    rows, columns = np.ogrid[:height, :width]
    level = dark[(rows - top) % 2, (columns - left) % 2]
    letters = np.array(list(pattern)).reshape(2, 2)[(rows - top) % 2, (columns - left) % 2]
    seen = (slice(top + top % 2, height - bottom), slice(left + left % 2, width - right))
    expected = oriented(((stored - level) / (white - level))[seen], orientation)
    image = read_raw(path)
    assert image.tags[274] == orientation
    np.testing.assert_allclose(image.linear()[..., 0], expected, atol=1e-6)
    assert image.pattern == "".join(oriented(letters[seen], orientation)[:2, :2].ravel())


def test_a_crop_is_what_is_meant_to_be_seen(tmp_path: Path, dng: ModuleType) -> None:
    stored = noise((40, 48))
    tags = {50829: (4, (2, 4, 38, 46)), 50719: (4, (6, 4)), 50720: (4, (15, 11))}
    image = read_raw(dng.write_dng(tmp_path / "a.dng", stored, pattern="GRBG", tags=tags))
    np.testing.assert_array_equal(image.values, stored[6:17, 10:25])
    assert image.pattern == "GRBG"


def test_a_table_of_the_file_makes_values_linear(tmp_path: Path, dng: ModuleType) -> None:
    table = np.rint(16383 * np.linspace(0, 1, 1024) ** 2).astype(int)
    stored = noise(most=1023)
    path = dng.write_dng(tmp_path / "a.dng", stored, white=16383, tags={50712: (3, table.tolist())})
    np.testing.assert_allclose(read_raw(path).linear()[..., 0], table[stored] / 16383, atol=1e-6)


def test_linear_colours_and_grey(tmp_path: Path, dng: ModuleType) -> None:
    stored = noise((H, W, 3))
    tags = {50713: (3, (1, 1)), 50714: (3, (10, 20, 30))}
    image = read_raw(dng.write_dng(tmp_path / "a.dng", stored, white=4095, tags=tags))
    black = np.array([10, 20, 30])
    np.testing.assert_allclose(image.linear(), (stored - black) / (4095 - black), atol=1e-6)
    assert image.pattern is None
    grey = dng.write_dng(
        tmp_path / "b.dng", stored[..., 0], black=64, white=4095, tags={262: (3, 34892)}
    )
    image = read_raw(grey)
    np.testing.assert_allclose(
        image.linear()[..., 0], (stored[..., 0] - 64.0) / (4095 - 64), atol=1e-6
    )
    assert (image.pattern, image.colour) == (None, None)
    assert np.ptp(raw_in_colour(image, grey), axis=2).max() == 0


def test_colours_by_the_matrix_of_the_file(tmp_path: Path, dng: ModuleType) -> None:
    """Rationale: in a light of D65 the matrix, XYZ → camera, says all. Expected: sRGB of the XYZ
    that the camera saw, as bright as the balance makes the neutral: of its most sensitive
    colour's signal."""
    matrix = np.array(dng.EOS_5D).reshape(3, 3) / 10000
    xyz = np.array([[0.2, 0.21, 0.15], [0.1, 0.2, 0.1], [0.18, 0.2, 0.35], 0.3 * D65])
    neutral = matrix @ D65
    rgb = np.repeat(np.repeat((xyz @ matrix.T).reshape(2, 2, 3), 12, 0), 16, 1)
    stored = np.rint(60000 * mosaic_of(rgb, "RGGB")).astype(np.uint16)
    path = dng.write_dng(tmp_path / "a.dng", stored, white=60000, neutral=neutral / neutral.max())
    found = raw_in_colour(read_raw(path), path)[5::12, 7::16].reshape(4, 3)
    np.testing.assert_allclose(found, xyz @ XYZ_TO_SRGB.T * neutral.max(), atol=2e-3)
    assert np.ptp(found[3]) < 1e-3


def test_colours_are_those_of_libraws_own_picture(tmp_path: Path, dng: ModuleType) -> None:
    """Away from edges, where the ways to demosaic differ."""
    y, x = np.mgrid[:H, :W] / 40
    rgb = np.stack([0.2 + 0.3 * x, 0.3 + 0.4 * y, 0.25 + 0.2 * (x + y) / 2], -1)
    stored = np.rint(256 + 3000 * mosaic_of(rgb, "GBRG")).astype(np.uint16)
    path = dng.write_dng(tmp_path / "a.dng", stored, pattern="GBRG", black=256, white=4095)
    with rawpy.imread(str(path)) as raw:
        shown = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
            use_camera_wb=True,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_bps=16,
        )
    found = np.clip(raw_in_colour(read_raw(path), path), 0, 1)
    np.testing.assert_allclose(found[3:-3, 3:-3], shown[3:-3, 3:-3] / 65535, atol=6e-4)


def test_saturated_light_is_white(tmp_path: Path, dng: ModuleType) -> None:
    path = dng.write_dng(tmp_path / "a.dng", np.full((H, W), 4095, np.uint16), white=4095)
    np.testing.assert_allclose(raw_in_colour(read_raw(path), path), 1, atol=1e-3)


def test_without_a_balance_it_is_of_daylight(tmp_path: Path, dng: ModuleType) -> None:
    matrix = np.array(dng.EOS_5D).reshape(3, 3) / 10000
    colour = read_raw(dng.write_dng(tmp_path / "a.dng", noise(), neutral=None)).colour
    assert colour is not None
    assert colour.source == "the matrix of the file and the white balance of daylight"
    neutral = matrix @ D65
    np.testing.assert_allclose(colour.balance, neutral.max() / neutral, rtol=2e-3)


def test_what_is_asked_for_and_not_done_is_named(tmp_path: Path, dng: ModuleType) -> None:
    tags = {51009: dng.opcodes(9, 9, 4), 51022: dng.opcodes(1)}
    image = read_raw(dng.write_dng(tmp_path / "a.dng", noise(), tags=tags))
    assert image.notes == (
        "not applied: the DNG's OpcodeList2 GainMap, FixBadPixelsConstant; "
        "OpcodeList3 WarpRectilinear",
    )


XTRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"


def test_what_is_refused(tmp_path: Path, dng: ModuleType) -> None:
    numbers = bytes("RGB".index(c) for c in XTRANS)
    for tags, message in (
        ({33421: (3, (6, 6)), 33422: (1, numbers)}, r"one of 6 x 6 \(X-Trans\)"),
        ({33422: (1, bytes((3, 4, 5, 1)))}, "expected a Bayer mosaic of R, G and B, got"),
        ({50715: (10, [1.0] * W)}, "got one that varies from row to row"),
        ({50713: (3, (4, 4)), 50714: (3, list(range(16)))}, "black level of 2 x 2 cells at most"),
        ({51008: dng.opcodes(7)}, "got a DNG that asks for MapTable first"),
        ({51009: dng.opcodes(9, 12, 12)}, "asks for ScalePerRow first"),
        ({339: (3, 3)}, "got a DNG of floats"),
        ({50717: (4, 300)}, "expected a white level above the black level of 300, got 300"),
        ({256: (4, 60000), 257: (4, 60000)}, "60000 x 60000 pixels; expected"),
        ({256: (4, 600), 257: (4, 600)}, "expected a whole raw file"),
        ({50778: (3, 21), 50714: (5, [300.0]), 262: (3, 1)}, "expected"),
    ):
        path = dng.write_dng(tmp_path / "a.dng", noise(), black=300, tags=tags)
        with pytest.raises(InputError, match=message) as caught:
            read_raw(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
    unknown = dng.write_dng(tmp_path / "a.dng", noise(), matrix=None)
    with pytest.raises(InputError, match=r"got an unknown one; `raden capture colour` measures"):
        raw_in_colour(read_raw(unknown), unknown)
    with pytest.raises(InputError, match="No such file"):
        read_raw(tmp_path / "none.dng")


def test_nothing_else_is_said_of_a_damaged_file(
    tmp_path: Path, dng: ModuleType, capfd: pytest.CaptureFixture[str]
) -> None:
    path = dng.write_dng(tmp_path / "a.dng", noise())
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(InputError, match=r"a\.dng: expected a whole raw file"):
        read_raw(path)
    assert capfd.readouterr().err == ""


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_are_input_errors(
    tmp_path: Path, dng: ModuleType, data: st.DataObject
) -> None:
    path = dng.write_dng(
        tmp_path / "a.dng",
        noise(),
        exif={33434: (5, [0.01]), 42036: (2, b"Lens\0")},
        tags={51009: dng.opcodes(9), 50829: (4, (2, 2, 20, 28))},
    )
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1) | st.integers(0, 600))] = data.draw(
            st.integers(0, 255)
        )
    path.write_bytes(content[: data.draw(st.just(len(content)) | st.integers(1, len(content)))])
    try:
        image = read_raw(path)
    except InputError as error:
        said = str(error)
    else:
        said = ""
        assert np.isfinite(image.linear()).all()
    assert "\n" not in said


def test_raw_files_are_known_by_their_content_and_by_their_names(
    tmp_path: Path, dng: ModuleType
) -> None:
    path = dng.write_dng(tmp_path / "a.tif", noise())
    assert is_raw(path)
    for name, start, expected in (
        ("a.NEF", b"MM\0*", True),
        ("a", b"\0\0\0\x18ftypcrx ", True),
        ("b", b"FUJIFILMCCD-RAW 0201", True),
        ("b.tif", b"II*\0\x08\0\0\0", False),
        ("a.png", b"\x89PNG\r\n\x1a\n", False),
    ):
        (tmp_path / name).write_bytes(start)
        assert is_raw(tmp_path / name) == expected
    assert not is_raw(tmp_path / "none")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are POSIX's")
def test_a_pipe_is_refused_before_it_is_looked_into(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for look in (is_raw, other_format):
        with pytest.raises(InputError, match="pipe: expected a file, got a pipe"):
            look(pipe)
