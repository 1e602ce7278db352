"""A pinhole camera that looks at a point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.errors import InputError

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera; y is up.

    Attributes:
        position: of the eye.
        target: what lies in the middle of the picture.
        fov_deg: horizontal angle of view, above 0 and below 180.
        size: width and height in pixels.
    """

    position: Place
    target: Place
    fov_deg: float
    size: tuple[int, int]

    def __post_init__(self) -> None:
        if not 0 < self.fov_deg < 180:
            raise InputError(
                f"camera: fov_deg: expected more than 0 and less than 180, got {self.fov_deg}"
            )
        if math.dist(self.position, self.target) < 1e-9:
            raise InputError(
                f"camera: expected a target other than its position, got {self.target}"
            )
        if not all(1 <= side <= 16384 for side in self.size):
            raise InputError(f"camera: size: expected 1…16384 pixels a side, got {self.size}")

    def eye(self) -> Tensor:
        return torch.tensor(self.position, dtype=torch.float32)

    def rays(self, column: Tensor, row: Tensor) -> Tensor:
        """`[3, N]` rays through places of the picture in pixels, whose corner is 0, 0.

        Their length is 1 along the camera's axis.
        """
        eye, target = (torch.tensor(p, dtype=torch.float64) for p in (self.position, self.target))
        forward = torch.nn.functional.normalize(target - eye, dim=0)
        up = eye.new_tensor([0.0, 1.0, 0.0])
        if float(torch.linalg.cross(forward, up).norm()) < 1e-6:  # straight down or up
            up = eye.new_tensor([0.0, 0.0, -1.0])
        right = torch.nn.functional.normalize(torch.linalg.cross(forward, up), dim=0)
        up = torch.linalg.cross(right, forward)
        width, height = self.size
        scale = math.tan(math.radians(self.fov_deg) / 2) * 2 / width
        axes = torch.stack([right, -up, forward], 1).to(column)
        across, down = (column - width / 2) * scale, (row - height / 2) * scale
        return axes[:, :1] * across + axes[:, 1:2] * down + axes[:, 2:]


@dataclass(frozen=True)
class View:
    """How a picture is looked at.

    Attributes:
        per_side: samples along each side of a pixel at an edge.
        pixel: the angle that it spans.
    """

    camera: Camera
    per_side: int
    pixel: float
