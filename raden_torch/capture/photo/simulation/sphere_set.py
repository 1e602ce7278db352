"""A spherical specimen under lamps all around it: nearly all of the grid from one place."""

from __future__ import annotations

from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.mitsuba_scene import (
    Ball,
    Lamp,
    PrintedBoard,
    Sheet,
    chart_picture,
    matt,
    printed,
    rod,
    sheet,
    sphere,
)
from raden_torch.capture.photo.simulation.photo_plan import (
    CHROME_BALL,
    FACING,
    FAR_MM,
    GREY_BALL,
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
from raden_torch.capture.photo.simulation.simulated_camera import Camera

_PHASES_DEG = (4.0, 132.0)
"""Angles between lamp and camera; beyond, less than a tenth of the matt ball is in light."""


def sphere_plan(
    mi: Any,
    camera: Camera,
    *,
    lamps: int,
    near: bool,
    seed: int,
) -> PhotoPlan:
    """A sphere of 30 mm before a camera that stands still, lamps all around it.

    The angle between lamp and camera grows evenly from 4 to 132 degrees, so that each photograph
    shows another band of incidence + receiving. Beside it a white tile, a matt ball, chrome balls
    (two under near lamps), a chart and a board, all on a dark table.
    """
    rng = np.random.default_rng([seed, 1])
    ball = Ball((4.0, 4.0, -700.0), 30.0)
    board = PrintedBoard()
    board_place = Sheet(np.array([-122.0, -2.0, -800.0]), RIGHT, -UP, *board.size_mm)
    white = Sheet(np.array([-100.0, 44.0, -790.0]), RIGHT, -UP, 40.0, 36.0)
    chart = Sheet(np.array([46.0, 58.0, -790.0]), RIGHT, -UP, 77.0, 55.0)
    balls = {CHROME_BALL: Ball((90.0, -46.0, -668.0), 16.0)}
    if near:
        balls[SECOND_BALL] = Ball((-34.0, -46.0, -668.0), 16.0)
    stand = matt(0.02)
    things = {
        "table": sheet(
            mi,
            Sheet(np.array([-400.0, -62.0, -1000.0]), RIGHT, np.array([0, 0, 1.0]), 800.0, 700.0),
            matt(0.05),
        ),
        "board": sheet(mi, board_place, printed(mi, board.picture())),
        "chart": sheet(mi, chart, printed(mi, chart_picture())),
        "chart_stand": rod(np.array([84, 3, -795.0]), np.array([84, -62, -795.0]), 3.0, stand),
        "white_stand": rod(np.array([-80, 8, -810.0]), np.array([-80, -62, -810.0]), 3.0, stand),
        "stand": rod(np.array([4, -20, -700.0]), np.array([4, -62, -700.0]), 3.0, stand),
        WHITE: sheet(mi, white, matt(0.9)),
        GREY_BALL: sphere(Ball((50.0, -46.0, -690.0), 16.0), matt(0.6)),
        SPECIMEN: sphere(ball, matt(1.0)),
    }
    phases = np.linspace(*_PHASES_DEG, lamps)
    places = _lamps_around(np.array(ball.centre_mm), phases, near, rng)
    return PhotoPlan(
        shape="sphere",
        things=things,
        balls=balls,
        camera=camera,
        views=[FACING],
        lamps=places,
        shots=[Shot(f"lamp_{k + 1:02d}", 0, k) for k in range(lamps)],
        chart_lamp=places[int(np.argmin(abs(phases - 25)))],
        boards=board_poses(board, rng),
        board=board,
        board_place=board_place,
        specimen={"radius_mm": ball.radius_mm},
        middle_mm=ball.centre_mm,
        white={},
        masks=(SPECIMEN, WHITE, GREY_BALL, *balls),
    )


def _lamps_around(at: Floats, phases: Floats, near: bool, rng: np.random.Generator) -> list[Lamp]:
    """Lamps above the table. Their azimuth swings, wide where they stand before the sample, so
    that they do not lie in one plane; those behind it stay overhead, clear of the other things."""
    lamps = []
    for k, phase in enumerate(phases):
        swing = 60.0 if phase < 80 else 12.0
        azimuth = np.radians(90 + swing * (1, -1, 0)[k % 3] + rng.uniform(-3, 3))
        polar = np.radians(phase)
        way = np.array(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
        )
        # farther than the camera, so that none is in the picture
        distance = rng.uniform(750, 900) if near else FAR_MM
        lamps.append(lamp_at(at + distance * way, distance, rng.uniform(0.8, 1.2)))
    return lamps
