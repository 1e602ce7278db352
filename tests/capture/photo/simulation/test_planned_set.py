"""A plan of the guide is photographed where it says; what cannot be is refused in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from raden_torch.capture.photo.guide.piece import Piece
from raden_torch.capture.photo.guide.plan import Plan, plan_photographs
from raden_torch.capture.photo.guide.plan_file import write_plan
from raden_torch.capture.photo.guide.set_up import SetUp
from raden_torch.capture.photo.simulation.planned_set import planned_set, read_planned
from raden_torch.capture.photo.simulation.simulate import Options
from raden_torch.errors import InputError

mi = pytest.importorskip("mitsuba")


def planned(folder: Path, piece: Piece, kind: str = "hand") -> tuple[Plan, Path]:
    plan = plan_photographs(piece, SetUp(kind), 3, assume="isotropic+reciprocal")
    write_plan(plan, folder / "plan.json")
    return plan, folder / "plan.json"


def test_camera_and_lamps_stand_where_the_plan_says(tmp_path: Path) -> None:
    """Seen from the specimen's middle, on the board's axes; the specimen in every picture's middle
    and no larger than the plan's piece."""
    mi.set_variant("scalar_rgb")
    plan, path = planned(tmp_path, Piece.flat(60, 48))
    made = planned_set(mi, path, width=480, bits=14, seed=0)
    middle = np.array(made.middle_mm)
    for stance, view, lamp in zip(plan.stances, made.views, made.lamps, strict=True):
        np.testing.assert_allclose(view.position_mm - middle, stance.camera_mm, atol=1e-6)
        np.testing.assert_allclose(lamp.position_mm - middle, stance.lamp_mm, atol=1e-6)
        seen = made.camera.project(view.of_points(middle[None]))[0]
        centre = np.array(made.camera.size[::-1]) / 2
        assert np.linalg.norm(seen - centre) < 0.03 * made.camera.size[1]
    corners = 1000 * np.array(made.specimen["region_m"])
    np.testing.assert_allclose(np.ptp(corners, axis=0), [56, 44], atol=1e-9)  # 2 mm inside
    np.testing.assert_allclose(corners.mean(axis=0) * [1, -1], middle[:2])
    assert [shot.name for shot in made.shots] == ["view_001", "view_002", "view_003"]


def test_what_cannot_be_photographed_is_refused(tmp_path: Path) -> None:
    _, path = planned(tmp_path, Piece.flat(100, 80))
    with pytest.raises(InputError, match="expected a piece of at most 66 x 50 mm"):
        read_planned(path)
    _, path = planned(tmp_path, Piece.rod(60, 20), "still")
    with pytest.raises(InputError, match="expected a plan for one flat piece that lies on its boa"):
        read_planned(path)
    with pytest.raises(InputError, match=r"plan.json: expected shape plane, .* got sphere"):
        Options(plan=path)
    path.write_text(json.dumps({"kind": "lights"}))
    with pytest.raises(InputError, match="expected a plan of `raden capture guide`, got another"):
        read_planned(path)
