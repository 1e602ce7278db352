"""G-buffers in OpenEXR files, frame by frame, lit by a model."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.brdf.files.bands import BYTES_A_CHANNEL, BYTES_A_PIXEL, BYTES_GATHERED
from raden_torch.brdf.files.caption import caption_of
from raden_torch.brdf.files.display import AS_IT_IS, Display
from raden_torch.brdf.files.gbuffer_file import GBufferFile, has_pixels
from raden_torch.brdf.files.gbuffer_reading import USUAL, GBufferReading
from raden_torch.brdf.files.shade_file import Shadowed
from raden_torch.brdf.materials.anisotropic import takes_tangent
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.lights import Light
from raden_torch.brdf.shading.shade import shade, warn_if_black
from raden_torch.images.exr_file import ExrFile
from raden_torch.pictures import SHAPES, load_material
from raden_torch.sequences.frames import frame_path, is_pattern
from raden_torch.sequences.lighting import UNSAID, Lighting
from raden_torch.sequences.picture_job import UNKNOWN, PictureJob, Shape, import_codecs
from raden_torch.sequences.plan import (
    check_pattern,
    exposed_alike,
    first_like,
    first_read,
    frames_to_do,
)

_WAITING_A_PIXEL = 64
"""Bytes beside the file's channels: a G-buffer's vectors and mask, or the picture made of it."""


@dataclass(frozen=True)
class Lit:
    """What all frames share: a model and the lights."""

    model: Reflection
    lights: Sequence[Light]

    @property
    def palette(self) -> Palette | None:
        return self.model if isinstance(self.model, Palette) else None


@dataclass(frozen=True, kw_only=True)
class RenderJob(PictureJob[Lit, GBuffer, Tensor]):
    """`raden render MODEL --gbuffer shot.####.exr --frames …`.

    Attributes:
        model: its file, or "pearl".
        gbuffer: the EXR files, with a place for the frame's number.
        first: the frame whose shape all have; what seems to be declared wrongly is warned of there.
        shape: size and channels of all frames.
        reading: how they are read; `material` and `camera_file` may be a file for each frame, too.
        lighting: as for `shade`, in the renderer's world.
        display, tolerance, shadowed: as for `render_gbuffer_file`.
        illuminant, white: of a spectral model, as for `load_material`.
        device: where frames are shaded, as "cuda".
    """

    model: Path
    gbuffer: Path
    first: int = 0
    shape: Shape = UNKNOWN
    reading: GBufferReading = USUAL
    lighting: Lighting = UNSAID
    display: Display = AS_IT_IS
    tolerance: float = 0.0
    shadowed: Shadowed | None = None
    illuminant: str | None = None
    white: str | None = None
    device: str = "cpu"

    @property
    def patterns(self) -> tuple[Path, ...]:
        own = (self.reading.material, self.reading.camera_file)
        return (self.gbuffer, *(path for path in own if path is not None and is_pattern(path)))

    @property
    def shared(self) -> tuple[Path, ...]:
        spectra = [Path(name) for name in (self.illuminant, self.white) if name is not None]
        said = (self.reading.material, self.reading.camera_file)
        files = (self.model, self.lighting.environment, *said, *(p for p in spectra if p.suffix))
        return tuple(p for p in files if p is not None and not is_pattern(p) and p.exists())

    @property
    def bytes_waiting(self) -> int:
        height, width = self.shape.size
        return height * width * (_WAITING_A_PIXEL + 4 * len(self.shape.channels))

    @property
    def bytes_working(self) -> int:
        height, width = self.shape.size
        gathered = 0 if self.reading.material is None else BYTES_GATHERED
        channels = BYTES_A_CHANNEL * len(self.shape.channels)
        return height * width * (BYTES_A_PIXEL + gathered + channels)

    def prepare(self) -> Lit:
        import_codecs()
        model = load_material(self.model, self.illuminant, self.white)
        if isinstance(model, torch.nn.Module):
            model.to(self.device)
        lights = [
            replace(light, radiance=light.radiance.to(self.device))
            if isinstance(light, EnvironmentLight)
            else light
            for light in self.lighting.lights() or SHAPES["sphere"].lights
        ]
        return Lit(model, [self.reading.light(light) for light in lights])

    def read(self, prepared: Lit, item: int) -> GBuffer:
        path = frame_path(self.gbuffer, item)
        file = GBufferFile(
            path,
            self._reading_of(item),
            palette=prepared.palette,
            turns=takes_tangent(prepared.model),
            is_checked=item == self.first,
        )
        self.shape.check(
            path, Shape(file.size, file.channels), frame_path(self.gbuffer, self.first)
        )
        gbuffer = file.rows(0, file.size[0])
        if not has_pixels(gbuffer):
            warnings.warn(f"{path}: no pixel is valid; the picture is black", stacklevel=1)
        return gbuffer

    def work(self, prepared: Lit, read: GBuffer) -> Tensor:
        lights, gbuffer = prepared.lights, read.to(self.device)
        with torch.no_grad():
            if self.shadowed is not None:
                lights = self.shadowed(gbuffer, lights)
            return shade(prepared.model, gbuffer, lights, tolerance=self.tolerance).cpu()

    def write(self, prepared: Lit, worked: Tensor, item: int) -> bool:
        if item == self.first:
            warn_if_black(worked, prepared.lights)
        caption = caption_of(prepared.model)
        return self.put(item, lambda path: self.display.write(worked, path, caption))

    def _reading_of(self, item: int) -> GBufferReading:
        said = self.reading
        material, camera = said.material, said.camera_file
        return replace(
            said,
            material=None if material is None else frame_path(material, item),
            camera_file=None if camera is None else frame_path(camera, item),
        )


def plan_render(
    job: RenderJob, frames: Sequence[int], *, skip_missing: bool = False
) -> tuple[RenderJob, list[int]]:
    """The job with what has to be known before the first frame, and the frames to go through.

    Pictures whose exposure is to be found are all exposed as the first frame on disk, whichever
    frames are asked for.

    Raises:
        InputError: missing files; no frame that can be read; an output that cannot be written.
    """
    check_pattern(job.gbuffer)
    job.display.check_path(job.output(frames[0]))
    left, to_do = frames_to_do(job, frames, skip_missing=skip_missing)
    if not to_do:
        return job, left
    first, shape = first_like(job.gbuffer, to_do, shape_of_exr)
    job = replace(job, first=first, shape=shape, picture_size=shape.size)

    def stops() -> float:
        prepared = job.prepare()
        read = first_read(job.gbuffer, lambda number: job.read(prepared, number))
        return job.display.stops(job.work(prepared, read))

    return replace(job, display=exposed_alike(job.display, job.target, stops)), left


def shape_of_exr(path: Path) -> Shape:
    """By its header."""
    file = ExrFile(path)
    return Shape(file.size, tuple(key for key, _, _ in file.keys))
