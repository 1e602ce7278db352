"""A ball in a photograph: where it is, and what a mirror ball shows of a lamp.

Pixels are x right, y down; everything else is in the camera frame: x right, y up, z to the viewer.
Without a camera the view is orthographic (the camera is far away): every ray runs along −z, lengths
are in pixels, and the balls' centres lie at z = 0. With a camera, its centre is the origin and
lengths are in the unit of the ball's radius.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.errors import InputError

_ROUND = 0.02
"""An outline may leave its circle by this share of the radius (or 1.5 pixels), one point in 20 by
more."""
_SMALLEST_PX = 8.0
ALIKE_PX = 4.0
"""Along an outline: so much of it is wrong alike."""
DRAWN_PX = 0.1
"""Of where a mask's edge is drawn all around, which its roundness does not tell."""
_BEYOND_PX = 2.0
"""How far outside of a mask's last white pixels its edge is looked for."""
_STEPS = 16
_Y_UP = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball's outline and place.

    Attributes:
        x_px, y_px, radius_px: the circle of its outline (with a camera: the cone's, about).
        rms_px: how far the outline leaves it.
        centre: `[3]` in the camera frame.
        radius: in the unit of `centre`: pixels without a camera.
        matrix: `[3, 3]` of the pinhole camera (x right, y down), or None where the camera is far.
        found_in: the mask's or photograph's name.
    """

    x_px: float
    y_px: float
    radius_px: float
    rms_px: float
    centre: Floats
    radius: float
    matrix: Floats | None = None
    found_in: str = ""

    def surface(self, x_px: Any, y_px: Any) -> tuple[Floats, Floats, Floats]:
        """Points on the ball, unit normals (away from its centre) and unit directions to the
        viewer, `[..., 3]`; NaN where the pixel does not see the ball."""
        x, y = np.broadcast_arrays(np.asarray(x_px, float), np.asarray(y_px, float))
        ray = _rays(x, y, self.matrix)
        zero = np.zeros_like(x)
        start = (
            np.stack([x, -y, zero], -1) if self.matrix is None else np.stack([zero, zero, zero], -1)
        )
        to_centre = self.centre - start
        along = (to_centre * ray).sum(-1)
        square = along**2 - (to_centre**2).sum(-1) + self.radius**2
        with np.errstate(invalid="ignore"):
            reach = along - np.sqrt(square)
        point = start + reach[..., None] * ray
        return point, (point - self.centre) / self.radius, -ray

    def towards_lamp(self, x_px: Any, y_px: Any) -> tuple[Floats, Floats]:
        """Where a mirror ball reflects, and the unit direction from there TO what is seen there.

        The direction is a light direction, L = 2 (N·V) N − V, not the ball's normal N.
        """
        point, normal, view = self.surface(x_px, y_px)
        return point, 2 * (normal * view).sum(-1, keepdims=True) * normal - view

    @property
    def std_px(self) -> float:
        """Standard deviation of the centre in each direction, and about of the radius: by how far
        the outline leaves its circle, and by where it was drawn."""
        by_edge = self.rms_px * np.sqrt(ALIKE_PX / (np.pi * self.radius_px))
        return float(np.hypot(by_edge, DRAWN_PX))

    def inside(self, size: tuple[int, int], share: float = 1.0) -> NDArray[np.bool_]:
        """`[H, W]`, the pixels within this share of its radius."""
        y, x = np.mgrid[: size[0], : size[1]]
        return np.hypot(x - self.x_px, y - self.y_px) <= share * self.radius_px


def outline_moves(
    centre: Floats, radius: float, radius_px: float, std_px: float, *, is_near: bool
) -> list[tuple[Floats, float]]:
    """A ball's centre and radius, moved by one standard deviation of each error that its outline
    may have: to the right, up, and in size.

    Args:
        is_near: it is seen by a camera, and its radius is known: in size means nearer.
    """
    shift = std_px * radius / radius_px
    moved = [(centre + shift * axis, radius) for axis in np.eye(3)[:2]]
    if is_near:
        return [*moved, (centre * (1 - std_px / radius_px), radius)]
    return [*moved, (centre, radius + shift)]


def ball_from_mask(
    mask: NDArray[Any],
    *,
    matrix: Floats | None = None,
    radius: float = 1.0,
    name: str | os.PathLike[str] = "mask",
) -> Ball:
    """The ball that a mask covers: one round white area, which the frame may cut.

    Args:
        mask: `[H, W]`, white on the ball; above half of its largest value counts.
        matrix: `[3, 3]` of the camera, for pixels without lens distortion; None: far away.
        radius: of the ball in the unit wanted; only with a camera.
        name: of the mask, for messages.

    Raises:
        InputError: an empty mask, or an area that is not round: a ball with its stand, two balls.
    """
    import cv2

    levels = np.asarray(mask, np.float32)
    white = (levels > levels.max() / 2).astype(np.uint8)
    outlines, _ = cv2.findContours(white, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        raise InputError(f"{name}: expected a mask that is white on the ball, got an empty one")
    outline = max(outlines, key=len)[:, 0].astype(float)
    height, width = white.shape
    free = (outline > 0).all(1) & (outline < [width - 1, height - 1]).all(1)
    if free.sum() < 3 * _SMALLEST_PX:
        raise InputError(
            f"{name}: expected a mask that is white on the ball and black around it, got no "
            "outline of a ball"
        )
    points = _half_crossings(levels, outline[free])
    return _ball(points, matrix, radius, str(name), white)


def _half_crossings(levels: NDArray[np.float32], outline: Floats) -> Floats:
    """`[n, 2]`: where the mask falls through half of its largest value, on the way out through its
    last white pixels: an edge painted smoothly is known to a fraction of a pixel."""
    import cv2

    centre, _ = _circle(outline)
    way = (outline - centre) / np.hypot(*(outline - centre).T)[:, None]
    reach = np.linspace(0, _BEYOND_PX, _STEPS + 1)
    u, v = (outline[:, None] + way[:, None] * reach[:, None]).astype(np.float32).transpose(2, 0, 1)
    profile = cv2.remap(levels, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    half = levels.max() / 2
    below = profile <= half
    found = np.flatnonzero(below.any(axis=1))
    after = below[found].argmax(axis=1)
    last, first = profile[found, after - 1], profile[found, after]
    at = reach[after - 1] + (last - half) / (last - first) * reach[1]
    return np.asarray(outline[found] + way[found] * at[:, None])


def find_ball(
    photographs: Sequence[NDArray[Any]],
    *,
    matrix: Floats | None = None,
    radius: float = 1.0,
    name: str | os.PathLike[str] = "photographs",
) -> Ball:
    """The largest ball in photographs by one camera, from their sum: Hough's circle, then the edge
    along rays from its centre to a fraction of a pixel.

    Args:
        photographs: `[H, W, 3]` linear or coded, of one size.

    Raises:
        InputError: no circle with an edge around at least half of it.
    """
    import cv2

    total = np.sum([np.sqrt(np.clip(p.mean(-1), 0, None)) for p in photographs], axis=0)
    top = np.quantile(total, 0.98)
    grey = (np.clip(total / max(top, 1e-12), 0, 1) * 255).astype(np.uint8)
    scale = min(1.0, 640 / max(grey.shape))
    small = cv2.GaussianBlur(cv2.resize(grey, None, fx=scale, fy=scale), (5, 5), 1.2)
    found = cv2.HoughCircles(
        small,
        cv2.HOUGH_GRADIENT_ALT,
        1.5,
        min(small.shape) / 4,
        param1=100,
        param2=0.6,
        minRadius=int(max(_SMALLEST_PX, min(small.shape) / 16)),
        maxRadius=min(small.shape),
    )
    best: Ball | None = None
    for x, y, r in [] if found is None else found.reshape(-1, found.shape[-1])[:8, :3] / scale:
        points = _edge(grey.astype(np.float32), x, y, r)
        if len(points) < _RAYS / 2:
            continue
        candidate = _ball(points, matrix, radius, str(name), None, strict=False)
        if best is None or candidate.radius_px > best.radius_px:
            best = candidate
    if best is None:
        raise InputError(
            f"{name}: no ball found; give a mask that is white on it (a chrome ball against a dark "
            "background has no outline to find)"
        )
    return best


_RAYS = 180


def _edge(grey: NDArray[np.float32], x: float, y: float, r: float) -> Floats:
    """The strongest edge on each ray from 0.85 to 1.15 r, `[n, 2]`, refined by a parabola."""
    import cv2

    angle = 2 * np.pi * np.arange(_RAYS) / _RAYS
    reach = np.arange(0.85 * r, 1.15 * r, 0.5)
    u = (x + np.cos(angle)[:, None] * reach).astype(np.float32)
    v = (y + np.sin(angle)[:, None] * reach).astype(np.float32)
    profile = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    slope = np.abs(np.gradient(profile, axis=1))
    peak = slope[:, 1:-1].argmax(1) + 1
    row = np.arange(_RAYS)
    a, b, c = (slope[row, peak + k] for k in (-1, 0, 1))
    shift = 0.5 * (a - c) / np.where(a - 2 * b + c < 0, a - 2 * b + c, -np.inf)
    at = reach[peak] + 0.5 * np.clip(shift, -1, 1)
    points = np.stack([x + np.cos(angle) * at, y + np.sin(angle) * at], -1)
    height, width = grey.shape
    kept = (b > 4) & (points > 1).all(1) & (points < [width - 2, height - 2]).all(1)
    points = points[kept]
    for _ in range(5):  # drop what is not on the circle of the rest
        if len(points) < 8:
            break
        centre, fitted = _circle(points)
        off = np.abs(np.hypot(*(points - centre).T) - fitted)
        points = points[off <= max(1.0, 2.5 * float(np.median(off)))]
    return points


def _circle(points: Floats) -> tuple[Floats, float]:
    """Centre and radius that minimise the distances' squares, from the algebraic fit."""
    from scipy.optimize import least_squares

    mean = points.mean(0)
    p = points - mean
    solved = np.linalg.lstsq(np.c_[2 * p, np.ones(len(p))], (p**2).sum(1), rcond=None)[0]
    start = np.r_[solved[:2], np.sqrt(max(solved[2] + (solved[:2] ** 2).sum(), 1e-6))]
    fitted = least_squares(
        lambda c: np.hypot(*(p - c[:2]).T) - c[2], start, loss="soft_l1", f_scale=0.5
    )
    return fitted.x[:2] + mean, float(fitted.x[2])


def _ball(
    points: Floats,
    matrix: Floats | None,
    radius: float,
    name: str,
    white: NDArray[np.uint8] | None,
    strict: bool = True,
) -> Ball:
    centre, r = _circle(points)
    if matrix is None:
        off = np.hypot(*(points - centre).T) - r
        place, size = np.array([centre[0], -centre[1], 0.0]), r
    else:
        # the rays that touch a ball make a cone: ray·axis = cos α, linear in axis / cos α
        rays = _rays(points[:, 0], points[:, 1], matrix)
        axis = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0]
        cosine = 1 / np.linalg.norm(axis)
        if not cosine < 1:
            raise InputError(f"{name}: the outline is no ball's in this camera; another camera?")
        half = float(np.arctan(np.sqrt(1 / cosine**2 - 1)))
        across = np.arctan2(np.linalg.norm(np.cross(rays, axis), axis=1), rays @ axis)
        off = (across - half) * float(matrix[0, 0] + matrix[1, 1]) / 2
        place, size = axis * cosine * radius / np.sin(half), radius
    limit = max(1.5, _ROUND * r)
    if strict and float(np.quantile(np.abs(off), 0.95)) > limit:
        raise InputError(
            f"{name}: not round: its outline leaves the best circle by up to "
            f"{np.abs(off).max():.1f} pixels (radius {r:.1f}); mask one ball alone, without its "
            "stand or shadow"
        )
    if strict and white is not None:
        y, x = np.mgrid[: white.shape[0], : white.shape[1]]
        disc = np.hypot(x - centre[0], y - centre[1]) < 0.95 * r
        if disc.any() and float(white[disc].mean()) < 0.9:
            raise InputError(
                f"{name}: expected a mask that is white all over the ball, got one with holes"
            )
        if white.sum() > 1.2 * np.pi * r * r:
            raise InputError(f"{name}: expected one mask per ball, got more than one white area")
    if r < _SMALLEST_PX:
        raise InputError(
            f"{name}: a ball of radius {r:.1f} pixels is too small to tell directions; fill at "
            "least a tenth of the picture with it"
        )
    rms = float(np.sqrt((off**2).mean()))
    return Ball(float(centre[0]), float(centre[1]), r, rms, place, float(size), matrix, name)


def _rays(x: Floats, y: Floats, matrix: Floats | None) -> Floats:
    """Unit rays away from the viewer, `[..., 3]`, in the camera frame (y up, z to the viewer)."""
    if matrix is None:
        return np.broadcast_to(np.array([0.0, 0.0, -1.0]), (*np.shape(x), 3))
    pixels = np.stack([x, y, np.ones_like(x)], -1)
    rays = pixels @ np.linalg.inv(matrix).T * _Y_UP * np.array([1.0, 1.0, -1.0])
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)
