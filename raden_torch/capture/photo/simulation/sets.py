"""What is photographed in which order: a specimen as a sphere, or flat on a board."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from raden_torch.capture.photo.simulation.angles import Floats
from raden_torch.capture.photo.simulation.camera import Camera, View
from raden_torch.capture.photo.simulation.renderer import SPECIMEN
from raden_torch.capture.photo.simulation.scene import (
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

WHITE, GREY_BALL, CHROME_BALL, SECOND_BALL = "white", "grey_ball", "chrome_ball", "chrome_ball_2"
_FACING = View(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""The camera at 0, the world being x right, y up, z to the viewer."""
_RIGHT, _DOWN = np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
_FAR_MM = 200_000.0
_PHASES_DEG = (4.0, 132.0)
"""Angles between lamp and camera; beyond, less than a tenth of the matt ball is in light."""


@dataclass(frozen=True, eq=False)
class PhotoPlan:
    """A set of photographs, before it is taken.

    Attributes:
        shape: of the specimen, "sphere" or "plane".
        things, balls: of the scene (`renderer.Studio`).
        camera: the camera.
        views, lamps: photograph k is taken from `views[k]` under `lamps[k]`.
        chart_lamp: the lamp for the photograph of the chart.
        boards: poses of the board before the camera, for its calibration.
        board: what is printed on it; `board_place` where it stands in the scene.
        white_factor: of the white tile, 0…100.
        grey_ball: reflectance of the matt ball.
    """

    shape: str
    things: dict[str, Any]
    balls: dict[str, Ball]
    camera: Camera
    views: list[View]
    lamps: list[Lamp]
    chart_lamp: Lamp
    boards: list[Sheet]
    board: PrintedBoard
    board_place: Sheet
    specimen: dict[str, Any]
    white_place: Sheet
    white_factor: float = 90.0
    grey_ball: float = 0.6
    masks: tuple[str, ...] = field(default=(SPECIMEN, WHITE, GREY_BALL, CHROME_BALL))


def plan_of(
    mi: Any, shape: str, *, lamps: int, near: bool, width: int, bits: int, seed: int
) -> PhotoPlan:
    """The plan for a shape."""
    return sphere_plan(mi, lamps=lamps, near=near, width=width, bits=bits, seed=seed)


def camera_of(width: int, bits: int = 14) -> Camera:
    """A long lens with barrel distortion, a little off the middle of `width` x 2/3 `width` pixels."""
    height = round(width * 2 / 3)
    focal = 3.0 * width
    matrix = np.array([[focal, 0, 0.508 * width], [0, 1.002 * focal, 0.493 * height], [0, 0, 1.0]])
    return Camera(matrix, np.array([-0.28, 0.35, 0.0006, -0.0004, 0.0]), (height, width), bits=bits)


def sphere_plan(
    mi: Any,
    *,
    lamps: int = 29,
    near: bool = False,
    width: int = 1200,
    bits: int = 14,
    seed: int = 0,
) -> PhotoPlan:
    """A sphere of 30 mm before a camera that stands still, lamps all around it.

    The angle between lamp and camera grows evenly from 4 to 132 degrees, so that each photograph
    shows another band of incidence + receiving. Beside it a white tile, a matt ball, chrome balls
    (two under near lamps), a chart and a board, all on a dark table.
    """
    rng = np.random.default_rng([seed, 1])
    ball = Ball((4.0, 4.0, -700.0), 30.0)
    board = PrintedBoard()
    board_place = Sheet(np.array([-122.0, -2.0, -800.0]), _RIGHT, _DOWN, *board.size_mm)
    white = Sheet(np.array([-100.0, 44.0, -790.0]), _RIGHT, _DOWN, 40.0, 36.0)
    chart = Sheet(np.array([46.0, 58.0, -790.0]), _RIGHT, _DOWN, 77.0, 55.0)
    balls = {CHROME_BALL: Ball((90.0, -46.0, -668.0), 16.0)}
    if near:
        balls[SECOND_BALL] = Ball((-34.0, -46.0, -668.0), 16.0)
    stand = matt(0.02)
    things = {
        "table": sheet(
            mi,
            Sheet(np.array([-400.0, -62.0, -1000.0]), _RIGHT, np.array([0, 0, 1.0]), 800.0, 700.0),
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
    around = _lamps_around(np.array(ball.centre_mm), lamps, near, rng)
    return PhotoPlan(
        "sphere",
        things,
        balls,
        camera_of(width, bits),
        [_FACING] * lamps,
        around,
        around[int(np.argmin([abs(phase - 25) for phase in np.linspace(*_PHASES_DEG, lamps)]))],
        _board_poses(board, rng),
        board,
        board_place,
        {"centre_mm": ball.centre_mm, "radius_mm": ball.radius_mm},
        white,
        masks=(SPECIMEN, WHITE, GREY_BALL, *balls),
    )


def _lamps_around(at: Floats, count: int, near: bool, rng: np.random.Generator) -> list[Lamp]:
    """Lamps above the table. Their azimuth swings, wide where they stand before the sample, so
    that they do not lie in one plane; those behind it stay overhead, clear of the other things."""
    lamps = []
    for k, phase in enumerate(np.linspace(*_PHASES_DEG, count)):
        swing = 60.0 if phase < 80 else 12.0
        azimuth = np.radians(90 + swing * (1, -1, 0)[k % 3] + rng.uniform(-3, 3))
        polar = np.radians(phase)
        way = np.array(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
        )
        distance = rng.uniform(550, 700) if near else _FAR_MM
        lamps.append(lamp_at(at + distance * way, distance, rng.uniform(0.8, 1.2)))
    return lamps


def lamp_at(place: Floats, distance_mm: float, strength: float) -> Lamp:
    """A lamp of irradiance π · strength at a distance, one degree in radius seen from there."""
    intensity = float(np.pi * strength * distance_mm**2)
    x, y, z = (float(v) for v in place)
    return Lamp((x, y, z), (intensity,) * 3, distance_mm * float(np.tan(np.radians(1.0))))


def _board_poses(board: PrintedBoard, rng: np.random.Generator, count: int = 12) -> list[Sheet]:
    """The board filling the picture, leaning by up to 40 degrees in turn to all sides."""
    poses = []
    for k in range(count):
        lean, way = np.radians(40 * (k % 4 != 0) * rng.uniform(0.75, 1)), 2 * np.pi * k / count
        axis = np.array([np.cos(way), np.sin(way), 0])
        turn = np.radians(rng.uniform(-12, 12))
        right, down = (
            _turned(_turned(edge, np.array([0, 0, 1.0]), turn), axis, lean)
            for edge in (_RIGHT, _DOWN)
        )
        width, height = board.size_mm
        middle = np.array([rng.uniform(-9, 9), rng.uniform(-6, 6), rng.uniform(-370, -310)])
        poses.append(Sheet(middle - right * width / 2 - down * height / 2, right, down,
                           width, height))  # fmt: skip
    return poses


def _turned(v: Floats, axis: Floats, angle: float) -> Floats:
    """Rodrigues' formula."""
    return np.asarray(
        v * np.cos(angle)
        + np.cross(axis, v) * np.sin(angle)
        + axis * (axis @ v) * (1 - np.cos(angle))
    )
