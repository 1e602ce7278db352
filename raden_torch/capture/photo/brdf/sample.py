"""Where the sample is in a photograph: its shape in the camera's frame, and its pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.ball import ball_from_mask, find_ball
from raden_torch.capture.photo.brdf.cylinder_axis import rod_from_mask, rod_on_board
from raden_torch.capture.photo.brdf.rays import (
    board_direction,
    board_to_scene,
    projected,
    rays_through,
)
from raden_torch.capture.photo.brdf.sample_shapes import Plane, Shape, Sphere
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.photo_set import read_mask
from raden_torch.errors import InputError

MARGIN_PX = 2
"""Pixels so near to the sample's edge are left out: what lies behind it shines into them."""
_TOWARDS = np.array([0.0, 0.0, -1.0])
"""Out of the board, in its own frame."""


@dataclass(frozen=True, eq=False)
class SampleSpec:
    """What a person says of the sample.

    Attributes:
        shape: "sphere", "plane" (on the board) or "cylinder".
        mask: white on it; for all photographs, so only where nothing moves.
        region_m: `[n, 2]` the corners of a plane, on the board.
        radius_mm: of a sphere or cylinder; needed with a camera.
        axis_m: `[2, 2]` two points on the board above which a cylinder's axis runs, lying on it.
    """

    shape: Literal["sphere", "plane", "cylinder"] | str
    mask: Path | None = None
    region_m: Floats | None = None
    radius_mm: float | None = None
    axis_m: Floats | None = None

    def __post_init__(self) -> None:
        if self.shape not in ("sphere", "plane", "cylinder"):
            raise InputError(f"shape: expected sphere, plane or cylinder, got {self.shape!r}")
        if self.shape == "plane" and self.region_m is None and self.mask is None:
            raise InputError("plane: expected its corners on the board, or a mask, got neither")
        if self.shape == "cylinder" and self.mask is None:
            raise InputError("cylinder: expected a mask that is white on it, got none")
        if self.radius_mm is not None and not 0 < self.radius_mm < np.inf:
            raise InputError(f"{self.shape}: radius: expected above 0 mm, got {self.radius_mm} mm")


@dataclass(frozen=True, eq=False)
class SampleInPhotograph:
    """The sample in one photograph: its shape, and `[P]` columns and rows of its pixels."""

    shape: Shape
    x_px: NDArray[np.intp]
    y_px: NDArray[np.intp]


def place(
    spec: SampleSpec,
    camera: Camera | None,
    pose: Pose | None,
    size: tuple[int, int],
    all_of_them: Callable[[], list[NDArray[Any]]],
    name: str,
) -> SampleInPhotograph:
    """Find the sample.

    Args:
        size: height and width of the photographs.
        all_of_them: reads the photographs, where a sphere has to be looked for.
        name: of the photograph, for messages.

    Raises:
        InputError: no camera, pose or radius where the shape needs one; a mask that is not of such
            a shape; a sample outside the photograph.
    """
    mask = None if spec.mask is None else read_mask(spec.mask, size)
    shape: Shape
    if spec.shape == "plane":
        shape, inside = _plane(spec, camera, pose, size, mask, name)
    elif camera is not None and spec.radius_mm is None:
        raise InputError(
            f"{spec.shape}: expected its radius in mm, since a camera is given, got none"
        )
    elif spec.shape == "sphere":
        shape, inside = _sphere(spec, camera, size, mask, all_of_them, name)
    else:
        assert mask is not None
        if spec.axis_m is not None:
            _need_pose(pose, name)
            shape = rod_on_board(spec.axis_m, spec.radius_mm, pose, camera, name)
        else:
            shape = rod_from_mask(mask, camera, spec.radius_mm, str(spec.mask))
        inside = mask > 0.5
    y, x = np.nonzero(eroded(inside))
    normal = shape.seen(rays_through(camera, x, y)).normal
    hit = np.isfinite(normal).all(axis=1)
    if not hit.any():
        raise InputError(f"{name}: no pixel shows the sample; is it in the picture?")
    return SampleInPhotograph(shape, x[hit], y[hit])


