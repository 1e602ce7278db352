"""Videos, folders of stills and single stills, picture by picture."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.photograph import read_stored
from raden_torch.capture.photo.stored_photograph import read_photograph
from raden_torch.errors import InputError
from raden_torch.images.pixels import turned_to
from raden_torch.images.shot_settings import UNKNOWN, ShotSettings

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".3gp")
_STILL_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".heic", ".heif")
_MOST_PIXELS = 100_000_000
_OF_VIDEOS = {0: 1, 90: 6, 180: 3, 270: 8}
"""Degrees clockwise by which a video is turned → EXIF's orientation."""


@dataclass(frozen=True, eq=False)
class Clip:
    """What was taken under one lamp: one video, or stills.

    Attributes:
        name: of the video or folder, for messages.
        stills: the files; none of a video.
        video: the file; None of stills.
        orientation: EXIF's, 1…8, by which all pictures are turned; None: each as its own file says.
            Those of one sensor need one, as its lens is not turned with the picture.
    """

    name: str
    stills: tuple[Path, ...] = ()
    video: Path | None = None
    orientation: int | None = None

    def __len__(self) -> int:
        """Pictures, of a video as its header says (0: it does not)."""
        if self.video is None:
            return len(self.stills)
        import cv2

        with _opened(self.video) as frames:
            return max(0, int(frames.get(cv2.CAP_PROP_FRAME_COUNT)))


@dataclass(frozen=True, eq=False)
class Picture:
    """A still or a frame of a video.

    Attributes:
        name: of its file; a frame's is that which it gets when it is kept.
        clip: number of the clip, from 0.
        number: in the clip, from 0.
        pixels: `[H, W, 3]` RGB of 8 bits, as stored.
        settings: of the camera, by EXIF; unknown of a frame.
        is_srgb: its file names no other primaries than sRGB's.
        other_way: its file says another orientation than the clip.
    """

    name: str
    clip: int
    number: int
    pixels: NDArray[np.uint8]
    settings: ShotSettings = UNKNOWN
    is_srgb: bool = True
    other_way: bool = False

    def turned_to(self, orientation: int | None) -> Picture:
        """The same, turned by this EXIF orientation instead of its own; None: as it is."""
        own = self.settings.turned
        if orientation is None or orientation == own:
            return self
        pixels = turned_to(self.pixels, own, orientation)
        settings = replace(self.settings, orientation=orientation)
        return replace(self, pixels=pixels, settings=settings, other_way=True)


def clips_of(paths: Sequence[Path]) -> list[Clip]:
    """Videos and folders are a clip each; stills that are named one by one are one clip together.

    Raises:
        InputError: nothing there, or a file that is neither; two pictures of one name.
    """
    clips: list[Clip] = []
    loose: list[Path] = []
    for path in paths:
        if path.is_dir():
            files = [p for p in path.iterdir() if p.suffix.lower() in _STILL_SUFFIXES]
            if not files:
                raise InputError(f"{path}: expected a folder of photographs, got none in it")
            clips.append(Clip(path.name, tuple(sorted(files, key=_by_number))))
        elif not path.is_file():
            raise InputError(f"{path}: expected a video or a photograph, got no such file")
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            clips.append(Clip(path.name, video=path))
        else:
            loose.append(path)
    if loose:
        clips.append(Clip("stills", tuple(loose)))
    names = [p.name for clip in clips for p in (clip.stills or (Path(clip.name).with_suffix(""),))]
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise InputError(f"{twice}: expected photographs of different names, got two of this one")
    if not clips:
        raise InputError("photographs: expected a video, a folder or stills, got none")
    return clips


def pictures(clip: Clip, place: int, wanted: Collection[int] | None = None) -> Iterator[Picture]:
    """A clip's pictures in order.

    Args:
        place: of the clip, from 0.
        wanted: numbers of those to give; None: all.

    Raises:
        InputError: as for `read_stored`; a video that cannot be decoded, or too large a picture.
    """
    if clip.video is None:
        for k, path in enumerate(clip.stills):
            if wanted is None or k in wanted:
                yield _still(path, place, k).turned_to(clip.orientation)
        return
    import cv2

    stem, last = clip.video.stem, max(wanted, default=-1) if wanted is not None else None
    with _opened(clip.video) as frames:
        own = _orientation_of(frames)
        number = 0
        while last is None or number <= last:
            if not frames.grab():
                break
            if wanted is None or number in wanted:
                found, bgr = frames.retrieve()
                if not found:  # a damaged frame
                    number += 1
                    continue
                if bgr.shape[0] * bgr.shape[1] > _MOST_PIXELS:
                    raise InputError(
                        f"{clip.video}: expected frames of at most {_MOST_PIXELS // 10**6} million "
                        f"pixels, got {bgr.shape[1]} x {bgr.shape[0]}"
                    )
                rgb = np.ascontiguousarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
                frame = Picture(f"{stem}_{number:06d}.png", place, number, rgb, own)
                yield frame.turned_to(clip.orientation)
            number += 1
    if number == 0 and (wanted is None or wanted):
        raise InputError(f"{clip.video}: expected a video, got one without frames")


def in_one_frame(clips: Sequence[Clip], orientation: int | None) -> list[Clip]:
    """The clips, all their pictures turned as the sensor's are by one EXIF orientation.

    Args:
        orientation: 1…8; None, or where the first picture says none: the first picture's.

    Raises:
        InputError: as for `pictures`.
    """
    first = next(pictures(clips[0], 0), None)
    settings = UNKNOWN if first is None else first.settings
    if orientation is None or settings.orientation is None:
        orientation = settings.turned
    return [replace(clip, orientation=orientation) for clip in clips]


def _orientation_of(frames: Any) -> ShotSettings:
    """How OpenCV turns the frames of an open video as it reads them."""
    import cv2

    turned = bool(frames.get(cv2.CAP_PROP_ORIENTATION_AUTO))
    degrees = round(frames.get(cv2.CAP_PROP_ORIENTATION_META)) % 360 if turned else 0
    return replace(UNKNOWN, orientation=_OF_VIDEOS.get(degrees, 1))


def _still(path: Path, place: int, number: int) -> Picture:
    photo = read_photograph(path)
    if photo.raw is not None or photo.values.dtype != np.uint8:
        kind = "a raw file" if photo.raw is not None else f"{photo.values.dtype} values"
        raise InputError(
            f"{path}: expected stills of 8 bits, as a phone's JPEG or HEIC, whose tone curve is "
            f"looked for, got {kind}; raw files go to `raden capture calibrate`, `lights`, `brdf`"
        )
    pixels = photo.values if photo.values.ndim == 3 else read_stored(path)
    is_srgb = photo.matrix is None or bool(np.allclose(photo.matrix, np.eye(3), atol=1e-3))
    return Picture(path.name, place, number, pixels, photo.settings, is_srgb)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A video while it is read."""
    import cv2

    frames = cv2.VideoCapture(str(path))
    try:
        if not frames.isOpened():
            raise InputError(
                f"{path}: expected a video that OpenCV's decoders read, got another file"
            )
        yield frames
    finally:
        frames.release()


def _by_number(path: Path) -> tuple[list[int], str]:
    return [int(n) for n in re.findall(r"\d+", path.name)], path.name
