"""How samples move in their cells, and what lights them, when a lamp or the sample is elsewhere.

Nothing is taken to be small but the move itself: the chosen samples' pixels are looked at again
with the lamp, or the shape, where it would be. A sample of value f(place) · light, taken for one at
`place`, is wrong by grad f · Δplace + f · Δlight / light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats, Floats32, Ints
from raden_torch.capture.photo.brdf.lighting import LEAN_DEG, Lamp
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.brdf.photo_cells import TERMS, CellGrid
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries
from raden_torch.capture.photo.brdf.rays import Rays, rays_through
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample_shapes import Shape


@dataclass(frozen=True, eq=False)
class Moves:
    """Of n samples: `place` `[n, 3]` in steps of the grid, `light` `[n]` relative."""

    place: Floats32
    light: Floats32

    @classmethod
    def of_light(cls, count: int) -> Moves:
        """Twice as much light, everywhere."""
        return cls(np.zeros((count, 3), np.float32), np.ones(count, np.float32))

    def brighter(self, share: float) -> Moves:
        """With so much more light, everywhere."""
        return Moves(self.place, self.light + np.float32(share))

    def change(
        self, coefficients: NDArray[np.floating[Any]], x: Floats32
    ) -> NDArray[np.floating[Any]]:
        """`[n, 3]`: what the samples' values are wrong by.

        Args:
            coefficients: `[n, 10, 3]` of their cells.
            x: `[n, 3]` their places.
        """
        a, r, t = x.T
        p, q, s = self.place.T
        zero = np.zeros_like(a)
        squares = 2 * a * p, 2 * r * q, 2 * t * s
        products = r * s + t * q, a * s + t * p, a * q + r * p
        by_place = np.stack([zero, p, q, s, *squares, *products], axis=1)
        terms = np.stack([zero + 1, a, r, t, a * a, r * r, t * t, r * t, a * t, a * r], axis=1)
        assert terms.shape[1] == TERMS
        return np.asarray(
            np.einsum("nk,nkc->nc", by_place + self.light[:, None] * terms, coefficients)
        )


@dataclass(frozen=True, eq=False)
class ShotSamples:
    """The samples of one shot that a reservoir kept.

    Attributes:
        number: of the shot.
        rows: `[n]` of the reservoir.
        rays: of their pixels.
        shape: of the sample.
        lamp: of the shot.
        angles: `[n, 3]` degrees, as the sample was taken.
        light: `[n]` irradiance.
        sign: `[n, 1]` −1 where the sample stands in the cell of the equivalent geometry (−a, −r,
            −t).
    """

    number: int
    rows: Ints
    rays: Rays
    shape: Shape
    lamp: Lamp
    angles: Floats32
    light: Floats
    sign: Floats32

    def seen_under(self, lamp: Lamp) -> tuple[Floats32, Floats]:
        """Angles `[n, 3]` in degrees and irradiance `[n]`, if the lamp stood there."""
        return _seen(self.rays, self.shape, lamp, self.shape.middle)

    def under(self, lamp: Lamp, step_deg: float) -> Moves:
        """If the lamp stood there."""
        return self._moves(*_seen(self.rays, self.shape, lamp, self.shape.middle), step_deg)

    def on(self, shape: Shape, step_deg: float) -> Moves:
        """If the sample were of that shape, the lamp's brightness at its middle as it is."""
        return self._moves(*_seen(self.rays, shape, self.lamp, self.shape.middle), step_deg)

    def carried(self, shape: Shape, lamp: Lamp, step_deg: float) -> Moves:
        """If sample and lamp stood there, the lamp as bright at the sample's middle there."""
        return self._moves(*_seen(self.rays, shape, lamp, shape.middle), step_deg)

    def leans(self, step_deg: float) -> list[Moves]:
        """Two: a degree of the lamp along each of its `across`."""
        found = []
        for along in np.eye(2):
            there, back = (
                self.under(self.lamp.turned(s * LEAN_DEG * along, self.shape.middle), step_deg)
                for s in (1, -1)
            )
            scale = np.float32(1 / (2 * LEAN_DEG))
            found.append(
                Moves((there.place - back.place) * scale, (there.light - back.light) * scale)
            )
        return found

    def _moves(self, angles: Floats32, light: Floats, step_deg: float) -> Moves:
        # at incidence 0 the angles of a sample may turn their signs
        straight, turned = angles - self.angles, -angles - self.angles
        other = (turned**2).sum(1) < (straight**2).sum(1)
        place = np.where(other[:, None], turned, straight) * self.sign / np.float32(step_deg)
        relative = light / self.light - 1
        known = np.isfinite(place).all(1) & np.isfinite(relative)
        return Moves(
            np.where(known[:, None], place, 0).astype(np.float32),
            np.where(known, relative, 0).astype(np.float32),
        )


class SamplesByShot:
    """The samples that were kept, shot by shot.

    Args:
        kept: chosen samples; their pixels tell what they saw.
        shapes: the sample's in the frame of each shot's camera.
    """

    def __init__(
        self, kept: Reservoir, series: PhotoSeries, shapes: list[Shape], grid: CellGrid
    ) -> None:
        self._kept, self._series, self._shapes, self._grid = kept, series, shapes, grid
        self._order = np.argsort(kept.shot, kind="stable")
        self._ends = np.searchsorted(kept.shot[self._order], np.arange(len(shapes) + 1))
        self._nodes = (grid.nodes_deg() / grid.step_deg).astype(np.float32)

    def __len__(self) -> int:
        return len(self._shapes)

    def of(self, number: int, at_most: int | None = None) -> ShotSamples:
        """Those of one shot, or so many of them, of every cell alike."""
        rows = self._order[self._ends[number] : self._ends[number + 1]]
        if at_most is not None:
            rows = rows[:: max(1, -(-len(rows) // at_most))]
        pixel, width = self._kept.pixel[rows], self._series.size[1]
        rays = rays_through(self._series.camera, pixel % width, pixel // width)
        shape, lamp = self._shapes[number], self._series.lamps[number]
        angles, light = _seen(rays, shape, lamp, shape.middle)
        place = self._nodes[self._kept.cell[rows]] + self._kept.x[rows]
        apart = [((s * angles / self._grid.step_deg - place) ** 2).sum(1) for s in (1, -1)]
        sign = np.where(apart[1] < apart[0], np.float32(-1), np.float32(1))[:, None]
        return ShotSamples(number, rows, rays, shape, lamp, angles, light, sign)


def _seen(rays: Rays, shape: Shape, lamp: Lamp, middle: Floats) -> tuple[Floats32, Floats]:
    """Angles `[n, 3]` in degrees, and the irradiance `[n]`."""
    surface = shape.seen(rays)
    light, falloff = lamp.at(surface.point, middle)
    cosine = (light * surface.normal).sum(1)
    return angles_deg(surface.normal, light, -rays.direction), cosine * falloff
