"""OpenEXR by rows: the same pixels as at once, whatever the layout, and files that are wrong."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from raden_torch.errors import InputError
from raden_torch.images.exr import read_parts, rows_written, write_channels
from raden_torch.images.exr_file import ExrFile

OpenEXR = pytest.importorskip("OpenEXR")

H, W = 301, 37
RANDOM = np.random.default_rng(0)
CHANNELS = {
    "Z": RANDOM.normal(size=(H, W)).astype(np.float32),
    "N.X": RANDOM.normal(size=(H, W)).astype(np.float16),
    "id": RANDOM.integers(0, 9, (H, W)).astype(np.uint32),
}
BANDS = [(0, 1), (0, 16), (5, 70), (250, 300), (300, 301)]


def part(name: str = "", **header: object) -> OpenEXR.Part:
    base = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    return OpenEXR.Part(base | header, {k: v.copy() for k, v in CHANNELS.items()}, name)


def tiles(width: int, height: int) -> dict[str, object]:
    description = OpenEXR.TileDescription()
    description.xSize, description.ySize = width, height
    return {"type": OpenEXR.tiledimage, "tiles": description}


def window(left: int, top: int) -> dict[str, object]:
    return {
        "dataWindow": ((left, top), (left + W - 1, top + H - 1)),
        "displayWindow": ((0, 5), (W + 2, H + 12)),
    }


COMPRESSIONS = [c for n, c in OpenEXR.Compression.__members__.items() if n.endswith("_COMPRESSION")]
FLAT = {"compression": OpenEXR.NO_COMPRESSION}
LAYOUTS = {
    **{c.name: [part(compression=c)] for c in COMPRESSIONS},
    "tiles": [part(**tiles(24, 40))],
    "flat tiles": [part(**tiles(64, 64), **FLAT)],
    "upwards": [part(lineOrder=OpenEXR.DECREASING_Y)],
    "upwards, flat": [part(lineOrder=OpenEXR.DECREASING_Y, **FLAT)],
    "window inside": [part(**window(2, 8))],
    "window inside, flat": [part(**window(2, 8), **FLAT)],
    "window above": [part(**window(-4, -20))],
    "window above, flat": [part(**window(-4, -20), **FLAT)],
    "parts": [
        part("zip"),
        part("flat", **FLAT),
        part("a part whose name has more than thirty-one letters", **tiles(64, 64)),
    ],
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_pixels_are_those_that_openexr_reads(tmp_path, layout) -> None:
    path = tmp_path / "x.exr"
    OpenEXR.File(LAYOUTS[layout]).write(str(path))
    found = ExrFile(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part, header in zip(file.parts, found.parts.values(), strict=True):
            (left, top), (right, bottom) = part.header["displayWindow"]
            (x, y), _ = part.header["dataWindow"]
            whole = np.zeros((1000, 1000), np.float32)  # around the display window's corner
            row, column = y - top + 100, x - left + 100
            for name, channel in part.channels.items():
                whole[row : row + H, column : column + W] = channel.pixels
                shown = whole[100 : 101 + bottom - top, 100 : 101 + right - left]
                key = (header.name, name)
                np.testing.assert_array_equal(found.read([key], 0, found.size[0])[key], shown)


def test_channels_of_several_kinds_are_read_together(tmp_path) -> None:
    path = tmp_path / "x.exr"
    OpenEXR.File([part()]).write(str(path))
    file = ExrFile(path)
    assert file.first.channels == {"N.X": "half", "Z": "float", "id": "uint"}
    found = file.read([("", name) for name in ("id", "Z", "N.X")], 3, 99)
    for name, values in CHANNELS.items():
        np.testing.assert_array_equal(found["", name], values[3:99].astype(np.float32))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rows_are_those_of_the_whole(tmp_path, layout) -> None:
    path = tmp_path / "x.exr"
    OpenEXR.File(LAYOUTS[layout]).write(str(path))
    whole, file = read_parts(path), ExrFile(path)
    assert file.size == next(iter(next(iter(whole.values())).values())).shape
    for top, bottom in BANDS:
        for _, name, channel in file.keys:
            rows = file.read([(name, channel)], top, bottom)[name, channel]
            np.testing.assert_array_equal(rows, whole[name][channel][top:bottom])
            assert rows.dtype == np.float32
    assert len(file.keys) == sum(map(len, whole.values()))


@pytest.mark.parametrize("rows", [16, 48, 304])
def test_rows_make_the_file_that_is_written_at_once(tmp_path, rows) -> None:
    halves = {name: RANDOM.normal(size=(H, W)).astype(np.float16) for name in "RGB"}
    write_channels(tmp_path / "whole.exr", halves, half=True)
    with rows_written(tmp_path / "rows.exr", (H, W)) as add:
        for top in range(0, H, rows):
            assert not (tmp_path / "rows.exr").exists()
            add({name: values[top : top + rows] for name, values in halves.items()})
    assert (tmp_path / "rows.exr").read_bytes() == (tmp_path / "whole.exr").read_bytes()


def test_too_few_rows_leave_the_old_file(tmp_path) -> None:
    path = tmp_path / "x.exr"
    path.write_bytes(b"old")
    with (
        pytest.raises(InputError, match="expected 301 rows, got 16"),
        rows_written(path, (H, W)) as add,
    ):
        add({"Y": np.zeros((16, W), np.float16)})
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"old"]


@pytest.fixture(scope="module", params=["ZIP", "NO", "tiles"])
def written(request, tmp_path_factory) -> tuple[Path, Path, int]:
    """A place to write to, a file, and where the table of its chunks begins."""
    path = tmp_path_factory.mktemp("rows") / "whole.exr"
    parts = {"tiles": tiles(24, 40)}.get(
        request.param, {"compression": getattr(OpenEXR, f"{request.param}_COMPRESSION", None)}
    )
    OpenEXR.File([part(**parts)]).write(str(path))
    return path.with_name("x.exr"), path, table_of(path.read_bytes())


def table_of(data: bytes) -> int:
    """Where the header of a single part ends, by OpenEXR's file layout."""
    at = 8
    while data[at]:
        at = data.index(b"\0", data.index(b"\0", at) + 1) + 1  # after the name and the type
        at += 4 + struct.unpack_from("<i", data, at)[0]
    return at + 1


