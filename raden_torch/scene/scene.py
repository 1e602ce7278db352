"""A scene, ready to be rendered frame by frame."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import msgspec
import torch
from torch import Tensor

from raden_torch.artwork.box import Box
from raden_torch.brdf.files.display import Display
from raden_torch.brdf.files.gbuffer_file import read_gbuffer
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.errors import InputError
from raden_torch.scene.camera import Camera, Place, View
from raden_torch.scene.coverings import MaterialNames
from raden_torch.scene.dressing import Dressing
from raden_torch.scene.layers import (
    ARTWORK_SHELLS,
    artwork_dressing,
    layered,
    plain_dressing,
    texel_for,
)
from raden_torch.scene.motion import angle_at, camera_at, environment_of, lamps_at
from raden_torch.scene.scene_file import SceneTable, files_of, read_scene
from raden_torch.scene.seen import Seen, of_gbuffer
from raden_torch.scene.table import LitTable, Table


class Scene:
    """A scene file's contents, checked; maps and materials are made when a frame needs them.

    Args:
        table: what the file says.
        folder: where its relative paths start.
        name: of the file, for messages.

    Raises:
        InputError: a material, a file or a light that is missing, or what contradicts itself.
    """

    def __init__(self, table: SceneTable, folder: Path, name: str = "scene") -> None:
        self.table, self.folder, self.name = table, folder, name
        self._names = MaterialNames(table.materials, folder, name)
        self._check()
        self._seen: tuple[object, Seen] | None = None
        self._still: tuple[object, Tensor] | None = None
        self._around: tuple[object, EnvironmentLight] | None = None

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        *,
        width: int | None = None,
        samples: int | None = None,
    ) -> Scene:
        """Of a file.

        Args:
            width: of the picture, in place of the file's; its height keeps the proportion.
            samples: in place of the file's.
        """
        table = read_scene(path)
        picture = table.picture
        if width is not None:
            height = max(1, round(picture.size[1] * width / picture.size[0]))
            picture = msgspec.structs.replace(picture, size=(width, height))
        if samples is not None:
            picture = msgspec.structs.replace(picture, samples=samples)
        table = msgspec.structs.replace(table, picture=picture)
        if not all(1 <= side <= 16384 for side in picture.size):
            raise InputError(f"size: expected 1…16384 pixels a side, got {picture.size}")
        if not 1 <= picture.samples <= 16:
            raise InputError(f"samples: expected 1…16, got {picture.samples}")
        return cls(table, Path(path).parent, str(path))

    def resized(self, size: tuple[int, int], samples: int | None = None) -> Scene:
        """The same in another size, width and height, with the maps that this one has made."""
        samples = self.table.picture.samples if samples is None else samples
        picture = msgspec.structs.replace(self.table.picture, size=size, samples=samples)
        table = msgspec.structs.replace(self.table, picture=picture)
        other = Scene(table, self.folder, self.name)
        other.__dict__["_dressing"] = self._dressing
        return other

    @property
    def display(self) -> Display:
        shown = self.table.display
        return Display(shown.exposure, shown.tone, shown.gamut, shown.colour_space)

    @property
    def caption(self) -> str | None:
        """What pictures of it have to say: which shells are simulated."""
        shown = {c.name for c in self._dressing.coverings}
        found = [self._names.of(name).simulated for name in sorted(shown)]
        names = [name for name in found if name]
        kind = "specimens" if len(names) > 1 else "specimen"
        return f"simulated {kind}: {', '.join(names)}" if names else None

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height."""
        if self.table.object.gbuffer is None:
            return self.table.picture.size
        height, width = self._gbuffer.normal.shape[-2:]
        return width, height

    @property
    def files(self) -> list[Path]:
        """What it reads."""
        return files_of(self.table, self.folder)

    @torch.no_grad()
    def frame(self, number: int = 1) -> Tensor:
        """`[1, 3, H, W]` scene-linear RGB of a frame, the first of which is 1."""
        frames = self.table.animation.frames
        time = (number - 1) / frames
        turn = angle_at(self.table.object, time)
        still, moving = lamps_at(self.table.lights, number, time, turn)
        around = self._environment(time, turn)
        seen = self._look(time, turn)
        lights = [*still, *([around] if around is not None else [])]
        key = (id(seen), tuple(still), id(around))
        if self._still is None or self._still[0] != key:
            self._still = key, self._light(seen, lights)
        image = self._still[1]
        return image + self._light(seen, moving) if moving else image.clone()

    def _light(self, seen: Seen, lights: list[Light]) -> Tensor:
        table = None if self._table is None else LitTable(self._table, self._box, lights)
        return seen.image(lights, table)

    @cached_property
    def _table(self) -> Table | None:
        given = self.table.object
        if given.gbuffer is not None or not isinstance(given.table, tuple):
            return None
        return Table(given.table, given.table_roughness)

    def _environment(self, time: float, turn: float) -> EnvironmentLight | None:
        described = self.table.lights.environment
        if described is None:
            return None
        rotation = described.rotation_deg + described.turn_deg * time - turn
        if self._around is None or self._around[0] != rotation:
            light = replace(self._room, rotation_deg=rotation)
            self._around = rotation, light
        return self._around[1]

    @cached_property
    def _room(self) -> EnvironmentLight:
        described = self.table.lights.environment
        assert described is not None
        light = environment_of(described, self.folder)
        return light if self._table is None else self._table.under(light)

    @cached_property
    def _box(self) -> Box:
        table = self.table.object
        x, y, z = table.size
        return Box((x / 2, y, z / 2), table.rounding, table.dome)

    @cached_property
    def _dressing(self) -> Dressing:
        table = self.table.object
        if table.gbuffer is not None:
            height, width = self._gbuffer.normal.shape[-2:]
            plain = plain_dressing(table, self._names)
            return layered(plain, self.table.layers, self.folder, self._names, (width, height))
        if self._artwork == "makie":
            assert self.table.camera is not None
            away = math.dist(self.table.camera.position, (0.0, self._box.height / 2, 0.0))
            nearest = max(away - 0.6 * max(self._box.half), 0.2 * away)
            texel = texel_for(self._box, nearest, self._pixel)
            dressing = artwork_dressing(table, self._box, texel, self._names)
        else:
            dressing = plain_dressing(table, self._names)
        return layered(dressing, self.table.layers, self.folder, self._names)

    @property
    def _artwork(self) -> str:
        """None is: the built-in one, unless there are layers."""
        return self.table.object.artwork or ("none" if self.table.layers else "makie")

    @property
    def _pixel(self) -> float:
        """The angle that a pixel spans."""
        assert self.table.camera is not None
        half = math.tan(math.radians(self.table.camera.fov_deg) / 2)
        return 2 * half / self.table.picture.size[0]

    @cached_property
    def _gbuffer(self) -> GBuffer:
        table = self.table.object
        assert table.gbuffer is not None
        return read_gbuffer(self.folder / table.gbuffer, fov_deg=table.fov_deg)

    def _look(self, time: float, turn: float) -> Seen:
        """What the camera sees, kept while it does not move."""
        if self.table.object.gbuffer is not None:
            if self._seen is None:
                self._seen = None, of_gbuffer(self._gbuffer, self._dressing)
            return self._seen[1]
        assert self.table.camera is not None
        picture = self.table.picture
        camera = camera_at(self.table.camera, picture.size, time, turn)
        if self._seen is None or self._seen[0] != camera:
            view = View(camera, picture.samples, self._pixel)
            self._seen = camera, Seen.of(self._dressing, self._box, view, self._table)
        return self._seen[1]

    def _check(self) -> None:
        table = self.table
        lights = table.lights
        if not (lights.environment or lights.directional or lights.point or lights.rectangle):
            raise InputError(
                f"{self.name}: lights: expected at least one, as [lights.environment] or "
                "[[lights.directional]], got none"
            )
        if (
            lights.environment is not None
            and lights.environment.file
            and lights.environment.builtin
        ):
            raise InputError(f"{self.name}: lights.environment: expected file or builtin, got both")
        if table.object.gbuffer is None and table.camera is None:
            raise InputError(f"{self.name}: camera: expected a table with position, got none")
        if table.object.gbuffer is None and table.camera is not None:
            Camera(table.camera.position, table.camera.target, table.camera.fov_deg, (1, 1))
            self._check_eye(table.camera.position)
        shells = ARTWORK_SHELLS if self._artwork == "makie" and not table.object.gbuffer else ()
        self._names.check([table.object.ground], "object: ground")
        for place, layer in enumerate(table.layers):
            self._names.check([layer.material], f"layers[{place}]")
        self._names.check(shells, "object: artwork")
        for path in self.files:
            if not path.is_file():
                raise InputError(f"{self.name}: expected a file {path}, got none there")
        for place, lamp in enumerate(lights.point):
            frames = [key.frame for key in lamp.keyframes]
            if len(set(frames)) < len(frames) or (lamp.orbit and frames):
                raise InputError(
                    f"{self.name}: lights.point[{place}]: expected an orbit, or keyframes each of "
                    f"another frame, got {'both' if lamp.orbit else frames}"
                )

    def _check_eye(self, eye: Place) -> None:
        x, y, z = self._box.half
        if not (abs(eye[0]) > x or eye[1] > y or abs(eye[2]) > z) or eye[1] <= 0:
            raise InputError(
                f"{self.name}: camera: position: expected a place above the table and outside of "
                f"the box, got {eye}"
            )
