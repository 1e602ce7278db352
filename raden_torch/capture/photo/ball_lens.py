"""The lens through which balls are photographed: its matrix, and pictures without distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.camera import check_camera_size, read_camera
from raden_torch.capture.photo.photo_set import PhotoSet
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class BallLens:
    """The camera, if there is one.

    Attributes:
        matrix: `[3, 3]` pixels; None: far away, every view is parallel.
        distortion: as OpenCV has it.
        radius_mm: of the balls; 1 without a camera.
        orientation: EXIF's, 1…8, by which the camera's photographs are turned; None where nobody
            says.
        size: height and width of its photographs; None without a camera.
    """

    matrix: Floats | None = None
    distortion: Floats | None = None
    radius_mm: float = 1.0
    orientation: int | None = None
    size: tuple[int, int] | None = None

    @classmethod
    def of(cls, path: Path | None, radius_mm: float | None) -> BallLens:
        """From a camera file.

        Raises:
            InputError: a camera without the balls' radius, or the other way round.
        """
        if path is None:
            if radius_mm is not None:
                raise InputError("the ball's radius is of use with a camera only; give its file")
            return cls()
        if radius_mm is None or not 0 < radius_mm < np.inf:
            raise InputError(f"{path}: with a camera the ball's radius in mm is needed, above 0")
        camera = read_camera(path)
        return cls(camera.matrix, camera.distortion, radius_mm, camera.orientation, camera.size)

    def check_size(self, path: Path | None, size: tuple[int, int]) -> None:
        """Raise InputError where the camera of file `path` takes photographs of another size."""
        if self.size is not None:
            check_camera_size(path, self.size, size)

    def straight(self, image: NDArray[Any]) -> NDArray[Any]:
        """`[H, W, …]` without distortion."""
        import cv2

        if self.matrix is None or self.distortion is None:
            return image
        return cv2.undistort(image, self.matrix, self.distortion)

    def straightened(self, photos: PhotoSet, linear: list[NDArray[Any]]) -> PhotoSet:
        """The set with its pictures replaced by those that `straight` gave."""
        if self.matrix is None:
            return photos
        return replace(photos, images=torch.from_numpy(np.stack(linear)).movedim(-1, 1))