def board_pixels(
    corners_m: Floats, camera: Camera | None, pose: Pose | None, size: tuple[int, int], name: str
) -> Bools:
    """`[H, W]`: the pixels inside corners `[n, 2]` on the board."""
    import cv2

    if camera is None or pose is None:
        raise InputError(
            f"{name}: a place on the board needs a camera file with the board's pose in this "
            "photograph"
        )
    dense = np.concatenate(
        [
            np.linspace(a, b, 32, endpoint=False)
            for a, b in zip(corners_m, np.roll(corners_m, -1, 0), strict=True)
        ]
    )
    scene = board_to_scene(pose, np.c_[dense, np.zeros(len(dense))])
    pixels = projected(camera, scene)
    if not (scene[:, 2] < 0).all() or abs(pixels).max() > 1e6:
        raise InputError(f"{name}: the place on the board lies behind the camera")
    drawn = np.zeros(size, np.uint8)
    cv2.fillPoly(drawn, [np.rint(pixels * 16).astype(np.int32)], 1, shift=4)
    return np.asarray(drawn > 0)


def board_plane(corners_m: Floats, pose: Pose) -> Plane:
    """The part of the board inside corners `[n, 2]`, as the camera sees it."""
    corners = board_to_scene(pose, np.c_[corners_m, np.zeros(len(corners_m))])
    return Plane(corners, board_direction(pose, _TOWARDS))


def eroded(inside: Bools, margin_px: int = MARGIN_PX) -> Bools:
    """Without the pixels near its edge, or the frame's."""
    import cv2

    side = 2 * margin_px + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    kept = cv2.erode(inside.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(kept > 0)


def _plane(
    spec: SampleSpec,
    camera: Camera | None,
    pose: Pose | None,
    size: tuple[int, int],
    mask: NDArray[Any] | None,
    name: str,
) -> tuple[Shape, Bools]:
    pose = _need_pose(pose, name)
    inside = np.ones(size, bool) if mask is None else mask > 0.5
    if spec.region_m is not None:
        inside &= board_pixels(spec.region_m, camera, pose, size, name)
        return board_plane(spec.region_m, pose), inside
    y, x = np.nonzero(inside)
    box = np.array([[x.min(), y.min()], [x.max(), y.min()], [x.max(), y.max()], [x.min(), y.max()]])
    whole = board_plane(np.array([[0.0, 0.0], [1, 0], [1, 1]]), pose)
    corners = whole.seen(rays_through(camera, *box.T)).point
    if not np.isfinite(corners).all():
        raise InputError(f"{spec.mask}: part of it is not on the board's plane")
    return Plane(corners, whole.normal), inside


def _sphere(
    spec: SampleSpec,
    camera: Camera | None,
    size: tuple[int, int],
    mask: NDArray[Any] | None,
    all_of_them: Callable[[], list[NDArray[Any]]],
    name: str,
) -> tuple[Shape, Bools]:
    import cv2

    def straight(image: NDArray[Any]) -> NDArray[Any]:
        if camera is None:
            return image
        return cv2.undistort(image, camera.matrix, camera.distortion)

    matrix = None if camera is None else camera.matrix
    radius = 1.0 if spec.radius_mm is None else spec.radius_mm
    if mask is not None:
        ball = ball_from_mask(straight(mask), matrix=matrix, radius=radius, name=str(spec.mask))
    else:
        images = [straight(image) for image in all_of_them()]
        ball = find_ball(images, matrix=matrix, radius=radius, name=name)
    sphere = Sphere(ball.centre, ball.radius)
    y, x = np.mgrid[: size[0], : size[1]].reshape(2, -1)
    near = np.hypot(x - ball.x_px, y - ball.y_px) < 1.5 * ball.radius_px + 0.1 * max(size)
    x, y = x[near], y[near]
    hit = np.isfinite(sphere.seen(rays_through(camera, x, y)).normal).all(axis=1)
    inside = np.zeros(size, bool)
    inside[y[hit], x[hit]] = True
    return sphere, inside if mask is None else inside & (mask > 0.5)


def _need_pose(pose: Pose | None, name: str) -> Pose:
    if pose is None:
        raise InputError(
            f"{name}: the board's pose in it is not known; `raden capture calibrate --camera` "
            "finds it (a file with one pose serves all photographs, where nothing moves)"
        )
    return pose
