"""OpenEXR files as other programs write and name them, in surroundings that are not as usual."""

from __future__ import annotations

import math
import os
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.errors import InputError
from raden_torch.images.exr import read_channels, write_channels

OpenEXR = pytest.importorskip("OpenEXR")


def attribute(name: str, kind: str, value: bytes) -> bytes:
    return b"".join((name.encode(), b"\0", kind.encode(), b"\0", struct.pack("<i", len(value)))) + (
        value
    )


def write_mipmap(path: Path, levels: list[np.ndarray]) -> None:
    """One float channel Z, uncompressed, each level one tile; by the layout of OpenEXR's
    documentation."""
    height, width = levels[0].shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = (
        struct.pack("<II", 20000630, 2 | 0x200)
        + attribute(
            "channels", "chlist", b"Z\0" + struct.pack("<i4B2i", 2, 0, 0, 0, 0, 1, 1) + b"\0"
        )
        + attribute("compression", "compression", b"\0")
        + attribute("dataWindow", "box2i", window)
        + attribute("displayWindow", "box2i", window)
        + attribute("lineOrder", "lineOrder", b"\0")
        + attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
        + attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0))
        + attribute("screenWindowWidth", "float", struct.pack("<f", 1))
        + attribute("tiles", "tiledesc", struct.pack("<IIB", width, height, 1))
        + b"\0"
    )
    tiles = [
        struct.pack("<5i", 0, 0, level, level, pixels.nbytes) + pixels.tobytes()
        for level, pixels in enumerate(levels)
    ]
    starts = np.cumsum([len(header) + 8 * len(tiles), *map(len, tiles[:-1])])
    path.write_bytes(header + starts.astype("<u8").tobytes() + b"".join(tiles))


def test_the_largest_level_of_a_mipmap_is_read(tmp_path: Path) -> None:
    levels = [np.full((8 >> k, 8 >> k), k + 1, np.float32) for k in range(4)]
    levels[0] += np.arange(64, dtype=np.float32).reshape(8, 8)
    write_mipmap(tmp_path / "m.exr", levels)
    np.testing.assert_array_equal(read_channels(tmp_path / "m.exr")["Z"], levels[0])


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_pixels_that_are_not_square_keep_the_surface(tmp_path: Path, aspect: float) -> None:
    """A plane seen by an anamorphic camera, whose pixels are `aspect` times as wide as high."""
    width, height, fov = 32, 24, 50.0
    focal = width / 2 / math.tan(math.radians(fov) / 2)
    y, x = np.mgrid[:height, :width]
    ray_x = (x - (width - 1) / 2) / focal
    ray_y = -(y - (height - 1) / 2) / (focal * aspect)
    depth = (4 / (1 + 0.5 * ray_x - 0.3 * ray_y)).astype(np.float32)
    header = {"pixelAspectRatio": aspect, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Z": depth}) as file:
        file.write(str(tmp_path / "z.exr"))
    found = read_gbuffer(tmp_path / "z.exr", fov_deg=fov, depth="planar").normal[0, :, 1:-1, 1:-1]
    normal = torch.tensor([-0.5, 0.3, 1.0]) / math.sqrt(1.34)
    torch.testing.assert_close(found, normal.view(3, 1, 1).expand_as(found), atol=1e-3, rtol=0)


@pytest.mark.parametrize("size", [(3, 900), (900, 3), (1, 900), (1, 1), (900, 2)])
def test_narrow_normals_are_read(tmp_path: Path, size: tuple[int, int]) -> None:
    y, x = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in size), indexing="ij")
    normal = np.stack([x, y, np.sqrt(1 - x * x - y * y)]).astype(np.float32)
    write_channels(tmp_path / "n.exr", {f"N.{c}": n for c, n in zip("XYZ", normal, strict=True)})
    found = read_gbuffer(tmp_path / "n.exr")
    np.testing.assert_array_equal(found.normal[0].numpy(), normal)


@pytest.mark.parametrize("size", [(1, 9), (9, 1), (1, 1)])
def test_depth_of_one_row_has_no_normals(tmp_path: Path, size: tuple[int, int]) -> None:
    write_channels(tmp_path / "z.exr", {"Z": np.ones(size)})
    with pytest.raises(InputError, match="expected at least 2 x 2 pixels"):
        read_gbuffer(tmp_path / "z.exr", fov_deg=40, depth="planar")
    with pytest.raises(InputError, match="expected at least 2 x 2 pixels"):
        GBuffer.from_depth(torch.ones(1, 1, *size), torch.eye(3))


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes on Linux alone")
def test_a_file_whose_name_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"shot\xff.exr")
    write_channels(path, {"Z": np.full((2, 3), 7.0)})
    assert read_channels(path)["Z"].tolist() == [[7, 7, 7], [7, 7, 7]]


def test_threads_leave_the_outputs_as_they_are(tmp_path: Path) -> None:
    write_channels(tmp_path / "z.exr", {"Z": np.ones((2, 2))})
    out, before = sys.stdout, os.fstat(2)

    def read() -> None:
        for _ in range(20):
            read_channels(tmp_path / "z.exr")

    threads = [threading.Thread(target=read) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    after = os.fstat(2)
    assert sys.stdout is out
    assert (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino)


@pytest.mark.skipif(sys.platform != "linux", reason="a fork of a process with threads")
def test_files_are_read_and_written_after_a_fork(tmp_path: Path) -> None:
    """As by the workers of a torch DataLoader."""
    code = """
import os, sys
import numpy as np
from raden_torch.images.exr import read_channels, write_channels
pixels = np.random.default_rng(0).normal(size=(600, 500)).astype(np.float32)
write_channels(sys.argv[1], {"Z": pixels, "Y": pixels})
read_channels(sys.argv[1])
if os.fork() == 0:
    write_channels(sys.argv[1], {"Z": 2 * pixels})
    os._exit(not np.array_equal(read_channels(sys.argv[1])["Z"], 2 * pixels))
sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))
"""
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "z.exr")], timeout=60)
    assert done.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="closes a file descriptor before Python starts")
def test_a_process_without_stderr_reads_and_writes(tmp_path: Path) -> None:
    path = tmp_path / "z.exr"
    code = (
        "import sys; from raden_torch.images.exr import *\n"
        "write_channels(sys.argv[1], {'Z': [[5.0]]}); print(read_channels(sys.argv[1])['Z'][0, 0])"
    )
    done = subprocess.run(
        f'"{sys.executable}" -c "$CODE" "{path}" 2>&-',
        shell=True,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"CODE": code},
    )
    assert (done.returncode, done.stdout) == (0, "5.0\n")
