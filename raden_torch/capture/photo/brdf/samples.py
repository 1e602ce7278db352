"""One photograph → samples: angles and reflectance of each lit pixel of the sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.sample import SampleInPhotograph
from raden_torch.capture.photo.brdf.sample_shapes import Surface
from raden_torch.capture.photo.brdf.series import Frame
from raden_torch.capture.photo.camera import Camera

LEAST_COSINE = 0.09
"""Of the lamp's and the view's angle with the normal: about 85 degrees. Beyond, the irradiance and
the place of the pixel are as good as unknown."""
_TILE = 1 << 18


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """What the sample's pixels see, the same for all photographs with the same pose.

    Attributes:
        x_px, y_px: `[P]` columns and rows.
        surface: points and normals.
        view: `[P, 3]` unit directions to the viewer.
        middle: `[3]` where the lamps' intensities hold.
    """

    x_px: NDArray[np.intp]
    y_px: NDArray[np.intp]
    surface: Surface
    view: Floats
    middle: Floats


def see(placed: SampleInPhotograph, camera: Camera | None) -> SeenSurface:
    """The sample's pixels that look at it at less than about 85 degrees."""
    rays = rays_through(camera, placed.x_px, placed.y_px)
    surface = placed.shape.seen(rays)
    facing = -(surface.normal * rays.direction).sum(1)
    good = facing > LEAST_COSINE
    return SeenSurface(
        placed.x_px[good],
        placed.y_px[good],
        Surface(surface.point[good], surface.normal[good]),
        -rays.direction[good],
        placed.shape.middle,
    )


def samples(
    frame: Frame, seen: SeenSurface, lamp: Lamp, white_rgb: Floats
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Tiles of lit and usable pixels: `[n, 3]` incidence, receiving and tilt in degrees, and
    `[n, 3]` camera RGB relative to the white in the same geometry.

    f_r ∝ signal / (cos θi (d_middle/d)²), the white's signal being that for θi = 0 at the middle.
    """
    for start in range(0, len(seen.x_px), _TILE):
        part = slice(start, start + _TILE)
        x, y = seen.x_px[part], seen.y_px[part]
        normal = seen.surface.normal[part]
        light, falloff = lamp.at(seen.surface.point[part], seen.middle)
        cosine = (light * normal).sum(1)
        good = (cosine > LEAST_COSINE) & frame.usable[y, x]
        if not good.any():
            continue
        angles = angles_deg(normal[good], light[good], seen.view[part][good])
        irradiance = cosine[good] * falloff[good]
        value = frame.radiance[y[good], x[good]] / (irradiance[:, None] * white_rgb)
        yield angles, value.astype(np.float32)
