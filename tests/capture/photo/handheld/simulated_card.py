"""What the simulated photographs by a phone in the hand show: a flat piece, a white field and what
else is wanted on a printed ChArUco card, and one small lamp. Board frame: `simulated_phone`'s."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from tests.capture.photo.brdf.conftest import shell
from tests.capture.photo.handheld.simulated_phone import Frame

Array = np.ndarray
GREYS = (0.90, 0.59, 0.36, 0.20, 0.09, 0.03)
PAPER, INK, TABLE, WHITE = 0.85, 0.05, 0.03, 0.9
GLASS_BODY = 0.01  # black glass reflects so much besides the mirror image
TEXELS = 160  # of a square's side


def rectangle(left: float, top: float, right: float, bottom: float) -> Array:
    """`[4, 2]` corners, metres."""
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


@dataclass(frozen=True)
class Card:
    """A printed ChArUco board with a paper margin around it."""

    columns: int = 11
    rows: int = 9
    square_m: float = 0.016
    marker_m: float = 0.012
    dictionary: str = "DICT_6X6_250"
    margin_m: float = 0.008

    def board(self) -> cv2.aruco.CharucoBoard:
        kind = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = self.columns, self.rows
        return cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, kind)

    @property
    def size_m(self) -> tuple[float, float]:
        return self.columns * self.square_m, self.rows * self.square_m


@dataclass(frozen=True, eq=False)
class Scene:
    """What lies on the card: convex `[4, 2]` corners in metres of the piece (`brdf` of normal,
    light and view `[P, 3]` → f_r `[P, 3]`), the white field, a row of six greys along the first
    edge, and black glass; balls of chrome (x, y, radius) that rest on the card. One lamp: `lamp_m`
    `[3]` in the board frame (z < 0), or `flash_m` `[3]` in the camera frame."""

    lamp_m: Array | None = None
    flash_m: Array | None = None
    card: Card = Card()
    piece_m: Array = field(default_factory=lambda: rectangle(0.054, 0.05, 0.11, 0.092))
    white_m: Array = field(default_factory=lambda: rectangle(0.118, 0.05, 0.142, 0.092))
    grey_m: Array | None = None
    mirror_m: Array | None = None
    balls_m: tuple[tuple[float, float, float], ...] = ()
    lamp_radius_m: float = 0.004
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    brdf: Callable[[Array, Array, Array], Array] = shell

    def __post_init__(self) -> None:
        if (self.lamp_m is None) == (self.flash_m is None):
            raise ValueError("lamp: expected one of lamp_m and flash_m")

    @cached_property
    def texture(self) -> tuple[list[Array], Array, float]:
        """Pictures `[h, w, 3]` of the plane (matt reflectance, cover by the piece, by the glass),
        each of half the size of that before; the first's upper left corner; its texel in metres."""
        step = self.card.square_m / TEXELS
        size = np.array(self.card.size_m)
        given = (self.piece_m, self.white_m, self.grey_m, self.mirror_m)
        ends = np.concatenate([[-size * 0 - self.card.margin_m, size + self.card.margin_m]]
                              + [g for g in given if g is not None])  # fmt: skip
        # whole texels from the pattern's corner; 16 of table around, for the smaller pictures
        low = np.floor(ends.min(0) / step) - 16
        wide, high = (np.ceil(ends.max(0) / step) + 16 - low).astype(int) // 16 * 16 + 16
        plane = np.zeros((high, wide, 3), np.float32)

        def lay(corners: Array, value: tuple[float, float, float]) -> None:
            texels = corners / step - low
            start = np.floor(texels.min(0)).astype(int) - 1
            stop = np.ceil(texels.max(0)).astype(int) + 1
            part = plane[start[1] : stop[1], start[0] : stop[0]]
            cover = inside(texels - start, part.shape[:2])[..., None]
            part += cover * (np.array(value, np.float32) - part)

        plane[..., 0] = TABLE
        margin = self.card.margin_m
        lay(rectangle(-margin, -margin, *(size + margin)), (PAPER, 0, 0))
        pattern = self.card.board().generateImage(
            (self.card.columns * TEXELS, self.card.rows * TEXELS), marginSize=0
        )
        left, top = (-low).astype(int)
        rows, columns = pattern.shape
        plane[top : top + rows, left : left + columns, 0] = np.where(pattern > 127, PAPER, INK)
        lay(self.white_m, (WHITE, 0, 0))
        if self.grey_m is not None:
            lay(self.grey_m, (INK, 0, 0))
            for grey, corners in zip(GREYS, patches(self.grey_m), strict=True):
                lay(corners, (grey, 0, 0))
        lay(self.piece_m, (0, 1, 0))
        if self.mirror_m is not None:
            lay(self.mirror_m, (GLASS_BODY, 0, 1))
        levels = [plane]
        for _ in range(3):
            half = levels[-1].shape[1] // 2, levels[-1].shape[0] // 2
            levels.append(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA))
        return levels, low * step, step


