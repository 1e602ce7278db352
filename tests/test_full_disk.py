"""Writers on a full disk or in a closed folder: one line that names the file; the older one stays.

A limit on the size of files stands for the full disk: the same writes fail, with EFBIG.
"""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.display import write_picture
from raden_torch.brdf.files.image_file import Photograph, write_photograph
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.capture.photo.result_file import write_result
from raden_torch.capture.photo.simulation import photo_file
from raden_torch.errors import InputError
from raden_torch.files import check_writable, written_beside
from raden_torch.images.exr import rows_written, write_channels
from raden_torch.measurement import BrdfMeasurement
from raden_torch.plots import draw, save_plot

NOISE = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
IMAGE = torch.from_numpy(NOISE / 255.0).movedim(-1, 0)
FEW_BYTES = 500


@cache
def measured() -> BrdfMeasurement:
    return rt.simulate_specimen("yakogai", step_deg=35.0)


def written_in_rows(path: Path) -> None:
    with rows_written(path, (64, 64)) as add:
        add({"R": NOISE[..., 0].astype(np.float16)})


def exported(path: Path) -> None:
    matt = rt.RadenBrdf(CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.ones(3)), None)
    rt.export_onnx(matt, path, output="brdf")


WRITERS: dict[str, Callable[[Path], object]] = {
    "shell.csv": lambda path: measured().save(path),
    "model.safetensors": lambda path: rt.save_model(
        rt.fit(measured(), interpolation="trilinear").model, path
    ),
    "picture.png": lambda path: write_picture(IMAGE, path),
    "picture.jpg": lambda path: write_picture(IMAGE, path),
    "photograph.tif": lambda path: write_photograph(Photograph(IMAGE[None], 65535), path),
    "photograph.hdr": lambda path: write_photograph(Photograph(IMAGE[None].float(), None), path),
    "simulated.png": lambda path: photo_file.write_photograph(path, NOISE, 0.1),
    "layers.exr": lambda path: write_channels(path, {"Z": NOISE[..., 0]}),
    "rows.exr": written_in_rows,
    "result.json": lambda path: write_result(path, "camera", {"numbers": NOISE[..., 0].ravel()}),
    "graphs.png": lambda path: save_plot(draw(measured(), ["6"]), path),
    "graphs.svg": lambda path: save_plot(draw(measured(), ["6"]), path),
    "graphs.pdf": lambda path: save_plot(draw(measured(), ["6"]), path),
    "shader.onnx": exported,
}


@contextmanager
def full_disk(size: int = FEW_BYTES) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if n.endswith(".onnx") else []) for n in WRITERS],
)
def test_a_full_disk_leaves_the_older_file(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"older")
    with pytest.raises((OSError, InputError)) as caught, full_disk():
        WRITERS[name](path)
    error = caught.value
    if isinstance(error, OSError):
        assert (error.errno, error.filename) == (errno.EFBIG, str(path))
    else:  # OpenEXR does not say why
        assert str(error).startswith(str(path))
        assert "\n" not in str(error)
    assert path.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [path]
    WRITERS[name](path)  # there is room again
    assert path.stat().st_size > FEW_BYTES


@pytest.mark.parametrize("missing", [1, 40])
def test_a_disk_that_is_full_at_the_end(tmp_path: Path, missing: int) -> None:
    """The last bytes are written when the file is closed."""
    path = tmp_path / "layers.exr"
    pixels = np.random.default_rng(0).normal(size=(64, 64))
    write_channels(path, {"Z": pixels})
    size = path.stat().st_size
    path.write_bytes(b"older")
    with pytest.raises(OSError, match="File too large") as caught, full_disk(size - missing):
        write_channels(path, {"Z": pixels})
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"older"
    with full_disk(size):
        write_channels(path, {"Z": pixels})
    assert path.stat().st_size == size


@pytest.mark.parametrize("words", [("merge", "in.csv", "in.csv", "-o"), ("plot", "in.csv", "-o")])
def test_the_command_says_it_in_one_line(tmp_path: Path, words: tuple[str, ...]) -> None:
    m = measured()
    replace(m, std=np.ones_like(m.values)).save(tmp_path / "in.csv")
    name = "out.csv" if words[0] == "merge" else "out.pdf"
    done = subprocess.run(
        [sys.executable, "-m", "raden_torch.cli", *words, name],
        cwd=tmp_path,
        env=os.environ | {"MPLCONFIGDIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (FEW_BYTES, -1)),
    )
    assert done.returncode == 2
    said = [line for line in done.stderr.splitlines() if line.startswith("raden: ")]
    assert said == [f"raden: {name}: File too large"]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / name).exists()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".out")]


def test_a_file_that_may_not_be_made_or_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "shell.csv"

    def refused(*arguments: object, **_: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(arguments[0]))

    for call in ("open", "replace"):
        with monkeypatch.context() as patched:
            patched.setattr(f"raden_torch.files.os.{call}", refused)
            with pytest.raises(PermissionError) as caught, written_beside(path):
                pass
        assert caught.value.filename == str(path)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("closed", ["folder", "file"])
def test_what_is_write_protected_is_refused_early(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, closed: str
) -> None:
    path = tmp_path / "shell.csv"
    path.write_text("older")
    place = tmp_path if closed == "folder" else path
    real = os.access  # root may write everywhere: ask as another user would
    monkeypatch.setattr(os, "access", lambda p, mode: Path(p) != place and real(p, mode))
    with pytest.raises(InputError, match=f"expected a place to write, got {place}, write-protec"):
        check_writable(path)


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught, written_beside(tmp_path / "a.csv"):
        (tmp_path / "missing.txt").read_text()
    assert caught.value.filename == str(tmp_path / "missing.txt")
