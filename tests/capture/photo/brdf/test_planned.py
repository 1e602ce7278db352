"""Flat pieces each in its own plane; readings at their own angles; photographs against a plan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from raden_torch.capture.photo.brdf.board_region import board_plane
from raden_torch.capture.photo.brdf.capture_settings import SampleSpec
from raden_torch.capture.photo.brdf.rays import Rays
from raden_torch.capture.photo.brdf.sample_shapes import Plane, Planes
from raden_torch.capture.photo.camera import Pose
from raden_torch.capture.photo.capture_brdf import capture_brdf
from raden_torch.capture.photo.guide.piece import Piece
from raden_torch.capture.photo.guide.plan import plan_photographs
from raden_torch.capture.photo.guide.plan_file import write_plan
from raden_torch.capture.photo.guide.set_up import SetUp
from raden_torch.errors import InputError

POSE = Pose(np.eye(3), np.array([0.0, 0.0, 0.4]), 0.1, 24)


def test_a_card_on_a_wedge_has_its_own_normal() -> None:
    """Its corners' heights over the board say how it leans; z of the scene is to the viewer."""
    tilt = np.radians(20)
    x = np.array([0.0, 0.03, 0.03, 0.0])
    y = np.array([0.0, 0.0, 0.02, 0.02])
    leant = np.stack([x * np.cos(tilt), y, 0.03 * np.sin(tilt) - x * np.sin(tilt)], 1)
    plane = board_plane(leant, POSE)
    np.testing.assert_allclose(plane.normal, [np.sin(tilt), 0, np.cos(tilt)], atol=1e-12)
    np.testing.assert_allclose(board_plane(leant[:, :2], POSE).normal, [0, 0, 1], atol=1e-12)
    bent = leant + np.array([[0, 0, 0.004], [0, 0, 0], [0, 0, 0.004], [0, 0, 0]])
    with pytest.raises(InputError, match=r"corners in one plane, got some .* a bent card is"):
        board_plane(bent, POSE)


def test_a_ray_meets_the_first_piece_inside_its_corners() -> None:
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    low = Plane(square, np.array([0.0, 0.0, 1.0]))
    lean = np.array([0.6, 0.0, 0.8])
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    high = Plane(square / 2 @ turn.T + [0, 0, 2.0], lean)
    both = Planes((low, high))
    start = np.array([[0.0, 0, 9], [0.9, 0, 9], [3.0, 0, 9]])
    seen = both.seen(Rays(start, np.broadcast_to([0.0, 0, -1], start.shape)))
    np.testing.assert_allclose(seen.point[:2, 2], [2, 0], atol=1e-12)
    np.testing.assert_allclose(seen.normal[:2], [lean, [0, 0, 1]])
    assert np.isnan(seen.normal[2]).all()
    surface, area = both.spread(400)
    assert area.sum() == pytest.approx(5, rel=0.1)
    assert set(np.round(surface.normal[:, 0], 6)) == {0.0, 0.6}


class Planned:
    """A plan, its photographs, and how they are measured."""

    def __init__(self, board: Any, folder: Path, count: int = 12) -> None:
        plan = plan_photographs(Piece.flat(100, 80), SetUp(camera_mm=350.0), count,
                                assume="isotropic+reciprocal")  # fmt: skip
        self.path = folder / "plan.json"
        write_plan(plan, self.path)
        lamps, poses = board.planned_places(plan.stances, np.array([0.07, 0.06, 0.0]))
        self.series = board.series(lamps, poses, name="planned")
        self.arguments = board.arguments(self.series)

    def run(self, **options: Any) -> Any:
        return capture_brdf(**{**self.arguments, "scattered": True, "plan": self.path, **options})


@pytest.mark.slow
def test_readings_at_their_own_angles_and_the_plan_s_order(board: Any, tmp_path: Path) -> None:
    """Scattered values are as good as those of nodes, at their own angles, and need no share of the
    grid; photographs in another order, or by another piece's plan, are refused in one line."""
    planned = Planned(board, tmp_path)
    found = planned.run()
    read = found.read
    assert read.valid.all()
    assert len(read) == found.measurement.valid.sum() - _twice(found)
    off = abs(read.values / board.truth_at(read.angles_deg) - 1).max(axis=1)
    assert np.median(off) < 0.01
    assert np.quantile(off, 0.95) < 0.05
    assert (abs(read.angles_deg / 5 - np.rint(read.angles_deg / 5)) > 0.05).any(axis=1).mean() > 0.5

    shots = list(planned.arguments["photographs"])
    setup = replace(planned.arguments["setup"], lamps=tuple(range(1, 13)))
    wrong = [*shots[:2], shots[3], shots[2], *shots[4:]]
    with pytest.raises(InputError, match=r"photo3.png: it is given as number 3 of .* as number \d"):
        planned.run(photographs=wrong, setup=setup)
    some = replace(setup, lamps=(1, 3, 4, 5))  # one was left out: the others keep their numbers
    assert len(planned.run(photographs=[shots[k - 1] for k in some.lamps], setup=some).shots) == 4
    small = planned.arguments["sample"].region_m * 0.5 + 0.03
    with pytest.raises(InputError, match=r"a region of 50 x 40 mm; a plan for another sample"):
        planned.run(sample=SampleSpec("plane", region_m=small))
    content = json.loads(planned.path.read_text())
    content |= {"shape": "cylinder", "piece": "a strip bent round a rod of 20 mm radius"}
    planned.path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"\(it is bent, not a plane\): expected shape cylinder"):
        planned.run()
    content |= {"shape": "plane", "photographs": content["photographs"][:5]}
    planned.path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="expected a plan of 12 photographs or more, got one of 5"):
        planned.run()


def _twice(found: Any) -> int:
    """Cells at incidence 0 that hold the samples of another, turned."""
    a, r, t = found.grid.nodes_deg().T
    again = (a == 0) & ((r < 0) | ((r == 0) & (t < 0)))
    return int((found.measurement.valid & again).sum())
