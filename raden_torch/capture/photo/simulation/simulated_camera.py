"""The simulated camera: lens, colour filters, sensor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.colours import CAMERA_FROM_XYZ


@dataclass(frozen=True, eq=False)
class View:
    """Where the camera stands: p_camera = rotation @ p_world + translation_mm, OpenCV's axes."""

    rotation: Floats
    translation_mm: Floats

    @property
    def position_mm(self) -> Floats:
        """`[3]` the camera's centre in the world."""
        return -self.rotation.T @ self.translation_mm

    def of_points(self, points: Floats) -> Floats:
        """`[N, 3]` world → camera."""
        return points @ self.rotation.T + self.translation_mm


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole whose lens distorts, before a sensor that counts electrons.

    Attributes:
        matrix: `[3, 3]` pixels, x right, y down, (0, 0) the centre of the first pixel.
        distortion: `[5]` k1, k2, p1, p2, k3 as in OpenCV (Brown 1966).
        size: height and width.
        from_xyz: `[3, 3]`: raw RGB of the simulation's channels.
        bits: of the converter; values are stored in 16 bits, or in 8 where it has 8.
        full_well_e: electrons at the white level.
        read_noise_e: standard deviation in electrons.
        sensitivity: white levels per second that a raw value of 1 gives.
    """

    matrix: Floats
    distortion: Floats
    size: tuple[int, int]
    from_xyz: Floats = field(default_factory=lambda: CAMERA_FROM_XYZ)
    bits: int = 14
    full_well_e: float = 40_000.0
    read_noise_e: float = 4.0
    sensitivity: float = 10.0

    def project(self, points: Floats) -> Floats:
        """`[N, 2]` pixels at which points `[N, 3]` of the camera's frame appear."""
        return self.bent(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2])

    def bent(self, x: Floats, y: Floats) -> Floats:
        """`[N, 2]` pixels of the directions (x, y, 1).

        x″ = x(1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 xy + p2 (r² + 2x²), and y″ alike.
        """
        k1, k2, p1, p2, k3 = self.distortion
        rr = x * x + y * y
        radial = 1 + rr * (k1 + rr * (k2 + rr * k3))
        bent_x = x * radial + 2 * p1 * x * y + p2 * (rr + 2 * x * x)
        bent_y = y * radial + p1 * (rr + 2 * y * y) + 2 * p2 * x * y
        return np.stack([bent_x, bent_y, np.ones_like(x)], -1) @ self.matrix[:2].T

    def field_of_view(self) -> tuple[float, float]:
        """Half the width and height that a pinhole without distortion has to see at distance 1, so
        that it sees what the lens bends into the picture, and two pixels more."""
        import cv2

        height, width = self.size
        x, y = np.linspace(-2.5, width + 1.5, 60), np.linspace(-2.5, height + 1.5, 60)
        edge = np.concatenate(
            [np.stack(np.broadcast_arrays(x, v), -1) for v in (y[0], y[-1])]
            + [np.stack(np.broadcast_arrays(v, y), -1) for v in (x[0], x[-1])]
        )
        straight = cv2.undistortPoints(edge[:, None], self.matrix, self.distortion)
        across, down = np.abs(np.asarray(straight).reshape(-1, 2)).max(axis=0)
        return float(across), float(down)

    def photograph(
        self, raw: Floats, seconds: float, rng: np.random.Generator
    ) -> NDArray[np.uint16] | NDArray[np.uint8]:
        """What the sensor stores of `[H, W, 3]` raw values: shot noise, read noise, rounding, and
        nothing above the white level. Values fill the file's range, as raw converters write them.
        """
        electrons = np.clip(raw * seconds * self.sensitivity * self.full_well_e, 0, 1e9)
        counted = rng.poisson(electrons) + self.read_noise_e * rng.normal(size=raw.shape)
        top = 2**self.bits - 1
        level = np.clip(np.rint(counted / self.full_well_e * top), 0, top)
        if self.bits <= 8:
            return np.asarray(level * (255 // top), np.uint8)
        return np.rint(level * (65535 / top)).astype(np.uint16)
