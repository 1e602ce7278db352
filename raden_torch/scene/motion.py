"""Where lamps, camera and object are in a frame."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

from raden_torch.artwork.room import room
from raden_torch.brdf.files.environment_file import load_environment
from raden_torch.brdf.shading.area_lights import RectangleLight
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.lights import DirectionalLight, Light, PointLight
from raden_torch.scene.camera import Camera, Place
from raden_torch.scene.scene_file import (
    CameraTable,
    EnvironmentTable,
    LightsTable,
    ObjectTable,
    PointTable,
)


def turned(place: Place, centre: Place, angle_deg: float) -> Place:
    """A place, turned about the vertical through a centre, counter-clockwise from above."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    x, z = place[0] - centre[0], place[2] - centre[2]
    return centre[0] + c * x + s * z, place[1], centre[2] + c * z - s * x


def angle_at(table: CameraTable | ObjectTable, time: float) -> float:
    """Degrees at a time 0…1 of an animation."""
    return table.turn_deg * time + table.swing_deg * math.sin(2 * math.pi * time)


def camera_at(table: CameraTable, size: tuple[int, int], time: float, object_deg: float) -> Camera:
    """The camera as the object sees it that has turned by `object_deg`."""
    position = turned(table.position, table.target, angle_at(table, time))
    place, target = (turned(p, (0.0, 0.0, 0.0), -object_deg) for p in (position, table.target))
    return Camera(place, target, table.fov_deg, size)


def lamps_at(
    lights: LightsTable, frame: int, time: float, object_deg: float
) -> tuple[list[Light], list[Light]]:
    """Lamps that stand still, and those that move; as the object sees them."""
    origin = (0.0, 0.0, 0.0)

    def seen(place: Place) -> Place:
        return turned(place, origin, -object_deg)

    still: list[Light] = [
        DirectionalLight(seen(d.direction), d.irradiance) for d in lights.directional
    ]
    still += [
        RectangleLight(seen(r.position), seen(r.across), seen(r.up), r.radiance)
        for r in lights.rectangle
    ]
    moving: list[Light] = []
    for lamp in lights.point:
        where = moving if lamp.orbit or lamp.keyframes else still
        where.append(PointLight(seen(place_of(lamp, frame, time)), lamp.intensity))
    return still, moving


def place_of(lamp: PointTable, frame: int, time: float) -> Place:
    """Where a lamp is: at its keyframes, or where its circle has brought it."""
    if lamp.keyframes:
        keys = sorted(lamp.keyframes, key=lambda key: key.frame)
        for one, two in pairwise(keys):
            if one.frame <= frame <= two.frame:
                share = (frame - one.frame) / max(two.frame - one.frame, 1)
                x, y, z = (a + share * (b - a) for a, b in zip(one.position, two.position,
                                                               strict=True))  # fmt: skip
                return x, y, z
        return (keys[0] if frame < keys[0].frame else keys[-1]).position
    if lamp.orbit:
        return turned(lamp.position, lamp.orbit.centre, 360 * lamp.orbit.turns * time)
    return lamp.position


def environment_of(table: EnvironmentTable, folder: Path) -> EnvironmentLight:
    """The surroundings as they are in the first frame."""
    if table.file is None:
        return EnvironmentLight(room(), table.rotation_deg, table.intensity)
    return load_environment(
        folder / table.file, rotation_deg=table.rotation_deg, intensity=table.intensity
    )
