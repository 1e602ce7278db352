"""`raden render --frames`: which frames are done, what is told, and what is on disk then."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from raden_torch import files
from raden_torch.cli import run
from raden_torch.errors import InputError
from raden_torch.images.exr import _check_room, read_channels, write_channels
from raden_torch.images.pixels import read_image
from raden_torch.sequences.job import done_alone
from raden_torch.sequences.local import LocalEngine
from raden_torch.sequences.render_job import RenderJob, plan_render

Shots = Callable[..., Path]


def render(model: Path, shots: Path, output: Path, *words: str) -> int:
    """The exit code."""
    try:
        run(["render", str(model), "--gbuffer", str(shots), "-o", str(output), *words])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def names(folder: Path, pattern: str = "lit*") -> list[str]:
    return sorted(path.name for path in folder.glob(pattern))


def test_each_frame_is_what_the_single_command_writes(
    model_file: Path, shots: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern = shots(1, 2, 3, 5)
    assert render(model_file, pattern, tmp_path / "lit.####.exr", "--frames", "1-3x2,5") == 0
    assert names(tmp_path) == ["lit.0001.exr", "lit.0003.exr", "lit.0005.exr"]
    assert "3 written, in" in capsys.readouterr().out
    single = tmp_path / "single.exr"
    for number in (1, 3, 5):
        assert render(model_file, tmp_path / f"shot.{number:04d}.exr", single) == 0
        assert single.read_bytes() == (tmp_path / f"lit.{number:04d}.exr").read_bytes()
    assert not list(tmp_path.glob(".*"))


def test_frames_that_are_there_are_kept_unless_forced(
    model_file: Path, shots: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern, out = shots(1, 2), tmp_path / "lit.####.exr"
    render(model_file, pattern, out, "--frames", "1")
    first = tmp_path / "lit.0001.exr"
    before = first.stat().st_mtime_ns
    (tmp_path / "shot.0001.exr").unlink()  # which a finished frame needs no more
    assert render(model_file, pattern, out, "--frames", "1-2") == 0
    assert first.stat().st_mtime_ns == before
    assert "1 written, 1 kept" in capsys.readouterr().out
    shots(1)
    assert render(model_file, pattern, out, "--frames", "1-2", "--force") == 0
    assert first.stat().st_mtime_ns > before
    assert "2 written" in capsys.readouterr().out


def test_a_gap_is_told_before_anything_is_rendered(
    model_file: Path, shots: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern, out = shots(1001, 1004, 1005), tmp_path / "lit.####.exr"
    with pytest.raises(InputError, match=r"missing are 1002-1003,1006 \(3 of 6\); `skip_missing`"):
        render(model_file, pattern, out, "--frames", "1001-1006")
    assert names(tmp_path) == []
    assert render(model_file, pattern, out, "--frames", "1001-1006", "--skip-missing") == 0
    assert len(names(tmp_path)) == 3
    assert "3 written, 3 without files" in capsys.readouterr().out
    with pytest.raises(InputError, match="missing are 7-8"):
        render(model_file, pattern, out, "--frames", "7-8", "--skip-missing")


def test_damaged_frames_and_others_than_the_first_fail_alone(
    model_file: Path, shots: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern = shots(1, 2, 6)
    whole = (tmp_path / "shot.0001.exr").read_bytes()
    (tmp_path / "shot.0003.exr").write_bytes(whole[: len(whole) // 2])
    shots(4, height=12)
    shots(5, Z=np.ones((24, 32)))
    assert render(model_file, pattern, tmp_path / "lit.####.exr", "--frames", "1-6") == 3
    assert names(tmp_path) == ["lit.0001.exr", "lit.0002.exr", "lit.0006.exr"]
    captured = capsys.readouterr()
    assert "3 written, 3 failed (3-5)" in captured.out
    said = sorted(captured.err.splitlines())
    assert "truncated or damaged" in said[0]
    assert "expected 32 x 24 pixels, as shot.0001.exr has, got 32 x 12" in said[1]
    assert "expected the channels of shot.0001.exr, got them with Z" in said[2]
    assert len(said) == 3


def test_an_empty_frame_is_black(model_file: Path, shots: Shots, tmp_path: Path) -> None:
    pattern = shots(1)
    zero = np.zeros((24, 32))
    write_channels(tmp_path / "shot.0002.exr", {"N.X": zero, "N.Y": zero, "N.Z": zero})
    with pytest.warns(UserWarning, match=r"shot\.0002\.exr: no pixel is valid"):
        assert render(model_file, pattern, tmp_path / "lit.####.exr", "--frames", "1-2") == 0
    assert read_channels(tmp_path / "lit.0002.exr")["R"].max() == 0


def test_lines_for_a_farm(
    model_file: Path, shots: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern = shots(1, 2, 3)
    (tmp_path / "shot.0002.exr").write_bytes(b"no EXR")
    out = tmp_path / "lit.####.exr"
    assert render(model_file, pattern, out, "--frames", "1-3", "--json") == 3
    captured = capsys.readouterr()
    start, *told, end = map(json.loads, captured.out.splitlines())
    assert captured.err == ""
    assert (start["event"], start["total"], start["missing"]) == ("start", 3, 0)
    assert 1 <= start["in_flight"] <= start["total"] + 3
    assert start["memory_bytes"] > 24 * 32 * 240
    assert {t["frame"]: t["state"] for t in told} == {1: "written", 2: "failed", 3: "written"}
    assert [t["done"] for t in told] == [1, 2, 3]
    written = next(t for t in told if t["frame"] == 3)
    assert Path(written["file"]) == tmp_path / "lit.0003.exr"
    assert set(written["seconds"]) == {"read", "work", "write"}
    assert (end["event"], end["written"], end["failed"], end["left"]) == ("end", 2, "2", 0)
    assert end["exit_code"] == 3


def test_pictures_are_exposed_alike_whichever_frames_are_asked_for(
    model_file: Path, shots: Shots, tmp_path: Path
) -> None:
    pattern = shots(1, 9)
    assert render(model_file, pattern, tmp_path / "both.####.png", "--frames", "1,9") == 0
    assert render(model_file, pattern, tmp_path / "one.####.png", "--frames", "9") == 0
    both, one = (read_image(tmp_path / f"{n}.0009.png").pixels for n in ("both", "one"))
    assert np.array_equal(both, one)
    (tmp_path / "shot.0001.exr").unlink()
    render(model_file, pattern, tmp_path / "by_itself.####.png", "--frames", "9")
    assert not np.array_equal(read_image(tmp_path / "by_itself.0009.png").pixels, one)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "lit.exr", "--frames", "1"], r"as lit\.####\.exr, or a folder"),
        (["-o", "shot.####.exr", "--frames", "1"], "is also an input"),
        (["-o", "lit.####.jpg2", "--frames", "1"], "suffix: expected one of"),
        (["-o", "no/where/lit.####.exr", "--frames", "1"], "expected an existing folder"),
        (["-o", "lit.####.exr"], "expected `frames`, as 1-2, got none"),
        (["-o", "lit.exr", "--force"], "--force: expected with --frames"),
        (
            ["-o", "lit.####.exr", "--frames", "1-2", "--memory", "100K"],
            "memory: expected at least",
        ),
    ],
)
def test_what_is_refused(
    model_file: Path,
    shots: Shots,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    said: str,
) -> None:
    shots(1, 2)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said):
        run(["render", str(model_file), "--gbuffer", "shot.####.exr", *words])
    assert names(tmp_path) == []


def test_a_picture_of_another_size_is_not_kept(
    model_file: Path, shots: Shots, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pattern, out = shots(1, 2), tmp_path / "lit.####.exr"
    write_channels(tmp_path / "lit.0001.exr", {"R": np.ones((5, 7))}, half=True)
    assert render(model_file, pattern, out, "--frames", "1-2") == 3
    assert "expected a picture of 32 x 24 pixels to keep, got 7 x 5" in capsys.readouterr().err
    assert render(model_file, pattern, out, "--frames", "1-2", "--force") == 0


def _job(model_file: Path, pattern: Path, target: Path, **more: bool) -> RenderJob:
    job = RenderJob(target=target, model=model_file, gbuffer=pattern, **more)
    return plan_render(job, range(1, 7))[0]


def _rendered(job: RenderJob, start: multiprocessing.Barrier) -> None:  # type: ignore[valid-type]
    start.wait()
    states = {
        outcome.state for outcome in LocalEngine(prepared=job.prepare()).run(job, range(1, 7))
    }
    os._exit(0 if states <= {"written", "kept"} else 1)


@pytest.mark.slow
def test_two_processes_in_one_folder(model_file: Path, shots: Shots, tmp_path: Path) -> None:
    """Each frame is there once and whole, and none is replaced by the slower process."""
    job = _job(model_file, shots(*range(1, 7)), tmp_path / "lit.####.exr")
    context = multiprocessing.get_context("spawn")
    start = context.Barrier(2)
    both = [context.Process(target=_rendered, args=(job, start)) for _ in range(2)]
    for process in both:
        process.start()
    for process in both:
        process.join()
    assert [process.exitcode for process in both] == [0, 0]
    assert len(names(tmp_path, "*lit*")) == 6
    assert not list(tmp_path.glob(".*"))
    alone = _job(model_file, job.gbuffer, tmp_path / "alone.####.exr")
    assert all(done_alone(alone, alone.prepare(), n).state == "written" for n in range(1, 7))
    for n in range(1, 7):
        first, second = (tmp_path / f"{name}.{n:04d}.exr" for name in ("lit", "alone"))
        assert first.read_bytes() == second.read_bytes()


def test_the_first_of_two_writers_counts(
    model_file: Path, shots: Shots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = _job(model_file, shots(*range(1, 7)), tmp_path / "lit.####.exr")
    prepared = job.prepare()
    worked = job.work(prepared, job.read(prepared, 1))
    (tmp_path / "lit.0001.exr").write_bytes(b"another process's")
    assert not job.write(prepared, worked, 1)
    assert (tmp_path / "lit.0001.exr").read_bytes() == b"another process's"

    def no_links(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(files.os, "link", no_links)
    assert not job.write(prepared, worked, 1)
    assert job.write(prepared, worked, 2)
    assert len(read_channels(tmp_path / "lit.0002.exr")) == 3
    assert not list(tmp_path.glob(".*"))


def test_a_full_disk_stops_it(
    model_file: Path,
    shots: Shots,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pattern = shots(*range(1, 31))

    def no_room(temporary: Path, real: Path) -> bool:
        raise OSError(errno.ENOSPC, "No space left on device", str(temporary))

    monkeypatch.setattr(files, "_put_in_place", no_room)
    assert render(model_file, pattern, tmp_path / "lit.####.exr", "--frames", "1-30") == 3
    captured = capsys.readouterr()
    assert names(tmp_path, "*lit*") == []
    told = [line for line in captured.err.splitlines() if "No space left" in line]
    assert 1 <= len(told) <= 12
    assert f"{30 - len(told)} not reached" in captured.out
    assert "raden: the disk is full: no further frame was begun" in captured.err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a disk that is full")
def test_openimageio_tells_a_full_disk(tmp_path: Path) -> None:
    """Rationale: it says only that it cannot write; the errno is what ends a sequence."""
    temporary = tmp_path / "a.exr"
    temporary.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        _check_room(temporary)
    assert caught.value.errno == errno.ENOSPC


def test_a_job_travels_and_its_shared_files_may_be_elsewhere(
    model_file: Path, shots: Shots, tmp_path: Path
) -> None:
    job = _job(model_file, shots(*range(1, 7)), tmp_path / "lit.####.exr")
    copy = tmp_path / "copy.safetensors"
    shutil.copy(model_file, copy)
    assert job.shared == (model_file,)
    moved = pickle.loads(pickle.dumps(job)).relocated({model_file: copy})
    assert moved.shared == (copy,)
    assert (moved.gbuffer, moved.target, moved.shape) == (job.gbuffer, job.target, job.shape)


def test_pictures_are_exposed_as_the_first_frame_that_can_be_read(
    model_file: Path, shots: Shots, tmp_path: Path, raden: Callable
) -> None:
    pattern, out = shots(1, 2, 3), tmp_path / "lit.####.png"
    (tmp_path / "shot.0001.exr").write_bytes(b"damaged")
    words = ("render", model_file, "--gbuffer", pattern, "-o", out, "--frames", "1-3")
    done = raden(*words, "--json", "--quiet")
    assert done.returncode == 3
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert told[-1]["failed"] == "1"
    assert names(tmp_path) == ["lit.0002.png", "lit.0003.png"]
    assert render(model_file, pattern, tmp_path / "own.####.png", "--frames", "3") == 0
    assert (tmp_path / "own.0003.png").read_bytes() == (tmp_path / "lit.0003.png").read_bytes()
