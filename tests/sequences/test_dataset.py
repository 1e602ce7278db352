"""Frames for a DataLoader: each once, in order, with what `shade` takes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader

import raden_torch as rt
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.files.image_file import read_photograph
from raden_torch.errors import InputError
from raden_torch.sequences import dataset

Shots = Callable[..., Path]
LAMP = rt.DirectionalLight((1, 1, 2))
DOC = Path(__file__).parents[2] / "docs/sequences.md"


def test_a_frame_is_what_read_gbuffer_reads(shots: Shots) -> None:
    pattern = shots(3, 4, 7)
    frames = rt.FrameDataset(pattern)
    assert frames.frames == [3, 4, 7]
    assert frames.size == (24, 32)
    for number, frame in zip(frames.frames, frames, strict=True):
        truth = read_gbuffer(str(pattern).replace("####", f"{number:04d}"))
        assert int(frame["frame"]) == number
        assert torch.equal(frame["normal"], truth.normal[0])
        again = frames.gbuffer(frame)
        assert torch.equal(again.normal, truth.normal)
        assert torch.equal(again.mask, truth.mask)


def test_a_batch_is_shaded_as_its_frames(shots: Shots, model_file: Path) -> None:
    frames = rt.FrameDataset(shots(1, 2, 3), "1-3", fov_deg=40.0)
    model = rt.load_model(model_file)
    with torch.no_grad():
        (batch,) = DataLoader(frames, batch_size=3)
        together = rt.shade(model, frames.gbuffer(batch), LAMP)
        alone = [rt.shade(model, frames.gbuffer(frame), LAMP)[0] for frame in frames]
    assert batch["frame"].tolist() == [1, 2, 3]
    assert torch.allclose(together, torch.stack(alone), atol=1e-7)


def test_positions_and_camera_go_into_a_batch(shots: Shots, model_file: Path) -> None:
    place = {
        f"P.{axis}": value for axis, value in zip("XYZ", torch.ones(3, 24, 32).numpy(), strict=True)
    }
    frames = rt.FrameDataset(shots(1, 2, **place), camera=(0.0, 0.0, 5.0))
    (batch,) = DataLoader(frames, batch_size=2)
    assert batch["camera"].shape == (2, 3)
    image = rt.shade(rt.load_model(model_file), frames.gbuffer(batch), rt.PointLight((0, 0, 3)))
    assert image.shape == (2, 3, 24, 32)


def test_each_frame_is_one_workers(shots: Shots, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = rt.FrameDataset(shots(*range(1, 9)))
    shares = []
    for worker in range(3):
        info = SimpleNamespace(id=worker, num_workers=3)
        monkeypatch.setattr(dataset, "get_worker_info", lambda info=info: info)
        shares.append([int(frame["frame"]) for frame in frames])
    assert shares == [[1, 4, 7], [2, 5, 8], [3, 6]]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_workers_share_the_frames_out(shots: Shots, workers: int) -> None:
    frames = rt.FrameDataset(shots(*range(1, 8)))
    loader: Any = DataLoader(frames, batch_size=None, num_workers=workers)
    for _ in range(2):  # epochs
        assert [int(frame["frame"]) for frame in loader] == list(range(1, 8))
    batches = DataLoader(frames, batch_size=2, num_workers=workers)
    assert sorted(n for batch in batches for n in batch["frame"].tolist()) == list(range(1, 8))


def test_pictures_beside(shots: Shots, photographs: Shots) -> None:
    pattern, photo = shots(1, 2), photographs(1, 2)
    frames = rt.FrameDataset(pattern, pictures={"target": photo})
    for frame in frames:
        truth = read_photograph(str(photo).replace("####", f"{int(frame['frame']):04d}"))
        assert torch.equal(frame["target"], truth.linear[0])
    photographs(2, height=12)
    with pytest.raises(InputError, match=r"expected 32 x 24 pixels, as shot\.0002\.exr has"):
        list(frames)


def test_nothing_is_read_before_it_is_asked_for(shots: Shots, tmp_path: Path) -> None:
    pattern = shots(1, 2)
    (tmp_path / "shot.0002.exr").write_bytes(b"damaged")
    frames = iter(rt.FrameDataset(pattern))
    assert int(next(frames)["frame"]) == 1
    with pytest.raises(InputError, match=r"shot\.0002\.exr"):
        next(frames)


def test_frames_that_are_missing_or_differ(shots: Shots, tmp_path: Path) -> None:
    pattern = shots(1, 3)
    with pytest.raises(InputError, match=r"missing are 2,4 \(2 of 4\)"):
        rt.FrameDataset(pattern, "1-4")
    assert rt.FrameDataset(pattern, "1-4", skip_missing=True).frames == [1, 3]
    shots(2, height=12)
    with pytest.raises(InputError, match=r"expected 32 x 24 pixels, as shot\.0001\.exr has"):
        list(rt.FrameDataset(pattern))
    with pytest.raises(InputError, match="expected frames, got none"):
        rt.FrameDataset(tmp_path / "none.####.exr")
    with pytest.raises(InputError, match="a place for the frame's number"):
        rt.FrameDataset(tmp_path / "shot.0001.exr")
    with pytest.raises(InputError, match="a name that is no map's, got 'normal'"):
        rt.FrameDataset(pattern, pictures={"normal": pattern})


@pytest.mark.slow
def test_the_example_of_the_documentation_runs(
    shots: Shots, photographs: Shots, model_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shots(1001, 1002, 1003, 1004)
    photographs(1001, 1002, 1003, 1004)
    monkeypatch.chdir(model_file.parent)
    model_file.rename("shell.safetensors")
    (block,) = re.findall(r"```python\n(.*?)```", DOC.read_text("utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    exec(block, names)
    before = rt.load_model("shell.safetensors")
    assert not torch.equal(names["model"].diffuse.scale, before.diffuse.scale)
