"""What each pixel sees of the sample: a point, its normal, and the direction to the viewer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.capture_settings import SampleSpec
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries, linear_frames
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.sample_placement import SampleInPhotograph, place_sample
from raden_torch.capture.photo.brdf.sample_shapes import Shape, Surface
from raden_torch.capture.photo.brdf.shots import Shot
from raden_torch.capture.photo.camera import Camera

LEAST_COSINE = 0.09
"""Of the lamp's and the view's angle with the normal: about 85 degrees. Beyond, the irradiance and
the place of the pixel are as good as unknown."""


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """What the sample's pixels see, the same for all photographs with the same pose.

    Attributes:
        shape: of the sample, in the frame of the photograph's camera.
        x_px, y_px: `[P]` columns and rows.
        surface: points and normals.
        view: `[P, 3]` unit directions to the viewer.
        outline_px: standard deviation of the outline that the shape was found by.
    """

    shape: Shape
    x_px: NDArray[np.intp]
    y_px: NDArray[np.intp]
    surface: Surface
    view: Floats
    outline_px: float

    @property
    def middle(self) -> Floats:
        """`[3]` where the lamps' intensities hold."""
        return self.shape.middle


def seen_surface(placed: SampleInPhotograph, camera: Camera | None) -> SeenSurface:
    """The sample's pixels that look at it at less than about 85 degrees."""
    rays = rays_through(camera, placed.x_px, placed.y_px)
    surface = placed.shape.seen(rays)
    facing = -(surface.normal * rays.direction).sum(1)
    good = facing > LEAST_COSINE
    return SeenSurface(
        placed.shape,
        placed.x_px[good],
        placed.y_px[good],
        Surface(surface.point[good], surface.normal[good]),
        -rays.direction[good],
        placed.outline_px,
    )


def fixed_surface(series: PhotoSeries, sample: SampleSpec) -> SeenSurface | None:
    """What the pixels see where nothing moves; None where the sample is found by the board's pose.

    Reads the photographs where the sample has to be searched for.

    Raises:
        InputError: as for `place_sample`.
    """
    return None if sample.lies_on_board else _seen_in(series, sample, series.shots[0])


def seen_surfaces(
    series: PhotoSeries, sample: SampleSpec, fixed: SeenSurface | None
) -> Iterator[SeenSurface]:
    """What the pixels of each shot see; one in memory at a time.

    Args:
        fixed: what `fixed_surface` gave.

    Raises:
        InputError: as for `place_sample`.
    """
    seen, pose = fixed, None
    for shot in series.shots:
        if seen is None or (fixed is None and shot.pose is not pose):
            seen, pose = _seen_in(series, sample, shot), shot.pose
        yield seen


def outline_std_px(fixed: SeenSurface | None, stated: float | None) -> float:
    """Of the outline that the sample's shape hangs on: as stated, or as its edge tells. On the
    board nothing hangs on it."""
    if fixed is None:
        return 0.0
    return fixed.outline_px if stated is None else stated


def normal_std_deg(fixed: SeenSurface | None, outline_px: float) -> float:
    """Of the normals, by the outline's standard deviation over its radius in the picture."""
    if fixed is None:
        return 0.0
    across = min(np.ptp(fixed.x_px), np.ptp(fixed.y_px)) / 2
    return float(np.degrees(outline_px / max(across, 1.0)))


def _seen_in(series: PhotoSeries, sample: SampleSpec, shot: Shot) -> SeenSurface:
    pictures = (frame.radiance for frame in linear_frames(series))
    placed = place_sample(sample, series.camera, shot.pose, series.size, pictures, shot.name)
    return seen_surface(placed, series.camera)
