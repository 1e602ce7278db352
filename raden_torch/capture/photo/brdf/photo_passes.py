"""All photographs, read twice → the value at every node, one photograph in memory at a time.

The first pass chooses samples at random from each cell, reads the white and looks whether the
sample moved; what it chose is fitted robustly (`cell_fit`). The second sums all samples that agree
with that fit (`cell_sums`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.brdf.capture_settings import SampleSpec, WhiteSpec
from raden_torch.capture.photo.brdf.cell_fit import RobustFit
from raden_torch.capture.photo.brdf.cell_sums import CellSums, NodeValues
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.movement import Edges, edges_near, on_board, outline_of
from raden_torch.capture.photo.brdf.photo_cells import CellGrid
from raden_torch.capture.photo.brdf.photo_series import Frame, PhotoSeries, linear_frames
from raden_torch.capture.photo.brdf.photo_white import (
    Scale,
    WhiteFactor,
    WhiteReading,
    read_white,
    scale_of,
)
from raden_torch.capture.photo.brdf.pixel_samples import samples_in_cells
from raden_torch.capture.photo.brdf.rays import rays_through
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample_shapes import Plane, Shape
from raden_torch.capture.photo.brdf.seen_surface import SeenSurface, seen_surfaces
from raden_torch.capture.photo.brdf.shots import Shot
from raden_torch.capture.photo.brdf.white_place import white_place
from raden_torch.errors import InputError


@dataclass(frozen=True, eq=False)
class PhotoView:
    """A photograph that was read: shot `number`, its lamp, its light, and what its pixels see."""

    number: int
    shot: Shot
    lamp: Lamp
    frame: Frame
    seen: SeenSurface


@dataclass(frozen=True, eq=False)
class FirstPass:
    """What the first pass gives.

    Attributes:
        kept: the chosen samples, relative to the white.
        scale: from camera signal to reflectance, for every shot.
        edges: of each shot, near the sample's outline; None where they are not clear.
        shapes: the sample's, in the frame of each shot's camera.
    """

    kept: Reservoir
    scale: Scale
    edges: list[Edges | None]
    shapes: list[Shape]


@dataclass(frozen=True, eq=False)
class AccumulatedCells:
    """What the photographs hold together.

    Attributes:
        nodes: relative to the white, in camera RGB.
        scale: of each shot.
        kept: the chosen samples, relative to the white.
        fit: the robust fit to these.
        shots: `[K, cells]` samples of each shot in each cell.
        samples: how many there were.
        left_out: share of them that the robust fit left out.
    """

    nodes: NodeValues
    scale: Scale
    kept: Reservoir
    fit: RobustFit
    shots: NDArray[np.int32]
    samples: int
    left_out: float


def photo_views(
    series: PhotoSeries, sample: SampleSpec, fixed: SeenSurface | None
) -> Iterator[PhotoView]:
    """The photographs, read one after another, with what their pixels see.

    Args:
        fixed: what `fixed_surface` gave for the sample.

    Raises:
        InputError: as for `linear_frames` and `seen_surfaces`.
    """
    frames, seen = linear_frames(series), seen_surfaces(series, sample, fixed)
    each = zip(series.shots, series.lamps, frames, seen, strict=True)
    for number, (shot, lamp, frame, surface) in enumerate(each):
        yield PhotoView(number, shot, lamp, frame, surface)


def first_pass(
    views: Iterable[PhotoView],
    series: PhotoSeries,
    white: WhiteSpec,
    factor: WhiteFactor,
    grid: CellGrid,
) -> FirstPass:
    """Choose samples from each cell, and read the white and the sample's outline.

    Raises:
        InputError: as for reading; no lit sample at all; no white.
    """
    kept = Reservoir.of(grid.cells)
    whites: list[WhiteReading | None] = []
    edges: list[Edges | None] = []
    shapes: list[Shape] = []
    for view in views:
        shapes.append(view.seen.shape)
        edges.append(_edges_in(view, series))
        whites.append(_white_in(view, series, white, factor))
        # the lamp's own intensity stands for the white, which is known when all were read
        for part in samples_in_cells(view.frame, view.seen, view.lamp, view.lamp.rgb, grid):
            kept.add(part.cell, view.number, part.x, part.y, part.pixel)
    if not len(kept.cell):
        raise InputError(
            f"{series.shots[0].files[0]} … {series.names[-1]}: no lit, unsaturated pixel of the "
            "sample; over-exposed, or lamps behind it? Check the mask and the lights file"
        )
    scale = scale_of(whites, series.lamps, series.names)
    assumed = np.array([lamp.rgb for lamp in series.lamps])
    kept.y *= (assumed / scale.rgb)[kept.shot].astype(np.float32)
    return FirstPass(kept, scale, edges, shapes)


def second_pass(
    views: Iterable[PhotoView],
    first: FirstPass,
    fit: RobustFit,
    grid: CellGrid,
    *,
    amid_samples: bool = False,
) -> AccumulatedCells:
    """Sum the samples that agree with the fit, and find the value at every node.

    Args:
        fit: of the samples that the first pass chose.
        amid_samples: find it amid each cell's samples instead.

    Raises:
        InputError: as for reading.
    """
    scale, sums = first.scale, CellSums(fit)
    per_shot = np.zeros((len(scale.rgb), grid.cells), np.int32)
    for view in views:
        white_rgb = scale.rgb[view.number]
        for part in samples_in_cells(view.frame, view.seen, view.lamp, white_rgb, grid):
            sums.add(part.cell, part.x, part.y)
            counted = np.bincount(part.cell, minlength=grid.cells)
            per_shot[view.number] += counted.astype(np.int32)
    return AccumulatedCells(
        nodes=sums.nodes(grid, amid_samples=amid_samples),
        scale=scale,
        kept=first.kept,
        fit=fit,
        shots=per_shot,
        samples=int(per_shot.sum()),
        left_out=1 - float(sums.count.sum()) / max(int(sums.seen.sum()), 1),
    )


def _edges_in(view: PhotoView, series: PhotoSeries) -> Edges | None:
    """Near the sample's outline; of a flat piece on the board in its own place there."""
    found = edges_near(view.frame.radiance, outline_of(view.seen, series.size))
    shape, pose, camera = view.seen.shape, view.shot.pose, series.camera
    if found is None or pose is None or camera is None or not isinstance(shape, Plane):
        return found
    return on_board(found, shape, camera, pose)


def _white_in(
    view: PhotoView, series: PhotoSeries, white: WhiteSpec, factor: WhiteFactor
) -> WhiteReading | None:
    middle, shot = view.seen.middle, view.shot
    place = white_place(white, series.camera, shot.pose, series.size, middle, shot.name)
    rays = rays_through(series.camera, place.x_px, place.y_px)
    return read_white(view.frame, place, rays, view.lamp, middle, factor)
