"""One photograph → samples: angles and reflectance of each lit pixel, sorted into cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Floats32, Ints
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_series import Frame
from raden_torch.capture.photo.brdf.seen_surface import LEAST_COSINE, SeenSurface

_TILE = 1 << 18
"""Pixels that are worked on at once."""


@dataclass(frozen=True, eq=False)
class CellSamples:
    """Samples in the cells of a grid; see `photo_cells`.

    Attributes:
        cell: `[n]`.
        x: `[n, 3]` place in the cell, in steps.
        y: `[n, 3]` camera RGB relative to the white in the same geometry.
        pixel: `[n]` where in the photograph, counted row by row.
    """

    cell: Ints
    x: Floats32
    y: Floats32
    pixel: Ints


def samples(
    frame: Frame, seen: SeenSurface, lamp: Lamp, white_rgb: Floats
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32], Ints]]:
    """Tiles of lit and usable pixels: `[n, 3]` incidence, receiving and tilt in degrees, `[n, 3]`
    camera RGB relative to the white in the same geometry, and `[n]` pixels, counted row by row.

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
        pixel = y[good] * frame.size[1] + x[good]
        yield angles, value.astype(np.float32), pixel


def samples_in_cells(
    frame: Frame, seen: SeenSurface, lamp: Lamp, white_rgb: Floats, grid: CellGrid
) -> Iterator[CellSamples]:
    """The same tiles, as far as they lie in the grid."""
    for angles, value, pixel in samples(frame, seen, lamp, white_rgb):
        rows, cell, x = grid.sort(angles)
        yield CellSamples(cell, x, value[rows], pixel[rows])
