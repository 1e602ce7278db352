"""What the photographs of a series have in common: camera, lamps, and the sample before them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.brdf.lighting import Lamp, lamps_of_shots
from raden_torch.capture.photo.brdf.sample import SampleInPhotograph, SampleSpec, place
from raden_torch.capture.photo.brdf.sample_shapes import Shape
from raden_torch.capture.photo.brdf.samples import SeenSurface, see
from raden_torch.capture.photo.brdf.series import Frame, Shot, read_shot, series
from raden_torch.capture.photo.camera import Camera, CameraFile, Pose, read_camera, read_poses
from raden_torch.capture.photo.development import Development
from raden_torch.capture.photo.lamps import Lamps, read_lamps
from raden_torch.capture.photo.result_file import read_result
from raden_torch.errors import InputError

_OUTLINE_PX = 0.3
"""How well an outline is known where it is a mask's: its normals hang on it."""


@dataclass(frozen=True, eq=False)
class CaptureSetup:
    """The files of the earlier steps, and what a person says of the series.

    Attributes:
        lights: a lights file.
        camera: a camera file, with the board's poses where they are needed; None: far away.
        colour: a colour file; None: camera RGB.
        lamps: of each photograph its lamp's number, from 1; empty: photograph k has lamp k.
        stack: files a photograph.
        seen_in: the photograph in whose camera's frame the lights file is, where the lamps stand
            beside the board; None where they stand beside the camera.
        lamp_std_deg: standard deviation of the lamps' directions; None: see `lighting`.
        development: how photographs are read.
    """

    lights: Path
    camera: Path | None = None
    colour: Path | None = None
    lamps: tuple[int, ...] = ()
    stack: int = 1
    seen_in: str | None = None
    lamp_std_deg: float | None = None
    development: Development = field(default_factory=Development)


@dataclass(eq=False)
class Scene:
    """The shots, the camera, the lamps, and the sample as the last shot asked for saw it."""

    shots: list[Shot]
    camera: Camera | None
    lamps: list[Lamp]
    sample: SampleSpec
    exponent: float
    size: tuple[int, int]
    _last: tuple[Pose | None, SampleInPhotograph, SeenSurface] | None = None

    @classmethod
    def of(cls, photographs: Sequence[Path], setup: CaptureSetup, sample: SampleSpec) -> Scene:
        lamps: Lamps = read_lamps(setup.lights)
        camera = None if setup.camera is None else read_camera(setup.camera)
        poses = _poses(setup.camera)
        shots = series(
            photographs,
            lamps,
            setup.lights,
            stack=setup.stack,
            numbers=setup.lamps,
            poses=poses,
            how=setup.development,
        )
        each = lamps_of_shots(
            lamps,
            shots,
            camera,
            setup.lights,
            seen_in=_seen_in(setup, poses),
            std_deg=setup.lamp_std_deg,
        )
        size = read_shot(shots[0]).size
        if camera is not None and camera.size != size:
            (h, w), (height, width) = camera.size, size
            raise InputError(
                f"{setup.camera}: expected the camera that took the photographs, at their size of "
                f"{width} x {height} pixels, got one of {w} x {h}"
            )
        return cls(shots, camera, each, sample, lamps.exponent, size)

    def read(self, shot: Shot) -> Frame:
        frame = read_shot(shot, self.exponent)
        if frame.size != self.size:
            (h, w), (height, width) = self.size, frame.size
            raise InputError(
                f"{shot.files[0]}: expected photographs of one size, got {width} x {height} "
                f"pixels, but {self.shots[0].name} has {w} x {h}"
            )
        return frame

    def see(self, k: int) -> SeenSurface:
        """What the pixels of shot k see of the sample."""
        return self._placed(k)[1]

    def shape_in(self, k: int) -> Shape:
        """The sample's shape in the frame of shot k's camera."""
        return self._placed(k)[0].shape

    @property
    def moves(self) -> bool:
        """The sample is found by the board's pose."""
        return self.sample.shape == "plane" or self.sample.axis_m is not None

    @property
    def normal_std_deg(self) -> float:
        """Of the normals, where they hang on an outline: that over the radius in the picture."""
        if self.moves:
            return 0.0
        seen = self.see(0)
        across = min(np.ptp(seen.x_px), np.ptp(seen.y_px)) / 2
        return float(np.degrees(_OUTLINE_PX / max(across, 1.0)))

    def _placed(self, k: int) -> tuple[SampleInPhotograph, SeenSurface]:
        shot = self.shots[k]
        if self._last is None or (self.moves and self._last[0] is not shot.pose):
            placed = place(
                self.sample, self.camera, shot.pose, self.size, self._pictures, shot.name
            )
            self._last = shot.pose, placed, see(placed, self.camera)
        return self._last[1:]

    def _pictures(self) -> list[NDArray[Any]]:
        return [self.read(shot).radiance for shot in self.shots]


def _poses(path: Path | None) -> dict[str, Pose]:
    """The board's poses in a camera file; none in an OpenCV file, or one without a board."""
    if (
        path is None
        or path.suffix.lower() != ".json"
        or read_result(path, "camera", CameraFile).poses is None
    ):
        return {}
    return read_poses(path)[1]


def _seen_in(setup: CaptureSetup, poses: dict[str, Pose]) -> Pose | None:
    if setup.seen_in is None:
        return None
    name = Path(setup.seen_in).name
    if name not in poses:
        raise InputError(
            f"{setup.camera}: no pose of the board in {name}, in whose frame the lights are; "
            f"{', '.join(list(poses)[:4]) or 'none'} are there"
        )
    return poses[name]
