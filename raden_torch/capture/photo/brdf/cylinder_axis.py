"""A cylinder in a photograph: its axis from the two straight edges of its outline."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.ball import ALIKE_PX, DRAWN_PX
from raden_torch.capture.photo.brdf.rays import (
    MM,
    Y_UP,
    board_direction,
    board_to_scene,
    undistorted,
)
from raden_torch.capture.photo.brdf.sample_shapes import Cylinder
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.errors import InputError

_ENDS = 0.08
"""Share of the length left out at each end: round or slanted there."""
_STRAIGHT_PX = 1.5
"""From an edge's line: farther points are of the ends, which look round."""
_ROUNDS = 20
_MOSTLY = 0.5
"""Share of them that have to lie on it."""


def rod_from_mask(
    mask: NDArray[Any], camera: Camera | None, radius_mm: float | None, name: str
) -> tuple[Cylinder, float]:
    """The cylinder whose outline a mask is, longer than it is wide, and the standard deviation of
    its edges, pixels.

    With a camera, each straight edge and the camera's centre span a plane that touches the
    cylinder; the axis is parallel to both and a radius away from each. Without one the axis is
    taken to lie across the line of sight, since nothing in a parallel view says otherwise.

    Args:
        mask: `[H, W]`, 0…1.
        radius_mm: with a camera; without one the radius is measured in pixels.

    Raises:
        InputError: an outline without two straight edges.
    """
    outline, middle, along = _outline(mask, name)
    across = np.array([-along[1], along[0]])
    place = (outline - middle) @ along
    low, high = place.min(), place.max()
    cut = _ENDS * (high - low)
    straight = (place > low + cut) & (place < high - cut)
    side = (outline - middle) @ across
    # the last white pixel's centre lies up to one pixel of a row or column inside of the edge
    out = 0.5 * abs(along).max() * across
    edges = [outline[straight & (side * sign > 0)] + sign * out for sign in (-1, 1)]
    if min(map(len, edges)) < 20 or high - low < np.ptp(side):
        raise InputError(
            f"{name}: expected a mask that is white on a cylinder longer than it is wide, got no "
            "two long straight edges"
        )
    std_px = float(np.sqrt(np.mean([_std_px(edge, name) ** 2 for edge in edges])))
    if camera is None:
        return _parallel(edges, middle, along, (low + cut, high - cut), name), std_px
    assert radius_mm is not None
    return _perspective(edges, camera, radius_mm, name), std_px


def rod_on_board(
    axis_m: Floats, radius_mm: float | None, pose: Pose | None, camera: Camera | None, name: str
) -> Cylinder:
    """A cylinder that lies on the board: its axis a radius above two points `[2, 2]` of it."""
    if pose is None or radius_mm is None or camera is None:
        raise InputError(f"{name}: a cylinder on the board needs a camera, a pose and its radius")
    length = float(np.hypot(*(axis_m[1] - axis_m[0])) * MM)
    if not length > 0:
        raise InputError("cylinder: axis: expected two different points, got one twice")
    ends = board_to_scene(pose, np.c_[axis_m, np.full(2, -radius_mm / MM)])
    axis = board_direction(pose, np.r_[axis_m[1] - axis_m[0], 0] * MM / length)
    return Cylinder(ends[0], axis, radius_mm, (0.0, length))


