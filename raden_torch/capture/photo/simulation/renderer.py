"""One view of a scene, lit by one lamp after another: Mitsuba's rays, our lens.

Mitsuba renders a picture without distortion, several points a pixel. `Camera.bent` puts each point
at its place behind the lens, and a pixel is the mean of the points around it, weighted by a tent of
one pixel's half-width: exact distortion, nothing interpolated.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.materials import Material
from raden_torch.capture.photo.simulation.mitsuba_scene import Ball, Lamp, chrome, matt, sphere
from raden_torch.capture.photo.simulation.simulated_camera import Camera, View

SPECIMEN = "specimen"
"""The name of the specimen among a scene's things."""
_DARK_ROOM_MM = 1e6
_FINE = 8
"""Points along a pixel's edge where a chrome ball shows a lamp."""


@dataclass(frozen=True)
class Frame:
    """A part of the picture without distortion: what one of Mitsuba's sensors sees.

    Attributes:
        half: half of the whole picture's width and height at distance 1.
        size: width and height of the whole picture in pixels.
        window: x, y, width and height of the part.
        points: along a pixel's edge.
    """

    half: tuple[float, float]
    size: tuple[int, int]
    window: tuple[int, int, int, int]
    points: int

    def directions(self) -> tuple[Floats, Floats]:
        """x and y of the directions (x, y, 1) of all points, row by row."""
        left, top, width, height = self.window
        x, y = (
            (2 * (first + (np.arange(many * self.points) + 0.5) / self.points) / whole - 1) * half
            for first, many, whole, half in zip(
                (left, top), (width, height), self.size, self.half, strict=True
            )
        )
        return np.tile(x, len(y)), np.repeat(y, len(x))


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
        room = {"type": "sphere", "radius": _DARK_ROOM_MM, "flip_normals": True}
        shown = {"room": room | {"bsdf": matt(0.0)}} | shown
        whole = self._frame(points)
        black = {name: sphere(ball, matt(0.0)) for name, ball in balls.items()}
        self._passes = [_Pass(mi, shown | black, view, whole)]
        mirrors = {name: sphere(ball, chrome()) for name, ball in balls.items()}
        self._passes += [
            _Pass(mi, shown | mirrors, view, self._window(ball), mirrors=True)
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


class _Pass:
    """A scene of Mitsuba's before one sensor, lit by one lamp that moves."""

    def __init__(
        self, mi: Any, shapes: Mapping[str, Any], view: View, frame: Frame, *, mirrors: bool = False
    ) -> None:
        self._mi, self._mirrors, self.frame = mi, mirrors, frame
        white = {"type": "rgb", "value": [1.0, 1.0, 1.0]}
        lamp: dict[str, Any] = {"type": "point", "position": [0, 0, 0], "intensity": white}
        integrator: dict[str, Any] = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
        if mirrors:
            lamp = {"type": "sphere", "emitter": {"type": "area", "radiance": white}}
            integrator = {"type": "path", "max_depth": 3}
        self._scene = mi.load_dict({"type": "scene", **shapes, "lamp": lamp})
        self._lamp = mi.traverse(self._scene)
        self._light = mi.load_dict(integrator)
        self._sensor = mi.load_dict(_sensor(mi, view, frame))
        self._names = tuple(shapes)

    @property
    def count(self) -> int:
        """How many points there are."""
        _, _, width, height = self.frame.window
        return width * height * self.frame.points**2

    @cached_property
    def hits(self) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Positions and normals `[N, 3]` in the world, and numbers of the things `[N]`."""
        aovs = {"type": "aov", "aovs": "p:position,n:sh_normal,s:shape_index"}
        values = self._render(self._mi.load_dict(aovs))
        numbers = _shape_numbers(self._mi, self._scene)
        found = {n: self._names.index(i) for n, i in numbers.items() if i in self._names}
        known = np.full(max(numbers) + 1, -1)
        known[list(found)] = list(found.values())
        return values[:, :3], values[:, 3:6], known[values[:, 6].astype(int)]

    def on(self, name: str) -> NDArray[np.bool_]:
        """`[N]`, whether a point lies on the thing."""
        return np.asarray(self.hits[2] == self._names.index(name))

    def radiance(self, lamp: Lamp) -> Floats:
        """`[N, 3]` under the lamp."""
        mi = self._mi
        if self._mirrors:
            to = mi.ScalarTransform4f().translate(list(lamp.position_mm)).scale(lamp.radius_mm)
            shining = np.array(lamp.intensity) / (np.pi * lamp.radius_mm**2)
            self._lamp["lamp.to_world"] = mi.Transform4f(to.matrix)
            self._lamp["lamp.emitter.radiance.value"] = mi.Color3f(*map(float, shining))
        else:
            self._lamp["lamp.position"] = mi.Point3f(*map(float, lamp.position_mm))
            self._lamp["lamp.intensity.value"] = mi.Color3f(*map(float, lamp.intensity))
        self._lamp.update()
        return self._render(self._light)[:, :3]

    def _render(self, integrator: Any) -> Floats:
        drawn = self._mi.render(
            self._scene, sensor=self._sensor, integrator=integrator, spp=1, seed=0
        )
        values = np.asarray(drawn, np.float64)
        return values.reshape(-1, values.shape[-1])


def _shape_numbers(mi: Any, scene: Any) -> dict[int, str]:
    """What `shape_index` calls each shape: its place in the scene from 1 in the scalar variants,
    its number in Dr.Jit's registry in the others. 0 is a ray that meets nothing."""
    if str(mi.variant()).startswith("scalar"):
        return {k + 1: shape.id() for k, shape in enumerate(scene.shapes())}
    import drjit as dr

    return {
        int(np.asarray(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))).item()): shape.id()
        for shape in scene.shapes()
    }


def _sensor(mi: Any, view: View, frame: Frame) -> dict[str, Any]:
    (width, height), (left, top, across, down), n = frame.size, frame.window, frame.points
    origin = view.position_mm
    to_world = mi.ScalarTransform4f().look_at(
        origin=origin.tolist(),
        target=(origin + view.rotation[2]).tolist(),
        up=(-view.rotation[1]).tolist(),
    )
    film = {
        "type": "hdrfilm",
        "width": n * width,
        "height": n * height,
        "crop_offset_x": n * left,
        "crop_offset_y": n * top,
        "crop_width": n * across,
        "crop_height": n * down,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    return {
        "type": "perspective",
        "fov": float(np.rad2deg(2 * np.arctan(frame.half[0]))),
        "fov_axis": "x",
        "near_clip": 1.0,
        "far_clip": 10 * _DARK_ROOM_MM,
        "to_world": to_world,
        "film": film,
        # one ray through the middle of each of the film's pixels, whose directions are known
        "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
    }
