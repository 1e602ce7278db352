"""A flat specimen on a board, photographed by a plan: each photograph has its own camera and lamp.

The plan's file is read here by a schema of the simulation's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.mitsuba_scene import PrintedBoard
from raden_torch.capture.photo.simulation.photo_plan import (
    WHITE,
    PhotoPlan,
    Shot,
    board_poses,
    camera_of,
    lamp_at,
)
from raden_torch.capture.photo.simulation.plane_set import (
    CAMERA_MM,
    corners_m,
    looking,
    lying_things,
)
from raden_torch.capture.photo.simulation.renderer import SPECIMEN
from raden_torch.capture.photo.simulation.simulated_camera import View
from raden_torch.errors import InputError
from raden_torch.schema import Positive, Triple, checked, read_document

_BOARD = PrintedBoard(11, 9, square_mm=16.0, marker_mm=12.0)
_MIDDLE_MM = (80.0, 72.0)
"""Of the specimen on the board, from its upper left corner."""
_LARGEST_MM = (66.0, 50.0)
"""Around it enough of the board is left to be found."""
_WHITE_MM = (128.0, 64.0, 16.0, 16.0)
_FILLED = 0.75
"""Of the picture's width, by the board."""
_FROM_ABOVE = np.array([0.1, -0.12, 1.0])


class _Photograph(Struct):
    lamp_mm: Triple
    camera_mm: Triple


class _Plan(Struct):
    kind: str
    shape: str
    size_mm: tuple[Positive, Positive]
    tilts_deg: tuple[float, ...]
    piece: str
    photographs: tuple[_Photograph, ...]


def read_planned(path: Path) -> _Plan:
    """A plan of `raden capture guide`.

    Raises:
        InputError: not such a file; a piece that is not flat, lies on wedges, or does not fit on
            the board.
    """
    what = "a plan of `raden capture guide`"
    found = read_document(path, what)
    if not isinstance(found, dict) or found.get("kind") != "plan":
        raise InputError(f"{path}: expected {what}, got another file")
    plan = checked(found, _Plan, str(path))
    if plan.shape != "plane" or any(plan.tilts_deg):
        raise InputError(
            f"{path}: expected a plan for one flat piece that lies on its board, which is what can "
            f"be simulated, got {plan.piece}"
        )
    if any(size > most for size, most in zip(plan.size_mm, _LARGEST_MM, strict=True)):
        largest = " x ".join(f"{most:g}" for most in _LARGEST_MM)
        raise InputError(
            f"{path}: expected a piece of at most {largest} mm, so that the board around it is "
            f"found, got {plan.piece}"
        )
    if not plan.photographs:
        raise InputError(f"{path}: expected photographs, got none")
    return plan


def planned_set(mi: Any, path: Path, *, width: int, bits: int, seed: int) -> PhotoPlan:
    """The photographs of a plan: camera and lamps stand where it says around the specimen's middle.

    The lamps are photographed once more each, from above, with chrome balls beside the board, which
    are not there in the photographs of the specimen: they would throw shadows on it. The lens is
    such that the board fills the picture.
    """
    plan = read_planned(path)
    rng = np.random.default_rng([seed, 1])
    board = _BOARD
    across, down = plan.size_mm
    place = _MIDDLE_MM[0] - across / 2, _MIDDLE_MM[1] - down / 2, across, down
    middle = np.array([_MIDDLE_MM[0], -_MIDDLE_MM[1], 0.0])
    lying, things, balls = lying_things(mi, board, place, _WHITE_MM)
    farthest = max(float(np.linalg.norm(p.camera_mm)) for p in plan.photographs)
    focal = _FILLED * farthest / board.size_mm[0]
    lamps = []
    for photograph in plan.photographs:
        reach = float(np.linalg.norm(photograph.lamp_mm))
        lamps.append(lamp_at(middle + np.array(photograph.lamp_mm), reach, rng.uniform(0.8, 1.2)))
    way = _FROM_ABOVE / np.linalg.norm(_FROM_ABOVE)
    return PhotoPlan(
        shape="plane",
        things=things,
        balls=balls,
        camera=camera_of(width, bits, focal=focal),
        views=[_view(np.array(p.camera_mm), middle) for p in plan.photographs],
        lamps=lamps,
        shots=[Shot(f"view_{k + 1:03d}", k, k) for k in range(len(lamps))],
        chart_lamp=lamp_at(middle + 1000 * np.array([0.0, np.sin(0.4), np.cos(0.4)]), 1000.0, 1.0),
        boards=board_poses(board, rng, focal=focal),
        board=board,
        board_place=lying,
        specimen={"region_m": corners_m(place)},
        middle_mm=(float(middle[0]), float(middle[1]), 0.0),
        white={"region_m": corners_m(_WHITE_MM)},
        masks=(SPECIMEN, WHITE, *balls),
        reference=looking(
            way, at=middle + np.array([20.0, 0, 0]), distance_mm=1.2 * CAMERA_MM * focal / 3
        ),
    )


def _view(camera_mm: Floats, middle: Floats) -> View:
    distance = float(np.linalg.norm(camera_mm))
    return looking(camera_mm / distance, at=middle, distance_mm=distance)


def things_beside(things: dict[str, Any]) -> dict[str, Any]:
    """What lies there while the specimen is photographed: no chart."""
    return {name: thing for name, thing in things.items() if name != "chart"}
