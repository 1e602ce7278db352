"""Which pixels of a photograph show the white reference, and the plane that it lies in."""

from __future__ import annotations

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.brdf.board_region import board_pixels, whole_board
from raden_torch.capture.photo.brdf.capture_settings import WhiteSpec
from raden_torch.capture.photo.brdf.photo_white import WhitePlace
from raden_torch.capture.photo.brdf.pixel_regions import eroded, polygon_pixels
from raden_torch.capture.photo.brdf.sample_shapes import Plane
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.photo_set import read_mask
from raden_torch.errors import InputError


def white_place(
    spec: WhiteSpec,
    camera: Camera | None,
    pose: Pose | None,
    size: tuple[int, int],
    middle: Floats,
    name: str,
) -> WhitePlace:
    """The white's pixels in a photograph, and its plane.

    Args:
        size: height and width of the photograph.
        middle: `[3]` of the sample.
        name: of the photograph, for messages.

    Raises:
        InputError: a place on the board without a pose, a mask of another size, an empty place.
    """
    y, x = np.nonzero(eroded(_pixels(spec, camera, pose, size, name)))
    if not len(x):
        raise InputError(f"{name}: the white reference covers no pixel; is it in the picture?")
    if spec.normal is None and pose is not None and camera is not None:
        board = whole_board(pose)
        plane = board if spec.at is None else Plane(spec.at[None], board.normal)
        return WhitePlace(x, y, plane, on_board=True)
    normal = np.array([0.0, 0.0, 1.0]) if spec.normal is None else spec.normal
    at = middle if spec.at is None else spec.at
    return WhitePlace(x, y, Plane(at[None], normal / np.linalg.norm(normal)))


def _pixels(
    spec: WhiteSpec, camera: Camera | None, pose: Pose | None, size: tuple[int, int], name: str
) -> Bools:
    if spec.mask is not None:
        return np.asarray(read_mask(spec.mask, size) > 0.5)
    if spec.region_m is not None:
        return board_pixels(spec.region_m, camera, pose, size, name)
    assert spec.patch_px is not None
    return polygon_pixels(spec.patch_px, size)
