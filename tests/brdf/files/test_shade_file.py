"""Images larger than memory: bands are the whole picture, within the memory that was stated."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files import bands
from raden_torch.brdf.files.display import Display
from raden_torch.brdf.files.exr_tensors import read_colour, write_image
from raden_torch.brdf.files.gbuffer_file import GBufferFile, read_gbuffer
from raden_torch.brdf.files.gbuffer_reading import GBufferReading
from raden_torch.brdf.files.shade_file import shade_file
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels, write_parts
from raden_torch.pictures import render_gbuffer_file

OpenEXR = pytest.importorskip("OpenEXR")

H, W = 150, 40
Y, X = np.mgrid[:H, :W].astype(np.float32)
BUMPS = np.stack([0.5 * np.sin(X / 3 + Y / 40), 0.4 * np.cos(Y / 7), np.ones_like(X)])
BUMPS = (BUMPS / np.linalg.norm(BUMPS, axis=0)).astype(np.float32)
# the first rows leave it open how the normals are stored
FACING = BUMPS.copy()
FACING[:, :40] = np.abs(FACING[:, :40])
CODED = (BUMPS + 1) / 2
DEPTH = (5 + np.sin(X / 9) + Y / 50).astype(np.float32)
POSITION = np.stack([X / W - 0.5, 0.5 - Y / H, np.sin(X / 9)]).astype(np.float32)
POINT = rt.PointLight((0.2, 0.3, 2.0), (3.0, 4.0, 5.0))
SUN = rt.DirectionalLight((0.3, 0.2, 1.0))


def layer(name: str, letters: str, vectors: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}{letter}": v for letter, v in zip(letters, vectors, strict=True)}


FILES = {
    "normals": (layer("N.", "XYZ", BUMPS), {}, SUN),
    "normals, signed late": (layer("N.", "XYZ", FACING), {}, SUN),
    "coded normals": (layer("N.", "XYZ", CODED), {}, SUN),
    "bare normals": (layer("", "RGB", FACING), {}, SUN),
    "bare coded normals": (layer("", "RGB", CODED), {}, SUN),
    "a pinhole": (layer("N.", "XYZ", BUMPS), {"fov_deg": 50}, SUN),
    "depth and mask": (
        layer("N.", "XYZ", BUMPS) | {"Z": DEPTH, "A": (X + Y) % 3 / 2},
        {"fov_deg": 50},
        rt.PointLight((0.2, 0.3, 2.0), (30.0, 40.0, 50.0)),
    ),
    "positions": (
        layer("N.", "XYZ", BUMPS) | layer("P.", "XYZ", POSITION),
        {"camera": (0.0, 0.0, 3.0)},
        POINT,
    ),
    "a map of views": (
        layer("N.", "XYZ", BUMPS),
        {"view": torch.from_numpy(np.flip(BUMPS, 1).copy())[None]},
        SUN,
    ),
}


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    values = torch.rand(8, 15, 15, 3, generator=torch.Generator().manual_seed(0))
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
    return rt.RadenBrdf(diffuse, ReflectanceTable(values, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0)))


def memory_for(rows: int, channels: int) -> int:
    """Bytes with which so many rows of these images are one band."""
    each = bands.BYTES_A_PIXEL + bands.BYTES_A_CHANNEL * channels
    return rows * W * each


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("compressed", [True, False], ids=["ZIP", "flat"])
def test_bands_are_the_whole_picture_bit_for_bit(tmp_path, model, name, compressed) -> None:
    channels, scene, light = FILES[name]
    kind = OpenEXR.ZIP_COMPRESSION if compressed else OpenEXR.NO_COMPRESSION
    header = {"compression": kind, "type": OpenEXR.scanlineimage}
    arrays = {key: np.ascontiguousarray(a, np.float32) for key, a in channels.items()}
    OpenEXR.File([OpenEXR.Part(header, arrays, "")]).write(str(tmp_path / "in.exr"))
    gbuffer = read_gbuffer(tmp_path / "in.exr", **scene)
    with torch.no_grad():
        write_image(rt.shade(model, gbuffer, light), tmp_path / "whole.exr")
    file = GBufferFile(
        tmp_path / "in.exr", GBufferReading(**scene), memory=memory_for(33, len(channels))
    )
    assert file.bands == [(top, min(top + 32, H)) for top in range(0, H, 32)]
    assert list(shade_file(model, file, light, tmp_path / "out.exr")) == [32, 64, 96, 128, 150]
    assert (tmp_path / "out.exr").read_bytes() == (tmp_path / "whole.exr").read_bytes()
    assert float(read_colour(tmp_path / "out.exr").amax()) > 0


def test_parts_and_a_gain(tmp_path, model) -> None:
    parts = {"rgba": layer("", "RGB", POSITION), "normal": layer("", "XYZ", BUMPS)}
    write_parts(tmp_path / "in.exr", parts)
    with torch.no_grad():
        image = rt.shade(model, read_gbuffer(tmp_path / "in.exr"), SUN)
    shares: list[float] = []
    stops = render_gbuffer_file(
        *(model, tmp_path / "in.exr", tmp_path / "out.exr", [SUN]),
        display=Display(2.0),
        memory=memory_for(80, 6),
        shown=shares.append,
    )
    assert (stops, shares) == (2.0, [80 / H, 1.0])
    assert torch.equal(read_colour(tmp_path / "out.exr"), (4 * image).half().float())


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_interrupted_picture_leaves_the_old_one(tmp_path, model, error) -> None:
    write_channels(tmp_path / "in.exr", layer("N.", "XYZ", BUMPS))
    (tmp_path / "out.exr").write_bytes(b"old")

    def interrupt(share: float) -> None:
        raise error

    with pytest.raises(error):
        render_gbuffer_file(
            *(model, tmp_path / "in.exr", tmp_path / "out.exr"),
            memory=memory_for(32, 3),
            shown=interrupt,
        )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.exr", "out.exr"]
    assert (tmp_path / "out.exr").read_bytes() == b"old"


def test_what_cannot_be_shaded_in_bands(tmp_path, model) -> None:
    path, out = tmp_path / "in.exr", tmp_path / "out.exr"
    write_channels(path, {"Z": DEPTH})
    with pytest.raises(
        InputError, match=r"in\.exr: expected normals, got depth alone.*more memory"
    ):
        GBufferFile(path, GBufferReading(fov_deg=50), memory=memory_for(32, 1))
    write_channels(path, layer("N.", "XYZ", BUMPS))
    needed = memory_for(16, 3)
    with pytest.raises(
        InputError, match=f"memory: expected at least {needed} bytes for 16 rows.*, got 1000$"
    ):
        GBufferFile(path, memory=1000)
    write_channels(path, layer("N.", "XYZ", np.zeros_like(BUMPS)))
    with pytest.raises(InputError, match="no valid pixel"):
        list(shade_file(model, GBufferFile(path, memory=memory_for(32, 3)), SUN, out))
    write_channels(path, layer("N.", "XYZ", BUMPS))
    with pytest.raises(InputError, match="expected a G-buffer with position"):
        list(shade_file(model, GBufferFile(path, memory=memory_for(32, 3)), POINT, out))
    assert [p.name for p in tmp_path.iterdir()] == ["in.exr"]


LIMIT = 32 * 2**20
MEASURED = """
import ctypes
import sys
from pathlib import Path
from raden_torch import load_model
from raden_torch.pictures import render_gbuffer_file

