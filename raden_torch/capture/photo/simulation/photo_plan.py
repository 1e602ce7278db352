"""A set of photographs before it is taken; what the sets have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.mitsuba_scene import Ball, Lamp, PrintedBoard, Sheet
from raden_torch.capture.photo.simulation.simulated_camera import Camera, View

WHITE, GREY_BALL, CHROME_BALL, SECOND_BALL = "white", "grey_ball", "chrome_ball", "chrome_ball_2"
FACING = View(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""The camera at 0, the world being x right, y up, z to the viewer."""
PLAN_NAME = "plan.json"
"""What a plan of `raden capture guide` is called beside its photographs."""
RIGHT, UP = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
FAR_MM = 200_000.0


@dataclass(frozen=True)
class Shot:
    """A photograph: its name without suffix, and the numbers of its view and lamp, from 0."""

    name: str
    view: int
    lamp: int


@dataclass(frozen=True, eq=False)
class PhotoPlan:
    """A set of photographs, before it is taken.

    Attributes:
        shape: of the specimen, "sphere" or "plane".
        things, balls: of the scene (`renderer.Studio`).
        camera: the camera.
        views, lamps: where the camera and the lamps stand.
        shots: the photographs, those of one view after another.
        chart_lamp: the lamp for the photograph of the chart.
        boards: poses of the board alone before the camera, for its calibration.
        board, board_place: what is printed on the board of the scene, and where it lies.
        specimen: what a person would know of it: radius, or region on the board in metres.
        middle_mm: of the specimen, in the world.
        white: what a person would know of the white tile.
        white_factor, grey_ball: reflectance factor of the white tile, reflectance of the matt ball.
        masks: the things that get one.
        reference: from where lamps, chart and masks are photographed, of photographs by a plan of
            `raden capture guide`; None: from the first view.
    """

    shape: str
    things: dict[str, Any]
    balls: dict[str, Ball]
    camera: Camera
    views: list[View]
    lamps: list[Lamp]
    shots: list[Shot]
    chart_lamp: Lamp
    boards: list[Sheet]
    board: PrintedBoard
    board_place: Sheet
    specimen: dict[str, Any]
    middle_mm: tuple[float, float, float]
    white: dict[str, Any]
    masks: tuple[str, ...]
    white_factor: float = 90.0
    grey_ball: float = 0.6
    reference: View | None = None


def camera_of(width: int, bits: int = 14, *, focal: float = 3.0) -> Camera:
    """A lens with barrel distortion, a little off the middle of its 3 : 2 pictures; its focal
    length over their width."""
    height = round(width * 2 / 3)
    focal *= width
    matrix = np.array([[focal, 0, 0.508 * width], [0, 1.002 * focal, 0.493 * height], [0, 0, 1.0]])
    return Camera(matrix, np.array([-0.28, 0.35, 0.0006, -0.0004, 0.0]), (height, width), bits=bits)


def lamp_at(place: Floats, distance_mm: float, strength: float) -> Lamp:
    """A lamp of irradiance π · strength at a distance, one degree in radius seen from there."""
    intensity = float(np.pi * strength * distance_mm**2)
    x, y, z = (float(v) for v in place)
    return Lamp((x, y, z), (intensity,) * 3, distance_mm * float(np.tan(np.radians(1.0))))


def board_poses(
    board: PrintedBoard, rng: np.random.Generator, count: int = 12, *, focal: float = 3.0
) -> list[Sheet]:
    """The board filling the picture, leaning by up to 40 degrees in turn to all sides."""
    poses = []
    width, height = board.size_mm
    for k in range(count):
        lean, way = np.radians(40 * (k % 4 != 0) * rng.uniform(0.75, 1)), 2 * np.pi * k / count
        axis = np.array([np.cos(way), np.sin(way), 0])
        turn = np.radians(rng.uniform(-12, 12))
        right, down = (
            _turned(_turned(edge, np.array([0, 0, 1.0]), turn), axis, lean) for edge in (RIGHT, -UP)
        )
        middle = np.array(
            [rng.uniform(-9, 9), rng.uniform(-6, 6), -width * rng.uniform(3.7, 4.4) * focal / 3]
        )
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
