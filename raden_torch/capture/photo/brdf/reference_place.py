"""Where the white reference is in a photograph, as a person says it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.photo.brdf.photo_white import WhitePlace
from raden_torch.capture.photo.brdf.sample import board_pixels, board_plane, eroded
from raden_torch.capture.photo.brdf.sample_shapes import Plane
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.photo_set import read_mask
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class WhiteSpec:
    """One of `mask`, `region_m` and `patch_px`, and its plane.

    Attributes:
        mask: white on it; where nothing moves.
        region_m: `[n, 2]` its corners on the board.
        patch_px: `[n, 2]` its corners in the photographs, such as a chart's white patch.
        normal: `[3]` in the camera's frame; None: the board's, or, without a pose, to the camera.
        at: `[3]` a point of its plane; None: on the board, or, without a pose, the sample's middle.
    """

    mask: Path | None = None
    region_m: Floats | None = None
    patch_px: Floats | None = None
    normal: Floats | None = None
    at: Floats | None = None

    def __post_init__(self) -> None:
        given = [place is not None for place in (self.mask, self.region_m, self.patch_px)]
        if sum(given) != 1:
            raise InputError(
                "white reference: expected one place (a mask, its corners on the board, or the "
                f"colour chart's white patch), got {sum(given)}"
            )
        if self.normal is not None and not np.linalg.norm(self.normal) > 0:
            raise InputError("white reference: normal: expected a direction, got 0")


def white_place(
    spec: WhiteSpec,
    camera: Camera | None,
    pose: Pose | None,
    size: tuple[int, int],
    middle: Floats,
    name: str,
) -> WhitePlace:
    """The white's pixels in a photograph, and its plane.

    Raises:
        InputError: a place on the board without a pose, a mask of another size, an empty place.
    """
    y, x = np.nonzero(eroded(_pixels(spec, camera, pose, size, name)))
    if not len(x):
        raise InputError(f"{name}: the white reference covers no pixel; is it in the picture?")
    if spec.normal is None and pose is not None and camera is not None:
        board = board_plane(np.array([[0.0, 0.0], [1, 0], [1, 1]]), pose)
        plane = board if spec.at is None else Plane(spec.at[None], board.normal)
    else:
        normal = np.array([0.0, 0.0, 1.0]) if spec.normal is None else spec.normal
        at = middle if spec.at is None else spec.at
        plane = Plane(at[None], normal / np.linalg.norm(normal))
    return WhitePlace(x, y, plane)


def _pixels(
    spec: WhiteSpec, camera: Camera | None, pose: Pose | None, size: tuple[int, int], name: str
) -> Bools:
    import cv2

    if spec.mask is not None:
        return np.asarray(read_mask(spec.mask, size) > 0.5)
    if spec.region_m is not None:
        return board_pixels(spec.region_m, camera, pose, size, name)
    assert spec.patch_px is not None
    drawn = np.zeros(size, np.uint8)
    cv2.fillPoly(drawn, [np.rint(spec.patch_px * 16).astype(np.int32)], 1, shift=4)
    return np.asarray(drawn > 0)
