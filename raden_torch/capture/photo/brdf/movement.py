"""Did the sample move between the photographs? Its outline says so, to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.pixel_regions import MARGIN_PX
from raden_torch.capture.photo.brdf.rays import rays_through, scene_to_board
from raden_torch.capture.photo.brdf.sample_shapes import Plane
from raden_torch.capture.photo.brdf.seen_surface import SeenSurface
from raden_torch.capture.photo.camera import Camera, Pose

LIMIT_PX = 1.2
"""More than this from where it is in most photographs, and four standard errors, has moved."""

LIMIT_MM = 2.0
"""On a board, whose own print has edges beside those of what lies on it: the same."""

_REACH_PX = 9.0
_STEP_PX = 0.5
_FEWEST = 30
_STRONG = 8.0
"""How many times steeper than the median slope of its profile an edge has to be."""
_SCATTER_PX = 1.0
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Outline:
    """Points of the sample's outline `[n, 2]` in pixels, and unit normals away from it."""

    points: Floats
    normals: Floats


@dataclass(frozen=True, eq=False)
class Edges:
    """The edges found near an outline.

    Attributes:
        points: `[n, 2]` of the outline.
        place: `[n]` how far out of it each lies, along the normals.
        normals: `[n, 2]` unit.
        pixel: a pixel in the unit of these: 1, or mm on the board (`on_board`).
        limit: what is a movement, in that unit.
    """

    points: Floats
    place: Floats
    normals: Floats
    pixel: float = 1.0
    limit: float = LIMIT_PX


def outline_of(seen: SeenSurface, size: tuple[int, int]) -> Outline:
    """The outline of the sample's pixels, which were taken from inside its edge."""
    import cv2

    drawn = np.zeros(size, np.uint8)
    drawn[seen.y_px, seen.x_px] = 1
    found, _ = cv2.findContours(drawn, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = max(found, key=len)[:, 0].astype(np.float64)
    around = min(7, max(1, len(points) // 20))
    tangent = np.roll(points, -around, 0) - np.roll(points, around, 0)
    length = np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], 1) / length
    # cv2 runs round with the area on the right or the left: turn outwards
    if float((normal * (points - points.mean(axis=0))).sum()) < 0:
        normal = -normal
    return Outline(points + MARGIN_PX * normal, normal)


def edges_near(radiance: NDArray[np.float32], outline: Outline) -> Edges | None:
    """The steepest edge across each point of an outline; None where too few have a clear one."""
    import cv2

    reach = np.arange(-_REACH_PX, _REACH_PX + _STEP_PX / 2, _STEP_PX)
    at = outline.points[:, None] + reach[None, :, None] * outline.normals[:, None]
    grey = np.sqrt(np.clip(radiance.mean(axis=2), 0, None))
    x, y = (np.ascontiguousarray(at[..., i], np.float32) for i in (0, 1))
    profile = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    slope = np.abs(np.gradient(profile, axis=1))
    peak = slope[:, 1:-1].argmax(axis=1) + 1
    row = np.arange(len(peak))
    before, top, after = (slope[row, peak + k] for k in (-1, 0, 1))
    bend = np.where(before - 2 * top + after < 0, before - 2 * top + after, -np.inf)
    place = reach[peak] + _STEP_PX * np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    height, width = grey.shape
    inside = (at > 0).all(axis=(1, 2)) & (at < [width - 1, height - 1]).all(axis=(1, 2))
    strong = (top > _STRONG * np.median(slope, axis=1)) & (top > 0.02 * grey.max())
    good = inside & strong & (peak > 1) & (peak < len(reach) - 2)
    if good.sum() < _FEWEST:
        return None
    return Edges(outline.points[good], place[good].astype(np.float64), outline.normals[good])


def on_board(edges: Edges, plane: Plane, camera: Camera, pose: Pose) -> Edges:
    """The same in mm on the board, on which a flat piece stays where it is while the camera
    moves."""

    def there(pixels: Floats) -> Floats:
        return scene_to_board(pose, plane.seen(rays_through(camera, *pixels.T)).point)[:, :2]

    points, normals = edges.points, edges.normals
    start = there(points)
    along = there(points + normals[:, ::-1] * [-1, 1]) - start
    across = np.stack([-along[:, 1], along[:, 0]], 1)
    across /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    out = ((there(points + normals) - start) * across).sum(1)
    across *= np.sign(out)[:, None]
    place = ((there(points + edges.place[:, None] * normals) - start) * across).sum(1)
    pixel = float(np.median(abs(out)))
    return Edges(start, place, across, pixel, max(LIMIT_MM, LIMIT_PX * pixel))


def moved(found: Sequence[Edges | None], names: Sequence[str]) -> str | None:
    """One line that names the photograph in which the sample moved the most; None if none.

    An outline that is drawn too wide or too narrow is so in all photographs, and would look like a
    movement away from the light, on whose side the edges are: that is taken off first.
    """
    known = [k for k, edges in enumerate(found) if edges is not None]
    wide = np.median(np.concatenate([e.place for e in found if e is not None] or [np.zeros(1)]))
    shifts = {k: _translation(e, float(wide)) for k in known if (e := found[k]) is not None}
    fitted = {k: shift for k, shift in shifts.items() if shift is not None}
    if len(fitted) < 3:
        return None
    numbers = list(fitted)
    by = np.array([fitted[k][0] for k in numbers])
    pixel, most = np.array([(e.pixel, e.limit) for k in numbers if (e := found[k]) is not None]).T
    off = np.linalg.norm(by - np.median(by, axis=0), axis=1) / pixel
    limit = np.maximum(most, 4 * np.array([fitted[k][1] for k in numbers])) / pixel
    if not (off > limit).any():
        return None
    worst = int((off / limit).argmax())
    others = int((off > limit).sum()) - 1
    more = f" (and in {others} other photographs)" if others else ""
    return (
        f"{names[numbers[worst]]}: the sample moved: its outline lies {off[worst]:.1f} pixels from "
        f"where it is in most photographs{more}; take it again, or leave it and its lamp out"
    )


def _translation(edges: Edges, wide: float) -> tuple[Floats, float] | None:
    """`[2]` d with normal·d + wide = place, robustly (bisquare), and its standard error."""
    normals, place = edges.normals, edges.place - wide
    weight = np.ones(len(place))
    for _ in range(_ROUNDS):
        square = (normals * weight[:, None]).T @ normals
        if np.linalg.cond(square) > 1e3:  # one straight edge alone
            return None
        by = np.asarray(np.linalg.solve(square, (normals * weight[:, None]).T @ place), np.float64)
        off = place - normals @ by
        scale = max(1.4826 * float(np.median(abs(off - np.median(off)))), 0.05 * edges.pixel)
        weight = np.clip(1 - (off / (4.685 * scale)) ** 2, 0, None) ** 2
    agree = weight > 0
    if scale > _SCATTER_PX * edges.pixel or agree.sum() < _FEWEST or agree.mean() < 0.5:
        return None
    error = scale * float(np.sqrt(np.trace(np.linalg.inv(square))))
    return by, error
