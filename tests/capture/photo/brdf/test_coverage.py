"""Following the suggestion fills the cells that it promised, and more than lamps at random."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from raden_torch.capture.photo.brdf.coverage import coverage
from raden_torch.capture.photo.brdf.photo_brdf_file import write_brdf
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.sample_shapes import Plane, Sphere
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.plots.coverage_figure import draw_captured
from raden_torch.plots.sheet import save_plot


@pytest.mark.slow
def test_following_the_suggestion_keeps_its_promise(sphere: Any, tmp_path: Path) -> None:
    start = sphere.triples[::3]
    before = sphere.run(lamps=start, radius=90.0, name="before")
    suggested = [stance.lamp for stance in before.coverage.next]
    promised = int(before.coverage.after.sum() - before.coverage.covered.sum())
    assert promised == sum(stance.gain for stance in before.coverage.next)
    after = sphere.run(lamps=np.array([*start, *suggested]), radius=90.0, name="after")
    gained = int(after.coverage.covered.sum() - before.coverage.covered.sum())
    assert abs(gained / promised - 1) < 0.1
    random = np.random.default_rng(0)
    for attempt in range(2):
        lamps = random.normal(size=(20, 3))
        lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
        lamps = np.array([*start, *lamps[lamps[:, 2] > -0.8][: len(suggested)]])
        other = sphere.run(lamps=lamps, radius=90.0, name=f"random{attempt}")
        assert gained > 1.2 * int(other.coverage.covered.sum() - before.coverage.covered.sum())
    write_brdf(after, tmp_path / "shell.json")
    said = json.loads((tmp_path / "shell.json").read_text())
    assert said["cells_covered"] == after.coverage.covered.sum()
    assert {"noise", "place", "white", "geometry", "total"} <= set(
        said["median_relative_std_percent"]["body"]
    )
    save_plot(draw_captured(before), tmp_path / "before.png")
    assert (tmp_path / "before.png").stat().st_size > 20_000


def test_a_sphere_seen_from_afar_needs_lamps_all_round(sphere: Any) -> None:
    """From nothing, greedy lamps fill most of what is reachable; each adds what it says."""
    grid = CellGrid(10.0)
    ball = Sphere(np.array([0.0, 0.0, 0.0]), 200.0)
    found = coverage(np.zeros(grid.cells, bool), grid, ball, None, None, None, stances=20)
    assert found.share == 0
    assert found.reachable.mean() > 0.9
    assert found.after.sum() == sum(stance.gain for stance in found.next)
    assert found.after.sum() > 0.6 * found.reachable.sum()
    assert all("deg towards" in stance.text and stance.camera is None for stance in found.next)


def test_a_plane_needs_the_camera_moved(sphere: Any) -> None:
    """Where the board's pose is known a stance is a lamp and a camera, both above the board."""
    grid = CellGrid(10.0)
    corners = np.array([[-30.0, -30, -300], [30, -30, -300], [30, 30, -300], [-30, 30, -300]])
    plane = Plane(corners, np.array([0.0, 0.0, 1.0]))
    camera = Camera(np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), np.zeros(5), (480, 640))
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 0.3]), 0.1, 24)
    still = coverage(np.zeros(grid.cells, bool), grid, plane, camera, None, 300.0, stances=3)
    moved = coverage(np.zeros(grid.cells, bool), grid, plane, camera, pose, 300.0, stances=3)
    assert moved.reachable.sum() > 2 * still.reachable.sum()
    assert moved.after.sum() >= still.after.sum()
    assert "of the board's normal" in moved.next[0].text
    for stance in moved.next:
        assert stance.lamp[2] > 0
        assert stance.camera is None or stance.camera[2] > 0.2
