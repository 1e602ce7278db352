"""Where a lamp stands, from all that the pictures show of it at once.

Least squares over the lamp's place and the balls' on the board. A picture says: where the lamp's
image lies in a ball and in a flat mirror (pixels), and how the light falls off over the board's
white squares, cos θ / d² (its level is free in each picture, as is the lens's vignetting in all);
shadows say rays. Of a lamp beside the board they are in the board's frame, of one that is fixed to
the camera in the camera's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats, Floats32
from raden_torch.capture.photo.board import Board
from raden_torch.capture.photo.brdf.rays import Y_UP, board_to_scene, projected, undistorted
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.handheld.lamp_sights import (
    ChromeBall,
    FlatMirror,
    Shadow,
    Sights,
    white_squares_m,
)
from raden_torch.capture.photo.handheld.mirror_geometry import meeting_point, mirror_points, unit
from raden_torch.errors import InputError

_IMAGE_PX, _SHADOW_M, _SAID_M, _LEVEL = 0.3, 5e-4, 3e-3, 0.03
"""Standard deviations of what is fitted: a lamp's image; a shadow's tip; where a person says that a
ball touches, or that a flash is; light on a white square, relative, with stains and what the room
adds."""
_OUTLIER, _MOST_PX, _ROUNDS = 4.0, 1.5, 4
_TRIED, _SOLVED = 25, 60
"""Evaluations of a start, and of the best of them."""
_STARTS_M = (0.15, 0.3, 0.6, 1.2)
_WEAK_M = 1.0
_LOWEST_M, _GRAZING = 0.02, 0.02
"""A lamp stands higher over the board than this; below this cosine its light is as good as none."""


@dataclass(frozen=True, eq=False)
class FoundLamp:
    """A lamp.

    Attributes:
        at_m: `[3]` its place, in the board's frame or the camera's as OpenCV has them.
        std_m: `[3, 3]` covariance of that.
        std_deg: standard deviation of its direction from the piece, in each of two directions
            across, root mean square.
        balls_m: `[B, 2]` where the balls touch the board.
        images: how many images in balls and mirrors were used; `left_out`: of how many that did
            not fit.
        image_rms_px, level_rms: of the residuals of images, and of the light on white squares.
        vignetting: share of light lost in the picture's corners.
    """

    at_m: Floats
    std_m: Floats
    std_deg: float
    balls_m: Floats
    images: int
    left_out: int
    image_rms_px: float
    level_rms: float
    vignetting: float


@dataclass(frozen=True, eq=False)
class LampSetting:
    """What is known before the lamp is looked for.

    Attributes:
        camera, board: as calibrated.
        balls, mirrors, shadows: what shows the lamp.
        moves: whether it is fixed to the camera.
        middle_m: `[3]` of the piece on the board.
        said_m: `[3]` where a person says that it is, in the camera's frame; None: nobody does.
    """

    camera: Camera
    board: Board
    balls: tuple[ChromeBall, ...]
    mirrors: tuple[FlatMirror, ...]
    shadows: tuple[Shadow, ...]
    moves: bool
    middle_m: Floats
    said_m: Floats | None = None


def find_lamp(
    setting: LampSetting,
    poses: Sequence[Pose],
    seen: Sequence[Sights],
    table: Floats32,
    name: str,
) -> FoundLamp:
    """The lamp of pictures that were taken under one.

    Args:
        seen: of each picture.
        table: `[256]` stored value → linear light.
        name: of the clip, for messages.

    Raises:
        InputError: nothing shows it, or what does contradicts itself.
    """
    fit = _Fit(setting, poses, seen, table, name)
    if fit.image_count == 0 and not setting.shadows and setting.said_m is None:
        raise InputError(
            f"{name}: the lamp's image was found in no ball or mirror of {len(poses)} pictures: "
            "are their places on the board right? Expose so that the white is not clipped, and "
            "cover windows"
        )
    return fit.described(fit.solved())


class _Fit:
    """Residuals of all that is seen, for places of the lamp and the balls."""

    def __init__(
        self,
        setting: LampSetting,
        poses: Sequence[Pose],
        seen: Sequence[Sights],
        table: Floats32,
        name: str,
    ) -> None:
        self.name = name
        self.setting, self.poses = setting, list(poses)
        self.turn = np.array([pose.rotation for pose in poses])
        self.shift = np.array([pose.translation_m for pose in poses])
        self.eye = -np.einsum("kji,kj->ki", self.turn, self.shift)
        self.balls = np.array([s.balls for s in seen]).reshape(len(poses), -1, 2)
        self.mirrors = np.array([s.mirrors for s in seen]).reshape(len(poses), -1, 2)
        points = white_squares_m(setting.board).mean(axis=1)
        self.squares = np.c_[points, np.zeros(len(points))]
        level = np.interp(np.array([s.squares for s in seen]), np.arange(len(table)), table)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.level = np.where(level > 0, np.log(level), np.nan)
        self.corner2 = self._corner_distances()
        self.used_balls: Bools = np.isfinite(self.balls[..., 0])
        self.used_mirrors: Bools = np.isfinite(self.mirrors[..., 0])
        self.touch = np.array([[b.x_m, b.y_m] for b in setting.balls]).reshape(-1, 2)
        self.image_count = int(self.used_balls.sum() + self.used_mirrors.sum())

    def _corner_distances(self) -> Floats:
        """`[K, S]` squared distance of each square's pixel from the middle of the picture, its
        corner being 1."""
        camera = self.setting.camera
        middle = camera.matrix[:2, 2]
        corner = float(np.hypot(*camera.size) / 2)
        return np.array([
            (((projected(camera, board_to_scene(pose, self.squares)) - middle) / corner) ** 2)
            .sum(1)
            for pose in self.poses
        ])  # fmt: skip

    def starts(self) -> list[Floats]:
        """Parameters to begin with: the lamp, then the balls' shifts. The lamp lies where the rays
        meet that its images and shadows say, or, where they are nearly one, on their way."""
        rest = np.zeros(self.touch.size)
        if self.setting.said_m is not None:
            return [np.r_[self.setting.said_m, rest]]
        point, way = self._rays()
        meeting = meeting_point(point, way)
        if self.setting.moves:
            return [np.r_[meeting, rest]]
        middle, towards = np.median(point, axis=0), np.median(way, axis=0)
        away = [middle + reach * towards / np.linalg.norm(towards) for reach in _STARTS_M]
        return [np.r_[at, rest] for at in (meeting, *away) if at[2] < -_LOWEST_M]

    def _rays(self) -> tuple[Floats, Floats]:
        """`[R, 3]` points and unit directions to the lamp, in its frame."""
        points, ways = [], []
        for b, ball in enumerate(self.setting.balls):
            centre = ball.centre_m
            rows, way = self._sight_lines(self.balls[:, b])
            near = ((centre - self.eye[rows]) * way).sum(1, keepdims=True)
            miss = self.eye[rows] + near * way - centre
            depth = np.sqrt(np.maximum(ball.radius_m**2 - (miss**2).sum(1, keepdims=True), 0))
            normal = unit(miss - depth * way)
            points.append((rows, centre + ball.radius_m * normal))
            ways.append(way - 2 * (way * normal).sum(1, keepdims=True) * normal)
        for m, mirror in enumerate(self.setting.mirrors):
            rows, way = self._sight_lines(self.mirrors[:, m])
            reach = (-mirror.height_m - self.eye[rows, 2:]) / way[:, 2:]
            points.append((rows, self.eye[rows] + reach * way))
            ways.append(way * [1, 1, -1])
        if self.setting.moves:
            shown = [
                np.einsum("kij,kj->ki", self.turn[rows], p) + self.shift[rows] for rows, p in points
            ]
            turned = [
                np.einsum("kij,kj->ki", self.turn[rows], w)
                for (rows, _), w in zip(points, ways, strict=True)
            ]
            return np.concatenate(shown), np.concatenate(turned)
        for pin in self.setting.shadows:
            tip = np.array([pin.tip_x_m, pin.tip_y_m, 0.0])
            points.append((np.zeros(1, int), tip[None]))
            ways.append(unit(np.array([[pin.x_m, pin.y_m, -pin.height_m]]) - tip))
        return np.concatenate([p for _, p in points]), np.concatenate(ways)

    def _sight_lines(self, pixels: Floats) -> tuple[NDArray[np.intp], Floats]:
        """Numbers of the pictures that have a pixel `[K, 2]`, and the ways `[n, 3]` on the board on
        which these look."""
        rows = np.flatnonzero(np.isfinite(pixels[:, 0]))
        straight = undistorted(self.setting.camera, pixels[rows])
        way = np.c_[straight, np.ones(len(rows))]
        return rows, unit(np.einsum("kji,kj->ki", self.turn[rows], way))

    def lamps_m(self, at: Floats) -> Floats:
        """`[K, 3]` the lamp of each picture in the board's frame."""
        if not self.setting.moves:
            return np.broadcast_to(at, (len(self.poses), 3))
        return np.einsum("kji,kj->ki", self.turn, at - self.shift)

    def image_residuals(self, p: Floats) -> tuple[Floats, Floats]:
        """`[K, B, 2]` and `[K, M, 2]`: pixels between the lamp's images and where they should be;
        NaN where there is none."""
        lamp = self.lamps_m(p[:3])
        touch = self.touch + p[3:].reshape(-1, 2)
        in_balls = np.full(self.balls.shape, np.nan)
        for b, ball in enumerate(self.setting.balls):
            centre = np.r_[touch[b], -ball.radius_m]
            point = mirror_points(centre, ball.radius_m, self.eye, lamp)
            in_balls[:, b] = self.balls[:, b] - self._pixels(point)
        in_mirrors = np.full(self.mirrors.shape, np.nan)
        for m, mirror in enumerate(self.setting.mirrors):
            behind = lamp * [1, 1, -1] - [0, 0, 2 * mirror.height_m]
            in_mirrors[:, m] = self.mirrors[:, m] - self._pixels(behind)
        return in_balls, in_mirrors

    def _pixels(self, board_points: Floats) -> Floats:
        """`[K, 2]` of a point `[K, 3]` in each picture."""
        there = np.einsum("kij,kj->ki", self.turn, board_points) + self.shift
        return projected(self.setting.camera, there * Y_UP)

    def level_residuals(self, p: Floats) -> tuple[Floats, float]:
        """`[K, S]` log light on the white squares less cos θ / d², each picture's level and the
        vignetting, which is returned, too: the share that is lost in the corners."""
        to = self.lamps_m(p[:3])[:, None] - self.squares
        square = (to**2).sum(-1)
        facing = -to[..., 2] / np.sqrt(square)
        with np.errstate(divide="ignore", invalid="ignore"):
            left = self.level - np.log(np.maximum(facing, _GRAZING) / square)
        known = np.isfinite(left)
        row = known.sum(axis=1, keepdims=True)

        def centred(values: Floats) -> Floats:
            mean = np.where(known, values, 0).sum(axis=1, keepdims=True) / np.maximum(row, 1)
            return np.where(known, values - mean, 0.0)

        left, dark = centred(left), centred(self.corner2)
        loss = float((left * dark).sum() / max((dark**2).sum(), 1e-12))
        return np.where(known, left - loss * dark, np.nan), -loss

    def residuals(self, p: Floats) -> Floats:
        """All of them over their standard deviations."""
        parts = [p[3:] / _SAID_M]
        if self.setting.said_m is not None:
            parts.append((p[:3] - self.setting.said_m) / _SAID_M)
        in_balls, in_mirrors = self.image_residuals(p)
        for off, used in ((in_balls, self.used_balls), (in_mirrors, self.used_mirrors)):
            parts.append(np.clip(off[used], -1e4, 1e4).ravel() / _IMAGE_PX)
        level = self.level_residuals(p)[0]
        # the errors of a square are alike in all pictures: together they count as one sight of it
        count = np.isfinite(level).sum(axis=0)
        parts.append(np.nansum(level, axis=0)[count > 0] / count[count > 0] / _LEVEL)
        if not self.setting.moves:
            parts.append(self._shadow_residuals(p[:3]))
            parts.append(np.maximum(p[2:3] + _LOWEST_M, 0) / _SHADOW_M)
        return np.concatenate(parts)

    def _shadow_residuals(self, at: Floats) -> Floats:
        off = []
        for pin in self.setting.shadows:
            height = max(-at[2], pin.height_m + 1e-3)
            tip = np.array([pin.x_m, pin.y_m])
            falls = tip + (tip - at[:2]) * pin.height_m / (height - pin.height_m)
            off.append((falls - [pin.tip_x_m, pin.tip_y_m]) / _SHADOW_M)
        return np.ravel(off)

    def solved(self) -> Floats:
        """Parameters from the best of the starts, after images that do not fit were left out."""
        from scipy.optimize import least_squares

        scale = np.r_[np.full(3, 0.1), np.full(self.touch.size, 1e-3)]

        def fitted(start: Floats, most: int) -> Any:
            return least_squares(
                self.residuals, start, loss="soft_l1", x_scale=scale, max_nfev=most
            )

        starts = self.starts()
        if not starts:
            raise InputError(
                f"{self.name}: expected images of a lamp above the board, got {self.image_count} "
                "that would show one below it: are the places of balls and mirrors right?"
            )
        found = min((fitted(start, _TRIED) for start in starts), key=lambda each: float(each.cost))
        for _ in range(_ROUNDS):
            in_balls, in_mirrors = self.image_residuals(found.x)
            limit = _OUTLIER * np.clip(self._spread(in_balls, in_mirrors), _IMAGE_PX, _MOST_PX)
            before = self._left_out
            with np.errstate(invalid="ignore"):
                self.used_balls = np.linalg.norm(in_balls, axis=2) < limit
                self.used_mirrors = np.linalg.norm(in_mirrors, axis=2) < limit
            found = fitted(found.x, _SOLVED)
            if self._left_out == before:
                break
        return np.asarray(found.x)

    @property
    def _left_out(self) -> int:
        return self.image_count - int(self.used_balls.sum() + self.used_mirrors.sum())

    def _spread(self, *off: Floats) -> float:
        all_of = np.concatenate([np.linalg.norm(each, axis=2).ravel() for each in off])
        return float(np.nanmedian(all_of)) if np.isfinite(all_of).any() else 0.0

    def described(self, p: Floats) -> FoundLamp:
        """The solution with its uncertainty.

        Raises:
            InputError: most of the images do not fit.
        """
        from scipy.optimize import approx_fprime

        in_balls, in_mirrors = self.image_residuals(p)
        self.used_balls &= np.isfinite(in_balls[..., 0])
        off = np.concatenate([in_balls[self.used_balls], in_mirrors[self.used_mirrors]])
        if self.image_count and self._left_out > 0.5 * self.image_count:
            raise InputError(
                f"{self.name}: of {self.image_count} images of the lamp in balls and mirrors "
                f"{self._left_out} fit no lamp: it moved, there are two, or the ball's radius or "
                "place is another"
            )
        jacobian = approx_fprime(p, self.residuals, 1e-6)
        # what nothing tells is known to a metre
        weak = np.diag(1 / np.r_[np.full(3, _WEAK_M), np.full(self.touch.size, _SAID_M)] ** 2)
        inverse = np.linalg.inv(jacobian.T @ jacobian + weak)
        covariance = inverse[:3, :3] * max(1.0, float(np.mean(self.residuals(p) ** 2)))
        rms = float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0
        level, lost = self.level_residuals(p)
        there = np.isfinite(level)
        return FoundLamp(
            at_m=p[:3],
            std_m=covariance,
            std_deg=self._std_deg(p[:3], covariance),
            balls_m=self.touch + p[3:].reshape(-1, 2),
            images=len(off),
            left_out=self._left_out,
            image_rms_px=rms,
            level_rms=float(np.sqrt((level[there] ** 2).mean())) if there.any() else 0.0,
            vignetting=lost,
        )

    def _std_deg(self, at: Floats, covariance: Floats) -> float:
        """Across the line from the piece to the lamp."""
        away = (self.lamps_m(at) - self.setting.middle_m)[0]
        distance = float(np.linalg.norm(away))
        if self.setting.moves:
            covariance = self.turn[0].T @ covariance @ self.turn[0]
        way = away / distance
        across = np.eye(3) - np.outer(way, way)
        variance = float(np.trace(across @ covariance @ across)) / 2
        return float(np.degrees(np.sqrt(variance) / distance))
