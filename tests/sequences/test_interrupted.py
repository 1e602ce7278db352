"""Ctrl-C in the middle of a sequence: what is on disk is whole, and the same command goes on."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from raden_torch.images.exr_file import ExrFile

FRAMES = 60


@pytest.mark.slow
def test_ctrl_c_leaves_whole_frames_and_the_rest_can_be_done(
    model_file: Path, shots: Callable[..., Path], tmp_path: Path
) -> None:
    pattern, out = shots(*range(1, FRAMES + 1), height=270, width=480), tmp_path / "lit.####.exr"
    words = ["render", str(model_file), "--gbuffer", str(pattern), "-o", str(out)]
    command = [sys.executable, "-m", "raden_torch.cli", *words, "--frames", f"1-{FRAMES}", "--json"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a test run in the background of a shell ignores SIGINT, and its processes would, too
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:
        assert process.stdout is not None
        told = [json.loads(process.stdout.readline()) for _ in range(3)]
        process.send_signal(signal.SIGINT)
        rest, said = process.communicate(timeout=60)
    told += [json.loads(line) for line in rest.splitlines()]
    end = told[-1]
    assert process.returncode == 128 + signal.SIGINT
    assert said.splitlines() == ["raden: stopped by SIGINT"]
    assert (end["event"], end["stopped_by"]) == ("end", "SIGINT")
    assert end["left"] > 0
    files = sorted(tmp_path.glob("lit*"))
    assert end["written"] <= len(files) < FRAMES
    for path in files:
        ExrFile(path).check_whole()
    assert not list(tmp_path.glob(".*"))

    done = subprocess.run(command, capture_output=True, text=True, check=True)
    end = json.loads(done.stdout.splitlines()[-1])
    assert (end["written"], end["kept"]) == (FRAMES - len(files), len(files))
