"""`raden info A B` and `raden merge` as a user calls them, on real and simulated measurements."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import raden_torch as rt
from raden_torch.measurement import native_csv
from raden_torch.measurement.systematic_errors import SystematicErrors

Command = Callable[..., subprocess.CompletedProcess[str]]


def with_noise(source: Path, target: Path, seed: int, scale_std: float = 0.0) -> Path:
    m = rt.load_measurement(source)
    std = 0.01 * np.maximum(m.values, 0.1)
    noise = std * np.random.default_rng(seed).standard_normal(std.shape)
    common = SystematicErrors(scale_std=scale_std)
    meta = replace(m.metadata, systematic=common)
    replace(m, values=m.values + noise, std=std, metadata=meta).save(target)
    return target


@pytest.mark.slow
def test_real_paint_agrees_with_itself_and_not_with_spectralon(
    raden: Command, shared: Path, tmp_path: Path
) -> None:
    folder = shared / "data" / "measured_brdf"
    first, second = (
        with_noise(folder / "pearl-paint.csv", tmp_path / f"{seed}.csv", seed, 0.01)
        for seed in (1, 2)
    )
    white = with_noise(folder / "spectralon_rgb.csv", tmp_path / "white.csv", 3)
    same = raden("info", first, second)
    assert same.returncode == 0, same.stderr
    assert "verdict: they agree within their stated uncertainties" in same.stdout
    rows = {line.split()[0]: line.split() for line in same.stdout.splitlines() if line}
    counts = [int(rows[name][1]) for name in ("ridge", "body", "grazing", "retro", "all")]
    assert counts[-1] == sum(counts[:-1]) == 12615
    assert 0.8 < float(rows["ridge"][-2]) < 1.2
    other = raden("info", first, white)
    assert other.returncode == 0, other.stderr
    assert "verdict: they disagree" in other.stdout

    picture = tmp_path / "both.png"
    drawn = raden("plot", first, second, "-o", picture)
    assert drawn.returncode == 0, drawn.stderr
    assert cv2.imread(str(picture)).std() > 10

    merged = tmp_path / "merged.csv"
    refused = raden("merge", first, white, "-o", merged)
    assert refused.returncode == 2
    assert "cells that contradict; worst: (" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert not merged.exists()
    done = raden("merge", first, second, "-o", merged)
    assert done.returncode == 0, done.stderr
    found = native_csv.read(merged)
    assert (found.count == 2).all()
    truth = rt.load_measurement(folder / "pearl-paint.csv")
    z = (found.values - truth.values) / found.std
    assert np.mean(z**2) == pytest.approx(1, abs=0.2)
    assert found.metadata.systematic.scale_std == pytest.approx(0.01 / np.sqrt(2), rel=1e-3)


def test_what_is_wrong_is_said_in_one_line(raden: Command, tmp_path: Path) -> None:
    m = rt.simulate_specimen("yakogai", step_deg=35)
    m.save(tmp_path / "a.csv")
    for arguments, words in (
        (
            ("merge", tmp_path / "a.csv", tmp_path / "a.csv", "-o", tmp_path / "c.csv"),
            "by which its readings are weighed",
        ),
        (("info", tmp_path / "a.csv", tmp_path / "none.csv"), "none.csv"),
    ):
        done = raden(*arguments)
        assert done.returncode == 2
        assert words in done.stderr
        assert done.stderr.count("\n") == 1
    assert not (tmp_path / "c.csv").exists()
    both = raden("info", tmp_path / "a.csv", tmp_path / "a.csv")
    assert "yakogai (simulated); states no standard deviation" in both.stdout