def peak():  # of this process; ru_maxrss would begin with the parent's
    with open("/proc/self/status") as status:
        return next(1024 * int(line.split()[1]) for line in status if line.startswith("VmHWM"))

model, small, large, out = map(Path, sys.argv[1:5])
ready = load_model(model)
ready.runtime_table()  # baking it takes memory of its own
ctypes.CDLL(None).malloc_trim(0)
with open("/proc/self/clear_refs", "w") as mark:
    mark.write("5")  # the high-water mark begins anew
render_gbuffer_file(ready, small, out)  # everything is imported, every thread runs
before = peak()
render_gbuffer_file(ready, large, out, memory=int(sys.argv[5]))
print(peak() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the high-water mark is read from /proc")
@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "ZIPS_COMPRESSION"])
def test_the_memory_limit_is_kept(tmp_path, model, compression) -> None:
    noise = np.random.default_rng(0).normal(size=(3, 256, 4096)).astype(np.float32)
    tall = np.tile(noise, (1, 8, 1))
    rt.save_model(model, tmp_path / "model.safetensors")
    for name, normals in {"small": BUMPS, "large": tall}.items():
        header = {
            "compression": getattr(OpenEXR, compression),
            "type": OpenEXR.scanlineimage,
        }
        OpenEXR.File([OpenEXR.Part(header, layer("N.", "XYZ", normals), "")]).write(
            str(tmp_path / f"{name}.exr")
        )
    assert (tmp_path / "large.exr").stat().st_size > 2.5 * LIMIT
    files = [tmp_path / name for name in ("model.safetensors", "small.exr", "large.exr", "o.exr")]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MEASURED, *map(str, files), str(LIMIT)],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert 0 < int(done.stdout) <= LIMIT
    assert read_colour(Path(files[3])).shape == (1, 3, 2048, 4096)
