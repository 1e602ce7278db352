"""Frames of a scene file, as pictures of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from raden_torch.brdf.files.display import Display
from raden_torch.scene.scene import Scene
from raden_torch.sequences.picture_job import PictureJob, import_codecs
from raden_torch.sequences.plan import exposed_alike, frames_to_do

_BYTES_A_PIXEL = 24
"""Of a picture that waits to be written, and of what is made of it."""


@dataclass(frozen=True, kw_only=True)
class SceneJob(PictureJob[Scene, int, Tensor]):
    """`raden render scene.toml --frames …`.

    What a scene keeps between frames is in `scene.Scene`: one process renders them in turn.

    Attributes:
        scene: its file. The files that it names are read where they are.
        width, samples: in place of the file's, as for `Scene.read`.
        display: with stops that are those of all frames.
    """

    scene: Path
    display: Display
    width: int | None = None
    samples: int | None = None

    @property
    def patterns(self) -> tuple[Path, ...]:
        return ()

    @property
    def shared(self) -> tuple[Path, ...]:
        return ()

    @property
    def bytes_waiting(self) -> int:
        height, width = self.picture_size or (0, 0)
        return height * width * _BYTES_A_PIXEL

    def prepare(self) -> Scene:
        import_codecs()
        return Scene.read(self.scene, width=self.width, samples=self.samples)

    def read(self, prepared: Scene, item: int) -> int:
        return item

    def work(self, prepared: Scene, read: int) -> Tensor:
        return prepared.frame(read)

    def write(self, prepared: Scene, worked: Tensor, item: int) -> bool:
        return self.put(item, lambda path: self.display.write(worked, path, prepared.caption))


def plan_scene(job: SceneJob, scene: Scene, frames: Sequence[int]) -> tuple[SceneJob, list[int]]:
    """The job with what has to be known before the first frame, and the frames to go through.

    Args:
        scene: what `job.prepare` makes. Where the exposure is to be found, its first frame is
            rendered.
    """
    import_codecs()
    job.display.check_path(job.output(frames[0]))
    left, to_do = frames_to_do(job, frames, skip_missing=False)
    width, height = scene.picture_size
    job = replace(job, picture_size=(height, width))
    if not to_do:
        return job, left
    display = exposed_alike(job.display, job.target, lambda: job.display.stops(scene.frame(1)))
    return replace(job, display=display), left