def patches(grey_m: Array) -> Array:
    """`[6, 4, 2]` corners of the grey row's patches, in metres."""
    across, down = grey_m[1] - grey_m[0], grey_m[3] - grey_m[0]
    at = [rectangle((k + 0.08) / 6, 0.08, (k + 0.92) / 6, 0.92) for k in range(6)]
    return grey_m[0] + np.array(at) @ np.stack([across, down])


def inside(corners: Array, shape: tuple[int, int]) -> Array:
    """`[h, w]` 0..1 of each texel that the convex polygon covers; corners in texels."""
    y = np.arange(shape[0], dtype=np.float32)[:, None] + 0.5
    x = np.arange(shape[1], dtype=np.float32) + 0.5
    reach = np.full(shape, np.inf, np.float32)
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[1]
    turn = np.sign(ax * by - ay * bx)
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        ex, ey = (turn * (b - a) / np.linalg.norm(b - a)).astype(np.float32)
        np.minimum(reach, ex * (y - np.float32(a[1])) - ey * (x - np.float32(a[0])), out=reach)
    return np.clip(reach + 0.5, 0, 1)


def lamp_on_board(scene: Scene, frame: Frame) -> Array:
    """`[3]` the lamp in the board frame, metres."""
    if scene.lamp_m is not None:
        return np.asarray(scene.lamp_m, float)
    return frame.rotation.T @ (scene.flash_m - frame.shift_m)


def lamp_in_camera(scene: Scene, frame: Frame) -> Array:
    """`[3]` the lamp in the camera frame, metres."""
    return frame.rotation @ lamp_on_board(scene, frame) + frame.shift_m


def irradiance(scene: Scene, lamp: Array, x: Array, y: Array, pixel_m: float) -> Array:
    """Of the plane's points, with the balls' shadows, whose edges a pixel of `pixel_m` smooths."""
    toward = [np.float32(lamp[0]) - x, np.float32(lamp[1]) - y, np.float32(lamp[2])]
    square = toward[0] ** 2 + toward[1] ** 2 + toward[2] ** 2
    length = np.sqrt(square)
    light = max(-lamp[2], 0) / (square * length)
    for bx, by, r in scene.balls_m:
        # the shadow's tip is no farther than this from where the ball touches the card
        tip = 4 * r + 3 * r * np.hypot(lamp[0] - bx, lamp[1] - by) / max(-lamp[2] - 3 * r, 1e-3)
        near = (np.abs(x - np.float32(bx)) < tip) & (np.abs(y - np.float32(by)) < tip)
        ball = [np.float32(bx) - x[near], np.float32(by) - y[near], np.float32(-r)]
        to, far = [toward[0][near], toward[1][near], toward[2]], length[near]
        along = sum(a * b for a, b in zip(ball, to, strict=True)) / far
        miss = np.sqrt(np.maximum(sum(b**2 for b in ball) - along**2, 0))
        soft = np.maximum(scene.lamp_radius_m * along / np.maximum(far - along, 1e-6), 0)
        soft = np.maximum(soft, 0.5 * pixel_m)
        seen = np.clip((miss - r) / (2 * soft) + 0.5, 0, 1)
        light[near] *= np.where((along > 0) & (along < far), seen, 1)
    return light
