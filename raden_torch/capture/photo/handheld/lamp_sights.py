"""Where pictures show the lamp: its image in a chrome ball or a flat mirror, and the light on the
white squares of the board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats, Floats32
from raden_torch.capture.photo.board import Board
from raden_torch.capture.photo.brdf.board_region import board_pixels
from raden_torch.capture.photo.brdf.pixel_regions import polygon_pixels
from raden_torch.capture.photo.brdf.rays import board_to_scene, projected
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.errors import InputError

CLIPPED = 250
"""Stored value from which a pixel of 8 bits counts as clipped."""
_AROUND = 1.3
"""Of a ball's outline: its place may be off by so much."""
_TURN = np.linspace(0, 2 * np.pi, 48, endpoint=False)
_PEAK = 0.8
_BRIGHT = 0.4
"""Of full scale: a lamp's image is clipped, or nearly."""
_STANDS_OUT = 1.6
"""How many times brighter than what lies around it the lamp's image has to be, in linear light."""
_LARGEST = 0.06
"""Of the region's area."""
_RIVAL = 0.6
_AROUND_PX, _FOOT = 4, 0.3


@dataclass(frozen=True)
class ChromeBall:
    """A chrome ball that lies on the board.

    Attributes:
        x_m, y_m: where it touches the board, metres; a few millimetres off are found.
        radius_m: metres, above 0.
    """

    x_m: float
    y_m: float
    radius_m: float

    def __post_init__(self) -> None:
        if not 0 < self.radius_m < np.inf:
            raise InputError(f"ball: radius: expected above 0, got {1000 * self.radius_m:g} mm")

    @property
    def centre_m(self) -> Floats:
        """`[3]` on the board, whose z goes into it."""
        return np.array([self.x_m, self.y_m, -self.radius_m])


@dataclass(frozen=True, eq=False)
class FlatMirror:
    """A flat shiny tile on the board: black glass, a lens filter, polished lacquer.

    Attributes:
        corners_m: `[n, 2]` on the board, n ≥ 3, metres.
        height_m: of its upper face over the board.
    """

    corners_m: Floats
    height_m: float = 0.0

    @property
    def raised_m(self) -> Floats:
        """`[n, 3]` corners and their heights."""
        return np.c_[self.corners_m, np.full(len(self.corners_m), self.height_m)]


@dataclass(frozen=True)
class Shadow:
    """A pin that stands upright on the board, and the tip of its shadow, as read off the board.

    Attributes:
        x_m, y_m: its foot on the board, metres.
        height_m: its tip over the board, above 0.
        tip_x_m, tip_y_m: the tip of its shadow.
    """

    x_m: float
    y_m: float
    height_m: float
    tip_x_m: float
    tip_y_m: float

    def __post_init__(self) -> None:
        if not 0 < self.height_m < np.inf:
            raise InputError(f"shadow: height: expected above 0, got {1000 * self.height_m:g} mm")


@dataclass(frozen=True, eq=False)
class Sights:
    """What one picture shows of its lamp.

    Attributes:
        balls: `[B, 2]` pixels of its image in each ball, NaN where it is not seen.
        mirrors: `[M, 2]` the same in each flat mirror.
        squares: `[S]` stored values 0…255 (green) of the board's white squares, NaN where it is
            not seen or clipped.
    """

    balls: Floats
    mirrors: Floats
    squares: Floats


def sights(
    stored: NDArray[np.uint8],
    table: Floats32,
    camera: Camera,
    pose: Pose,
    board: Board,
    balls: Sequence[ChromeBall],
    mirrors: Sequence[FlatMirror],
    covered: Bools,
) -> Sights:
    """Look for the lamp in one picture.

    Args:
        stored: `[H, W, 3]` the picture.
        table: `[256]` stored value → linear light, about.
        covered: `[S]` white squares on which something lies.
    """
    grey = table[stored].mean(axis=2)
    size = grey.shape[0], grey.shape[1]
    in_balls = [_in(grey, ball_pixels(ball, camera, pose, size)) for ball in balls]
    in_mirrors = [
        _in(grey, board_pixels(mirror.raised_m, camera, pose, size, "mirror")) for mirror in mirrors
    ]
    squares = np.where((stored < CLIPPED).all(axis=2), stored[..., 1], np.nan)
    return Sights(
        np.reshape(in_balls, (-1, 2)),
        np.reshape(in_mirrors, (-1, 2)),
        np.where(covered, np.nan, _white_squares(squares, camera, pose, board)),
    )