def read_two_bands(path: Path) -> list[np.ndarray]:
    file = ExrFile(path)
    return [file.read([("", "Z")], *band)["", "Z"] for band in ((5, 70), (250, 301))]


@pytest.mark.parametrize(
    ("width", "height", "words"),
    [
        (2**24, 40, "tile size 16777216x40x1 exceeds"),  # OpenImageIO refuses it itself
        (2**20, 2**10, "tiles: expected .* pixels, got 1048576 x 1024"),
    ],
)
def test_an_enormous_tile_is_refused_before_memory_is_taken(tmp_path, width, height, words) -> None:
    path = tmp_path / "x.exr"
    OpenEXR.File([part(**tiles(24, 40))]).write(str(path))
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<2I", 24, 40), struct.pack("<2I", width, height)))
    for read in (read_parts, ExrFile):
        with pytest.raises(InputError, match=words):
            read(path)


def test_an_enormous_block_of_rows_is_refused_before_memory_is_taken(tmp_path) -> None:
    """What is compressed together is decoded together: 256 rows of DWAB."""
    path = tmp_path / "x.exr"
    OpenEXR.File([part(compression=OpenEXR.DWAB_COMPRESSION)]).write(str(path))
    data = path.read_bytes()
    for name in (b"dataWindow", b"displayWindow"):
        start = data.index(name + b"\0box2i\0") + len(name) + 7 + 4
        data = data[:start] + struct.pack("<4i", 0, 0, 2**20 - 1, 79) + data[start + 16 :]
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"compressed together .* got 80 rows of 1048576 pixels"):
        ExrFile(path)


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
@example(share=0.0055)  # within the table of a small file's tiles
def test_a_truncated_file_is_an_input_error(written, share) -> None:
    path, original, _ = written
    data = original.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError) as caught:
        read_two_bands(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_noise_is_read_or_an_input_error(written, data) -> None:
    path, original, start = written
    whole = original.read_bytes()
    noisy = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(
            st.one_of(st.integers(start, start + 400), st.integers(start, len(whole) - 1))
        )
        noisy[at] = data.draw(st.integers(0, 255))
    path.write_bytes(noisy)
    with contextlib.suppress(InputError):
        assert [a.shape for a in read_two_bands(path)] == [(65, W), (51, W)]
