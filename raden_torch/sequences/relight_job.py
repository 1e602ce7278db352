"""Photographs, frame by frame, relit: their normals are one map, or one a frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from raden_torch.brdf.files.caption import caption_of
from raden_torch.brdf.files.display import AS_IT_IS, Display, key_exposure_ev
from raden_torch.brdf.files.gbuffer_reading import USUAL, GBufferReading
from raden_torch.brdf.files.image_file import (
    Photograph,
    check_photograph,
    write_photograph,
)
from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.files.normal_axes import Green
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.lights import Light
from raden_torch.brdf.shading.relight import matching_gain, shaded_under
from raden_torch.relighting import (
    CameraRgb,
    Coded,
    Layout,
    Surface,
    original_lamp,
    read_to_relight,
    relit_photograph,
)
from raden_torch.sequences.frames import frame_path, is_pattern
from raden_torch.sequences.lighting import UNSAID, Lighting
from raden_torch.sequences.picture_job import UNKNOWN, PictureJob, Shape, import_codecs
from raden_torch.sequences.plan import check_pattern, first_like, first_read, frames_to_do

_BYTES_WAITING, _BYTES_WORKING, _BYTES_A_TILE = 48, 400, 120
"""A pixel; a tile is the picture under one of the lamps of a strip or a sheet."""


@dataclass(frozen=True)
class Scene:
    """What all frames share."""

    model: Reflection
    lights: list[Light]
    surface: Surface | None


@dataclass(frozen=True)
class Taken:
    """A frame that has been read."""

    item: int
    photo: Photograph
    surface: Surface
    original: list[Light] | None


@dataclass(frozen=True, kw_only=True)
class RelightJob(PictureJob[Scene, Taken, Photograph]):
    """`raden relight shot.####.png --frames …`.

    Attributes:
        photo: the photographs, with a place for the frame's number.
        normals, mask: one file, or one a frame; `reading.material`, too.
        first, shape: the frame whose size and channels all have.
        model, layout, green, reading, display, original, coded: as for `relight_files`.
        lighting: as for `relight_files`, in the normals' frame.
    """

    photo: Path
    normals: Path
    model: Path
    first: int = 0
    shape: Shape = UNKNOWN
    mask: Path | None = None
    lighting: Lighting = UNSAID
    layout: Layout = "picture"
    green: Green = "opengl"
    reading: GBufferReading = USUAL
    display: Display = AS_IT_IS
    original: Path | tuple[float, float, float] | None = None
    coded: Coded = "srgb"

    @property
    def patterns(self) -> tuple[Path, ...]:
        own = (self.normals, self.mask, self.reading.material)
        return (self.photo, *(path for path in own if path is not None and is_pattern(path)))

    @property
    def shared(self) -> tuple[Path, ...]:
        original = self.original if isinstance(self.original, Path) else None
        colour = self.coded.colour if isinstance(self.coded, CameraRgb) else None
        files = (self.model, self.normals, self.mask, self.reading.material, original, colour)
        given = (*files, self.lighting.environment)
        return tuple(path for path in given if path is not None and not is_pattern(path))

    @property
    def bytes_waiting(self) -> int:
        height, width = self.shape.size
        tiles = 1 if self.layout == "picture" else len(self.lighting.lamps)
        return height * width * (_BYTES_WAITING + 12 * tiles)

    @property
    def bytes_working(self) -> int:
        height, width = self.shape.size
        tiles = 0 if self.layout == "picture" else len(self.lighting.lamps)
        return height * width * (_BYTES_WORKING + _BYTES_A_TILE * tiles)

    def prepare(self) -> Scene:
        import_codecs()
        model = load_lit(self.model)
        surface = None if len(self.patterns) > 1 else self._surface(model, self.first)
        return Scene(model, self.lighting.lights(), surface)

    def read(self, prepared: Scene, item: int) -> Taken:
        path = frame_path(self.photo, item)
        photo = read_to_relight(path, self.coded)
        self.shape.check(path, shape_of_photograph(photo), frame_path(self.photo, self.first))
        check_photograph(photo, self.output(item), self.display)
        original = None if self.original is None else [original_lamp(self.original, path)]
        surface = prepared.surface or self._surface(prepared.model, item)
        return Taken(item, photo, surface, None if original is None else list(original))

    def work(self, prepared: Scene, read: Taken) -> Photograph:
        return relit_photograph(
            prepared.model,
            read.photo,
            read.surface,
            prepared.lights,
            self.layout,
            self.display,
            read.original,
            path=frame_path(self.photo, read.item),
            target=self.output(read.item),
        )

    def write(self, prepared: Scene, worked: Photograph, item: int) -> bool:
        caption = caption_of(prepared.model)
        return self.put(
            item, lambda path: write_photograph(worked, path, caption, display=self.display)
        )

    def _surface(self, model: Reflection, item: int) -> Surface:
        material = self.reading.material
        reading = self.reading
        if material is not None:
            reading = replace(reading, material=frame_path(material, item))
        return Surface.read(
            model,
            self.model,
            frame_path(self.normals, item),
            None if self.mask is None else frame_path(self.mask, item),
            self.green,
            reading,
        )


def plan_relight(
    job: RelightJob, frames: Sequence[int], *, skip_missing: bool = False
) -> tuple[RelightJob, list[int]]:
    """As `plan_render`; the new light of all frames has the gain of the first one on disk.

    A contact sheet is exposed by itself.
    """
    check_pattern(job.photo)
    left, to_do = frames_to_do(job, frames, skip_missing=skip_missing)
    if not to_do:
        return job, left

    def look(path: Path) -> Shape:
        return shape_of_photograph(read_to_relight(path, job.coded))

    first, shape = first_like(job.photo, to_do, look)
    job = replace(job, first=first, shape=shape)
    if job.layout == "picture":
        job = replace(job, picture_size=shape.size)
    if job.layout != "sheet" and isinstance(job.display.exposure, str):
        stops = _stops_of_first(job, job.display.exposure)
        job = replace(job, display=replace(job.display, exposure=stops))
    return job, left


def _stops_of_first(job: RelightJob, exposure: str) -> float:
    """Of the new light in the first frame on disk."""
    scene = job.prepare()
    taken = first_read(job.photo, lambda number: job.read(scene, number))
    photo, surface = taken.photo.linear, taken.surface
    settings = [scene.lights] if job.layout == "picture" else scene.lights
    with torch.no_grad():
        lit = shaded_under(
            scene.model,
            photo,
            surface.normal,
            surface.coverage,
            settings,
            original=taken.original,
            material=surface.material,
            tangent=surface.tangent,
            layers=surface.layers,
        ).mean(dim=0)
    if exposure == "key":
        return key_exposure_ev(lit * surface.coverage)
    return math.log2(float(matching_gain(photo, lit, surface.coverage)))


def shape_of_photograph(photo: Photograph) -> Shape:
    """Its size; its channels with the bits that they have."""
    height, width = photo.linear.shape[-2:]
    bits = {255: "8 bits", 65535: "16 bits"}.get(photo.levels or 0, "floats")
    return Shape((height, width), (f"RGB of {bits}", *(["alpha"] * (photo.alpha is not None))))