def ball_pixels(ball: ChromeBall, camera: Camera, pose: Pose, size: tuple[int, int]) -> Bools:
    """`[H, W]`: about where the ball is seen."""
    centre = board_to_scene(pose, ball.centre_m)
    way = centre / np.linalg.norm(centre)
    right = np.cross(way, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, way)
    reach = 1000 * ball.radius_m * _AROUND
    ring = centre + reach * (np.cos(_TURN)[:, None] * right + np.sin(_TURN)[:, None] * up)
    return polygon_pixels(projected(camera, ring), size)


def white_squares_m(board: Board) -> Floats:
    """`[S, 12, 2]`: points in the white margins around the board's markers, a row a white square.

    Which squares are white follows from where the markers are.
    """
    quads = np.array([np.asarray(points)[:, :2] for points in board.opencv().getObjPoints()])
    middle = quads.mean(axis=1, keepdims=True)
    margin = (board.square_m + board.marker_m) / (2 * board.marker_m)
    corners = middle + margin * (quads - middle)
    following = np.roll(corners, -1, axis=1)
    along = np.array([0.25, 0.5, 0.75])[:, None, None]
    return np.asarray(
        (corners + along[:, :, None] * (following - corners))
        .transpose(1, 0, 2, 3)
        .reshape(len(quads), -1, 2)
    )


def _white_squares(values: Floats, camera: Camera, pose: Pose, board: Board) -> Floats:
    """`[S]` the median of each square's points; NaN where fewer than half are seen."""
    import cv2

    points = white_squares_m(board)
    flat = points.reshape(-1, 2)
    scene = board_to_scene(pose, np.c_[flat, np.zeros(len(flat))])
    u, v = projected(camera, scene).astype(np.float32).T
    found = cv2.remap(
        values.astype(np.float32), u[None], v[None], cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
    )[0].reshape(points.shape[:2])  # fmt: skip
    enough = np.isfinite(found).sum(axis=1) * 2 >= found.shape[1]
    result = np.full(len(found), np.nan)
    if enough.any():
        result[enough] = np.nanmedian(found[enough], axis=1)
    return result


def _in(grey: NDArray[np.float32], region: Bools) -> Floats:
    """`[2]` the pixel of the one bright spot in a region that stands out; NaN where there is none,
    or several, or it is cut by the region's edge.

    Its weights are what exceeds a third of the way from its surroundings to its peak; a lamp's
    image is clipped, on all sides alike.
    """
    import cv2

    nothing = np.full(2, np.nan)
    ys, xs = np.nonzero(region)
    if len(xs) < 50:
        return nothing
    top, left = ys.min(), xs.min()
    window = np.s_[top : ys.max() + 1, left : xs.max() + 1]
    part, inside = grey[window], region[window]
    peak = float(part[inside].max())
    if peak < _BRIGHT:
        return nothing
    bright = ((part >= _PEAK * peak) & inside).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    best: list[tuple[float, Floats]] = []
    core = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    for label in range(1, min(count, 200)):
        spot = labels == label
        if stats[label, cv2.CC_STAT_AREA] > _LARGEST * len(xs) or (spot & ~core).any():
            continue
        size = 2 * _AROUND_PX + 1
        near = cv2.dilate(spot.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
        ring = near & ~(cv2.dilate(spot.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0) & inside
        if not ring.any():
            continue
        ground = float(np.median(part[ring]))
        if peak < _STANDS_OUT * ground:
            continue
        foot = ground + _FOOT * (peak - ground)
        weight = np.where(near & inside, np.clip(part - foot, 0, None), 0.0)
        y, x = np.nonzero(weight)
        w = weight[y, x]
        best.append((float(w.sum()), np.array([(w * x).sum(), (w * y).sum()]) / w.sum()))
    best.sort(key=lambda each: -each[0])
    if not best or (len(best) > 1 and best[1][0] > _RIVAL * best[0][0]):
        return nothing
    return np.asarray(best[0][1] + [left, top])
