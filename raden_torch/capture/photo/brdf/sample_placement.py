"""Where the sample is in a photograph: its shape in the camera's frame, and its pixels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Bools
from raden_torch.capture.photo.ball import ball_from_mask, find_ball
from raden_torch.capture.photo.brdf.board_region import board_pixels, board_plane, whole_board
from raden_torch.capture.photo.brdf.capture_settings import SampleSpec
from raden_torch.capture.photo.brdf.cylinder_axis import rod_from_mask, rod_on_board
from raden_torch.capture.photo.brdf.pixel_regions import eroded
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.sample_shapes import Plane, Planes, Shape, Sphere
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.photo_set import read_mask
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class SampleInPhotograph:
    """The sample in one photograph: its shape, `[P]` columns and rows of its pixels, and the
    standard deviation of the outline that the shape was found by (0: by the board)."""

    shape: Shape
    x_px: NDArray[np.intp]
    y_px: NDArray[np.intp]
    outline_px: float = 0.0


def place_sample(
    spec: SampleSpec,
    camera: Camera | None,
    pose: Pose | None,
    size: tuple[int, int],
    pictures: Iterable[NDArray[Any]],
    name: str,
) -> SampleInPhotograph:
    """Find the sample.

    Args:
        size: height and width of the photographs.
        pictures: `[H, W, 3]` each, all photographs; taken only where a sphere has no mask and is
            searched for.
        name: of the photograph, for messages.

    Raises:
        InputError: no camera, pose or radius where the shape needs one; a mask that is not of such
            a shape; a sample outside the photograph.
    """
    mask = None if spec.mask is None else read_mask(spec.mask, size)
    shape: Shape
    outline_px = 0.0
    if spec.shape == "plane":
        shape, inside = _plane(spec, camera, pose, size, mask, name)
    elif camera is not None and spec.radius_mm is None:
        raise InputError(
            f"{spec.shape}: expected its radius in mm, since a camera is given, got none"
        )
    elif spec.shape == "sphere":
        shape, inside, outline_px = _sphere(spec, camera, size, mask, pictures, name)
    else:
        assert mask is not None
        if spec.axis_m is not None:
            _need_pose(pose, name)
            shape = rod_on_board(spec.axis_m, spec.radius_mm, pose, camera, name)
        else:
            shape, outline_px = rod_from_mask(mask, camera, spec.radius_mm, str(spec.mask))
        inside = mask > 0.5
    y, x = np.nonzero(eroded(inside))
    normal = shape.seen(rays_through(camera, x, y)).normal
    hit = np.isfinite(normal).all(axis=1)
    if not hit.any():
        raise InputError(f"{name}: no pixel shows the sample; is it in the picture?")
    return SampleInPhotograph(shape, x[hit], y[hit], outline_px)


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
    if regions := spec.regions_m:
        shown = [board_pixels(region, camera, pose, size, name) for region in regions]
        planes = tuple(board_plane(region, pose) for region in regions)
        if len(planes) == 1:
            return planes[0], inside & shown[0]
        # each is eroded by itself: where two meet neither is seen whole
        return Planes(planes), inside & np.logical_or.reduce([eroded(part) for part in shown])
    y, x = np.nonzero(inside)
    box = np.array([[x.min(), y.min()], [x.max(), y.min()], [x.max(), y.max()], [x.min(), y.max()]])
    board = whole_board(pose)
    corners = board.seen(rays_through(camera, *box.T)).point
    if not np.isfinite(corners).all():
        raise InputError(f"{spec.mask}: part of it is not on the board's plane")
    return Plane(corners, board.normal), inside


def _sphere(
    spec: SampleSpec,
    camera: Camera | None,
    size: tuple[int, int],
    mask: NDArray[Any] | None,
    pictures: Iterable[NDArray[Any]],
    name: str,
) -> tuple[Shape, Bools, float]:
    matrix = None if camera is None else camera.matrix
    radius = 1.0 if spec.radius_mm is None else spec.radius_mm
    if mask is not None:
        straight = _straight(mask, camera)
        ball = ball_from_mask(straight, matrix=matrix, radius=radius, name=str(spec.mask))
    else:
        images = [_straight(picture, camera) for picture in pictures]
        ball = find_ball(images, matrix=matrix, radius=radius, name=name)
    sphere = Sphere(ball.centre, ball.radius)
    y, x = np.mgrid[: size[0], : size[1]].reshape(2, -1)
    near = np.hypot(x - ball.x_px, y - ball.y_px) < 1.5 * ball.radius_px + 0.1 * max(size)
    x, y = x[near], y[near]
    hit = np.isfinite(sphere.seen(rays_through(camera, x, y)).normal).all(axis=1)
    inside = np.zeros(size, bool)
    inside[y[hit], x[hit]] = True
    inside = inside if mask is None else inside & (mask > 0.5)
    return sphere, inside, ball.std_px


def _straight(image: NDArray[Any], camera: Camera | None) -> NDArray[Any]:
    """Without the lens's distortion."""
    import cv2

    if camera is None:
        return image
    return cv2.undistort(image, camera.matrix, camera.distortion)


def _need_pose(pose: Pose | None, name: str) -> Pose:
    if pose is None:
        raise InputError(
            f"{name}: the board's pose in it is not known; `raden capture calibrate --camera` "
            "finds it (a file with one pose serves all photographs, where nothing moves)"
        )
    return pose
