"""The files of a series → its shots, lamps and camera; then its photographs in linear light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup
from raden_torch.capture.photo.brdf.lighting import Lamp, lamps_of_shots
from raden_torch.capture.photo.brdf.shots import Shot, shots_of
from raden_torch.capture.photo.camera import (
    Camera,
    CameraFile,
    Pose,
    check_camera_size,
    read_camera,
    read_poses,
)
from raden_torch.capture.photo.development import developed
from raden_torch.capture.photo.exposures import CEILING, unsaturated
from raden_torch.capture.photo.lamps import read_lamps
from raden_torch.capture.photo.photo_set import check_orientation
from raden_torch.capture.photo.result_file import read_result
from raden_torch.errors import InputError
from raden_torch.images.raw_image import RawColour
from raden_torch.images.shot_settings import UNKNOWN, ShotSettings, check_alike

_MOST_PIXELS = 400_000_000


@dataclass(frozen=True, eq=False)
class PhotoSeries:
    """Photographs that are not read yet, and what they have in common.

    Attributes:
        shots: one a view and lamp.
        lamps: of each shot, in the frame of its camera.
        camera: None where it is far away.
        exponent: of the camera's response, as the lights file says; 1 where it is linear.
        size: height and width of every photograph.
        colour: of raw files, the first one's; None for others.
        seen_in: pose of the board in the photograph in whose frame the lights file is, where the
            lamps stand beside the board; None where they stand beside the camera.
    """

    shots: list[Shot]
    lamps: list[Lamp]
    camera: Camera | None
    exponent: float
    size: tuple[int, int]
    colour: RawColour | None = None
    seen_in: Pose | None = None

    @property
    def names(self) -> list[str]:
        return [shot.name for shot in self.shots]


@dataclass(frozen=True, eq=False)
class Frame:
    """A shot that was read.

    Attributes:
        radiance: `[H, W, 3]` linear, relative to the white level, per second where times are known.
        usable: `[H, W]`: not saturated, nor beside a saturated pixel.
        timed: the unit is per second.
        settings: of the camera, by EXIF.
        colour: of a raw file.
    """

    radiance: NDArray[np.float32]
    usable: NDArray[np.bool_]
    timed: bool
    settings: ShotSettings = UNKNOWN
    colour: RawColour | None = None

    @property
    def size(self) -> tuple[int, int]:
        height, width = self.usable.shape
        return height, width


def read_series(photographs: Sequence[Path], setup: CaptureSetup) -> PhotoSeries:
    """Tell the photographs apart by the files of the earlier steps; read the first for its size.

    Raises:
        InputError: files, numbers of lamps, poses or sizes that do not fit together.
    """
    lamps = read_lamps(setup.lights)
    camera = None if setup.camera is None else read_camera(setup.camera)
    poses = _poses(setup.camera)
    shots = shots_of(photographs, setup, lamps, poses, camera)
    seen_in = _seen_in(setup, poses)
    of_shots = lamps_of_shots(lamps, shots, camera, setup, seen_in)
    frame = read_frame(shots[0])
    turned = frame.settings.orientation
    check_orientation(shots[0].files[0], turned, setup.lights, lamps.orientation)
    size = frame.size
    if camera is not None:
        check_camera_size(setup.camera, camera.size, size)
    return PhotoSeries(shots, of_shots, camera, lamps.exponent, size, frame.colour, seen_in)


def linear_frames(series: PhotoSeries) -> Iterator[Frame]:
    """The photographs in linear light, one after another.

    Raises:
        InputError: as for `read_frame`; another size, camera, lens, zoom or white balance than the
            others'; exposure times for some only.
    """
    first = series.shots[0]
    timed, settings = None, list[tuple[Path, ShotSettings]]()
    for shot in series.shots:
        frame = read_frame(shot, series.exponent)
        if frame.size != series.size:
            (h, w), (height, width) = series.size, frame.size
            raise InputError(
                f"{shot.files[0]}: expected photographs of one size, got {width} x {height} "
                f"pixels, but {first.name} has {w} x {h}"
            )
        settings.append((shot.files[0], frame.settings))
        check_alike(settings)
        timed = frame.timed if timed is None else timed
        if frame.timed != timed:
            raise InputError(
                f"{shot.files[0]}: {'an' if frame.timed else 'no'} exposure time, but "
                f"{first.name} has {'one' if timed else 'none'}; state them for all"
            )
        yield frame


def read_frame(shot: Shot, exponent: float = 1.0) -> Frame:
    """Develop a shot's files.

    Args:
        exponent: of the camera's response.

    Raises:
        InputError: as for `developed`, and a photograph that is too large.
    """
    photo, merged = developed(shot.files, shot.how)
    if photo.saturated.size > _MOST_PIXELS:
        raise InputError(f"{shot.files[0]}: over {_MOST_PIXELS // 10**6} million pixels; crop it")
    linear = photo.linear if exponent == 1 else np.maximum(photo.linear, 0) ** exponent
    usable = unsaturated(photo, CEILING)
    if merged is None and photo.exposure_s is not None:
        linear = linear / np.float32(photo.exposure_s)
    timed = merged is not None or photo.exposure_s is not None
    light = np.asarray(linear, np.float32)
    return Frame(light, usable, timed, photo.settings, photo.colour)


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