def _outline(mask: NDArray[Any], name: str) -> tuple[Floats, Floats, Floats]:
    """The outline's pixels, their middle, and the long side's direction in the picture."""
    import cv2

    white = (mask > 0.5).astype(np.uint8)
    outlines, _ = cv2.findContours(white, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        raise InputError(f"{name}: expected a mask that is white on the cylinder, got an empty one")
    outline = max(outlines, key=len)[:, 0].astype(np.float64)
    height, width = white.shape
    free = (outline > 0).all(1) & (outline < [width - 1, height - 1]).all(1)
    corners = cv2.boxPoints(cv2.minAreaRect(outline.astype(np.float32)))
    sides = np.diff(np.concatenate([corners, corners[:1]]), axis=0)[:2]
    longest = sides[np.hypot(*sides.T).argmax()].astype(np.float64)
    return outline[free], corners.mean(axis=0).astype(np.float64), longest / np.hypot(*longest)


def _straight(points: Floats, name: str, scale: float = 1.0) -> Bools:
    """`[n]`: which of an edge's points `[n, 2]` lie on its line: from that of their middle half, on
    and on.

    Args:
        scale: pixels a unit of the points.
    """
    middle, along = _line(points)
    low, high = np.quantile((points - middle) @ along, [0.25, 0.75])
    there = abs((points - middle) @ along - (low + high) / 2) <= (high - low) / 2
    for _ in range(_ROUNDS):
        point, direction = _line(points[there])
        off = scale * abs((points - point) @ np.array([-direction[1], direction[0]]))
        there = off < _STRAIGHT_PX
        if there.sum() < 2:
            break
    if there.mean() < _MOSTLY:
        raise InputError(
            f"{name}: its long edges are not straight (off by {np.quantile(off, 0.9):.1f} pixels); "
            "mask the cylinder alone"
        )
    return np.asarray(there)


def _std_px(edge: Floats, name: str) -> float:
    """Standard deviation of where an edge is, and its ends: by how far its points leave its line,
    by where it was drawn, and by what pixels tell: an edge that runs along a row of them may lie
    anywhere in it, one that crosses several is known by where it does."""
    points = edge[_straight(edge, name)]
    point, direction = _line(points)
    off = (points - point) @ np.array([-direction[1], direction[0]])
    by_points = off.std() * np.sqrt(ALIKE_PX / len(points))
    crossed = np.ptp(points, axis=0).min()
    return float(np.linalg.norm([by_points, DRAWN_PX, 1 / np.sqrt(12) / max(crossed, 1.0)]))


def _line(points: Floats) -> tuple[Floats, Floats]:
    """A point and the direction of the line through points `[n, 2]`."""
    middle = points.mean(axis=0)
    return middle, np.linalg.svd(points - middle, full_matrices=False)[2][0]


def _parallel(
    edges: list[Floats], middle: Floats, along: Floats, reach: tuple[float, float], name: str
) -> Cylinder:
    lines = [_line(edge[_straight(edge, name)]) for edge in edges]
    directions = [d * np.sign(d @ along) for _, d in lines]
    axis = np.mean(directions, axis=0)
    axis /= np.linalg.norm(axis)
    across = np.array([-axis[1], axis[0]])
    low, high = sorted(float((point - middle) @ across) for point, _ in lines)
    centre = middle + (low + high) / 2 * across
    return Cylinder(
        np.array([centre[0], -centre[1], 0.0]),
        np.array([axis[0], -axis[1], 0.0]),
        (high - low) / 2,
        (float(reach[0]), float(reach[1])),
    )


def _perspective(edges: list[Floats], camera: Camera, radius: float, name: str) -> Cylinder:
    normals = []
    rays = []
    for edge in edges:
        flat = undistorted(camera, edge)
        flat = flat[_straight(flat, name, camera.matrix[0, 0])]
        ray = np.c_[flat, np.ones(len(flat))] * Y_UP
        normals.append(np.linalg.svd(ray)[2][2])
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    between = np.concatenate(rays).mean(axis=0)
    # both normals towards the axis, which lies a radius on that side of either plane
    inward = [n * np.sign(n @ between) for n in normals]
    axis = np.cross(inward[0], inward[1])
    axis /= np.linalg.norm(axis)
    point = np.linalg.solve(np.stack([*inward, axis]), np.array([radius, radius, 0.0]))
    where = []
    for ray in rays:  # along the axis, where the edges' rays touch the cylinder
        flat = ray - (ray @ axis)[:, None] * axis
        reach = (point @ flat.T) / (flat**2).sum(1)
        where.append((reach[:, None] * ray - point) @ axis)
    low = max(float(w.min()) for w in where)
    high = min(float(w.max()) for w in where)
    return Cylinder(point, axis, radius, (low, high))
