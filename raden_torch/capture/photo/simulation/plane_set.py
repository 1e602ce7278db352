"""A flat specimen on a board, seen from several sides under lamps that stay where they are."""

from __future__ import annotations

from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.mitsuba_scene import (
    Ball,
    PrintedBoard,
    Sheet,
    chart_picture,
    matt,
    printed,
    sheet,
)
from raden_torch.capture.photo.simulation.photo_plan import (
    CHROME_BALL,
    FAR_MM,
    RIGHT,
    SECOND_BALL,
    UP,
    WHITE,
    PhotoPlan,
    Shot,
    board_poses,
    lamp_at,
)
from raden_torch.capture.photo.simulation.renderer import SPECIMEN
from raden_torch.capture.photo.simulation.simulated_camera import Camera, View

_MIDDLE = np.array([88.0, -56.0, 0.0])
CAMERA_MM, _LAMP_MM = 950.0, 1150.0
"""Lamps stand behind the camera's distance, so that none is in the picture."""
_SPECIMEN_MM, _WHITE_MM = (48.0, 32.0, 32.0, 32.0), (112.0, 48.0, 16.0, 16.0)
"""x, y, width and height on the board."""
_BOARD = PrintedBoard(9, 7, square_mm=16.0, marker_mm=12.0)
_ABOVE_MM, _BALL_MM = 0.02, 20.0
_GOLDEN = np.pi * (3 - np.sqrt(5))


def plane_plan(
    mi: Any, camera: Camera, *, lamps: int, near: bool, views: int, seed: int
) -> PhotoPlan:
    """A flat specimen and a white tile on a board that lies on a table, two chrome balls and a
    chart beside it.

    The world is the board's upper left corner, x along its rows, y up its columns, z to the viewer.
    The first view is from nearly above and shows everything, the others lean to all sides.
    """
    rng = np.random.default_rng([seed, 1])
    board = _BOARD
    places = [
        lamp_at(_MIDDLE + reach * way, reach, rng.uniform(0.8, 1.2))
        for way in _ways(lamps, 8.0, 58.0, rng)
        for reach in [rng.uniform(0.9, 1.1) * _LAMP_MM if near else FAR_MM]
    ]
    lying, things, balls = lying_things(mi, board, _SPECIMEN_MM, _WHITE_MM)
    from_above = _MIDDLE + FAR_MM * np.array([0.0, np.sin(0.4), np.cos(0.4)])
    return PhotoPlan(
        shape="plane",
        things=things,
        balls=balls,
        camera=camera,
        views=[looking(way) for way in _ways(views, 12.0, 55.0, rng)],
        lamps=places,
        shots=[
            Shot(f"view_{v + 1}_lamp_{k + 1:02d}", v, k) for v in range(views) for k in range(lamps)
        ],
        chart_lamp=lamp_at(from_above, FAR_MM, 1.0),
        boards=board_poses(board, rng),
        board=board,
        board_place=lying,
        specimen={"region_m": corners_m(_SPECIMEN_MM)},
        middle_mm=(64.0, -48.0, 0.0),
        white={"region_m": corners_m(_WHITE_MM)},
        masks=(SPECIMEN, WHITE, *balls),
    )


def lying_things(
    mi: Any,
    board: PrintedBoard,
    specimen_mm: tuple[float, float, float, float],
    white_mm: tuple[float, float, float, float],
) -> tuple[Sheet, dict[str, Any], dict[str, Ball]]:
    """The board; what lies on the table: it with specimen and white tile (x, y, width, height on
    it), and the chart; and two chrome balls."""
    lying = Sheet(np.zeros(3), RIGHT, -UP, *board.size_mm)
    chart = Sheet(np.array([board.size_mm[0] + 10, -28.0, 0.0]), RIGHT, -UP, 77.0, 55.0)
    table = Sheet(np.array([-500.0, 500.0, -0.5]), RIGHT, -UP, 1200.0, 1000.0)
    chrome = {CHROME_BALL: (-34.0, -22.0, 20.0), SECOND_BALL: (-34.0, -90.0, 20.0)}
    things = {
        "table": sheet(mi, table, matt(0.05)),
        "board": sheet(mi, lying, printed(mi, board.picture())),
        "chart": sheet(mi, chart, printed(mi, chart_picture())),
        WHITE: sheet(mi, _on_board(white_mm), matt(0.9)),
        SPECIMEN: sheet(mi, _on_board(specimen_mm), matt(1.0)),
    }
    return lying, things, {name: Ball(at, _BALL_MM) for name, at in chrome.items()}


def _on_board(place: tuple[float, float, float, float]) -> Sheet:
    x, y, width, height = place
    return Sheet(np.array([x, -y, _ABOVE_MM]), RIGHT, -UP, width, height)


def corners_m(place: tuple[float, float, float, float]) -> list[list[float]]:
    """Two millimetres inside its edges."""
    x, y, width, height = place
    left, top, right, bottom = x + 2, y + 2, x + width - 2, y + height - 2
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    return [[round(a / 1000, 6), round(b / 1000, 6)] for a, b in corners]


def _ways(count: int, first: float, last: float, rng: np.random.Generator) -> list[Floats]:
    """Unit vectors up from the board, `first` to `last` degrees from its normal, turning by the
    golden angle."""
    turn = rng.uniform(0, 2 * np.pi)
    polar = np.radians(np.linspace(first, last, count))
    return [
        np.array([np.sin(p) * np.cos(t), np.sin(p) * np.sin(t), np.cos(p)])
        for k, p in enumerate(polar)
        for t in [turn + k * _GOLDEN]
    ]


def looking(way: Floats, at: Floats = _MIDDLE, distance_mm: float = CAMERA_MM) -> View:
    """From a direction at a point, the board's columns upright."""
    right = np.cross(-way, UP)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-way, right), -way])
    return View(rotation, -rotation @ (at + distance_mm * way))
