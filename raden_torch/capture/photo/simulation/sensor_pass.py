"""A part of a view as one of Mitsuba's sensors sees it, lit by one lamp after another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.mitsuba_scene import Lamp
from raden_torch.capture.photo.simulation.simulated_camera import View

DARK_ROOM_MM = 1e6
"""Radius of the black sphere around everything."""


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


class SensorPass:
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
        "far_clip": 10 * DARK_ROOM_MM,
        "to_world": to_world,
        "film": film,
        # one ray through the middle of each of the film's pixels, whose directions are known
        "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
    }
