"""One view of a scene, lit by one lamp after another: Mitsuba's rays, our lens.

Mitsuba renders a picture without distortion, several points a pixel. `Camera.bent` puts each point
at its place behind the lens, and a pixel is the mean of the points around it, weighted by a tent of
one pixel's half-width: exact distortion, nothing interpolated.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.materials import Material
from raden_torch.capture.photo.simulation.mitsuba_scene import Ball, Lamp, chrome, matt, sphere
from raden_torch.capture.photo.simulation.sensor_pass import DARK_ROOM_MM, Frame, SensorPass
from raden_torch.capture.photo.simulation.simulated_camera import Camera, View

SPECIMEN = "specimen"
"""The name of the specimen among a scene's things."""
_FINE = 8
"""Points along a pixel's edge where a chrome ball shows a lamp."""


class Studio:
    """A scene before the camera in one place.

    Args:
        mi: Mitsuba in its variant.
        things: shapes in Mitsuba's words, by name; without lamps and chrome balls. The specimen is
            among them, with any BSDF.
        balls: the chrome balls, by name.
        material: of the specimen, or None where there is none.
        points: along a pixel's edge.
    """

    def __init__(
        self,
        mi: Any,
        things: Mapping[str, Any],
        balls: Mapping[str, Ball],
        material: Material | None,
        camera: Camera,
        view: View,
        *,
        points: int = 2,
    ) -> None:
        self._camera, self._view = camera, view
        # where Mitsuba would ask Python for every point, it lights a white specimen, and `radiance`
        # turns the light that falls on it into the specimen's
        scalar = str(mi.variant()).startswith("scalar")
        self._table = material.table if material is not None and scalar else None
        shown = dict(things)
        if material is not None:
            bsdf = material.bsdf(mi) if self._table is None else matt(1.0)
            shown[SPECIMEN] = dict(shown[SPECIMEN]) | {"bsdf": bsdf}
        room = {"type": "sphere", "radius": DARK_ROOM_MM, "flip_normals": True}
        shown = {"room": room | {"bsdf": matt(0.0)}} | shown
        whole = self._frame(points)
        black = {name: sphere(ball, matt(0.0)) for name, ball in balls.items()}
        self._passes = [SensorPass(mi, shown | black, view, whole)]
        mirrors = {name: sphere(ball, chrome()) for name, ball in balls.items()}
        self._passes += [
            SensorPass(mi, shown | mirrors, view, self._window(ball), mirrors=True)
            for ball in balls.values()
        ]
        self._keep = self._points_kept(tuple(balls))

    def radiance(self, lamp: Lamp) -> Floats:
        """`[N, 3]` of all points, in the simulation's channels; a white that faces an irradiance of
        π has 1."""
        parts = [p.radiance(lamp)[keep] for p, keep in zip(self._passes, self._keep, strict=True)]
        if self._table is not None:
            light, view = self._local(lamp)
            parts[0][self._specimen] *= np.pi * self._table.at(light, view)
        return np.concatenate(parts)

    def raw(self, lamp: Lamp) -> Floats:
        """`[H, W, 3]` what falls on the sensor, in the camera's raw RGB."""
        return self.picture(self.radiance(lamp) @ self._camera.from_xyz.T)

    def picture(self, values: Floats) -> Floats:
        """`[H, W, ...]` of values `[N, ...]` of all points, through the lens."""
        flat = self._weights @ values.reshape(len(values), -1)
        return np.asarray(flat).reshape(*self._camera.size, *values.shape[1:])

    def mask(self, name: str) -> Floats:
        """`[H, W]` the share of each pixel that a thing or a ball covers."""
        on = [p.on(name)[keep] for p, keep in zip(self._passes, self._keep, strict=True)]
        return self.picture(np.concatenate(on).astype(float))

    def normals(self) -> Floats:
        """`[H, W, 3]` of the specimen in the world's frame, 0 elsewhere; unit where it is whole."""
        on = [p.on(SPECIMEN)[keep] for p, keep in zip(self._passes, self._keep, strict=True)]
        normal = [p.hits[1][keep] for p, keep in zip(self._passes, self._keep, strict=True)]
        mean = self.picture(np.concatenate(normal) * np.concatenate(on)[:, None])
        length = np.linalg.norm(mean, axis=-1, keepdims=True)
        return np.asarray(mean / np.maximum(length, 1e-12))

    def _points_kept(self, balls: tuple[str, ...]) -> list[NDArray[np.bool_]]:
        """Which points of each pass count: the chrome balls are their own passes' matter."""
        first = self._passes[0]
        plain = np.ones(first.count, bool)
        for name in balls:
            plain &= ~first.on(name)
        return [plain, *(p.on(name) for p, name in zip(self._passes[1:], balls, strict=True))]

    @cached_property
    def _specimen(self) -> NDArray[np.bool_]:
        return self._passes[0].on(SPECIMEN)[self._keep[0]]

    def _local(self, lamp: Lamp) -> tuple[Floats, Floats]:
        """Directions `[M, 3]` to the lamp and the camera from the specimen's points, each in a
        frame with its normal as z."""
        hit, normal, _ = self._passes[0].hits
        on = np.flatnonzero(self._keep[0])[self._specimen]
        position, n = hit[on], normal[on]
        helper = np.where(np.abs(n[:, :1]) < 0.7, [[1.0, 0, 0]], [[0.0, 1, 0]])
        x = np.cross(helper, n)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        frame = np.stack([x, np.cross(n, x), n], 1)
        ways = [target - position for target in (lamp.position_mm, self._view.position_mm)]
        light, view = (
            (frame @ (way / np.linalg.norm(way, axis=1, keepdims=True))[..., None])[..., 0]
            for way in ways
        )
        return light, view

    @cached_property
    def _weights(self) -> Any:
        """Sparse `[H W, N]`: the tent's weights, the sum of each row being 1."""
        from scipy.sparse import csr_array, diags_array

        height, width = self._camera.size
        at, area = [], []
        for one, keep in zip(self._passes, self._keep, strict=True):
            x, y = (v[keep] for v in one.frame.directions())
            at.append(self._camera.bent(x, y))
            area.append(np.full(len(x), 1 / one.frame.points**2))
        pixel, share = np.concatenate(at), np.concatenate(area)
        low = np.floor(pixel)
        rows, columns, weights = [], [], []
        for dx, dy in itertools.product((0, 1), (0, 1)):
            x, y = low[:, 0] + dx, low[:, 1] + dy
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            tent = (1 - np.abs(pixel[:, 0] - x)) * (1 - np.abs(pixel[:, 1] - y))
            rows.append((y * width + x)[inside].astype(np.int64))
            columns.append(np.flatnonzero(inside))
            weights.append((tent * share)[inside])
        place = np.concatenate(rows), np.concatenate(columns)
        spread = csr_array((np.concatenate(weights), place), shape=(height * width, len(pixel)))
        total = np.asarray(spread.sum(axis=1)).ravel()
        return csr_array(diags_array(1 / np.maximum(total, 1e-12)) @ spread)

    def _frame(self, points: int) -> Frame:
        """All that the lens bends into the picture, at the lens's scale."""
        across, down = self._camera.field_of_view()
        focal = float(np.mean(np.diag(self._camera.matrix)[:2]))
        width, height = (int(np.ceil(2 * half * focal)) for half in (across, down))
        return Frame((across, across * height / width), (width, height), (0, 0, width, height),
                     points)  # fmt: skip

    def _window(self, ball: Ball) -> Frame:
        """The part of the picture that holds a ball."""
        whole = self._frame(_FINE)
        x, y, z = self._view.of_points(np.array([ball.centre_mm]))[0]
        corners = []
        for middle, half, size in zip((x / z, y / z), whole.half, whole.size, strict=True):
            centre = (middle / half + 1) / 2 * size
            radius = 1.1 * ball.radius_mm / z * size / (2 * half) + 2
            first = min(max(0, int(centre - radius)), size - 1)
            corners.append((first, max(1, min(size, int(centre + radius)) - first)))
        (left, width), (top, height) = corners
        return Frame(whole.half, whole.size, (left, top, width, height), _FINE)
