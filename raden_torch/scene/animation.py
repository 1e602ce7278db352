"""Frames of a scene: as pictures in a folder, which can be resumed, or as one moving picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.files.display import Display, eight_bits
from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside
from raden_torch.images.pixels import read_image
from raden_torch.packages import require
from raden_torch.scene.scene import Scene

VIDEO_CODES = {".mp4": "mp4v", ".webm": "VP80"}
MOVING = (*VIDEO_CODES, ".webp")
"""Suffixes of one file that moves."""
_WEBP_QUALITY = 70

Shown = Callable[[float], object]
Pixels = NDArray[np.uint8]
_T = TypeVar("_T")


def render_frames(
    scene: Scene,
    frames: Sequence[int],
    output: Path,
    display: Display,
    *,
    resume: bool = False,
    shown: Shown = lambda share: None,
) -> int:
    """Render frames into a folder of PNGs (`frame_0001.png` …), or an .mp4, .webm or .webp.

    All are exposed alike: for the first frame of the scene, where exposure is automatic. A frame is
    there whole or not at all, so that rendering can be stopped at any time and resumed.

    Args:
        frames: numbers, from 1.
        resume: keep frames that are there, if they have the picture's size.
        shown: called with the share that is done.

    Returns:
        How many frames were rendered.

    Raises:
        InputError: another suffix; frames that are there, without `resume`; one of another size,
            with it; OpenCV cannot write such a video.
    """
    require("animations", "images")
    suffix = output.suffix.lower()
    if suffix and suffix not in MOVING and not output.is_dir():
        raise InputError(
            f"{output}: expected a folder, or a file name that ends in {', '.join(MOVING)}, got "
            f"{suffix}"
        )
    if suffix in MOVING:
        if resume:
            raise InputError(f"{output}: expected a folder of frames to resume, got one file")
        check_output(output, inputs=scene.files)
        with written_beside(output) as temporary:
            _write_moving(_pictures(scene, frames, display, shown), temporary, scene)
        return len(frames)
    return _write_folder(scene, frames, output, display, resume, shown)


def _write_folder(
    scene: Scene, frames: Sequence[int], folder: Path, display: Display, resume: bool, shown: Shown
) -> int:
    targets = {number: folder / f"frame_{number:04d}.png" for number in frames}
    there = [number for number, path in targets.items() if path.exists()]
    if there and not resume:
        raise InputError(
            f"{folder}: expected no frames of this range, got {len(there)} of {len(frames)} "
            f"({targets[there[0]].name} …); `resume` keeps them and renders the rest"
        )
    for number in there:
        height, width = read_image(targets[number]).pixels.shape[:2]
        if (width, height) != scene.picture_size:
            wide, high = scene.picture_size
            raise InputError(
                f"{targets[number]}: expected {wide} x {high} pixels, as this scene has, got "
                f"{width} x {height}"
            )
    folder.mkdir(parents=True, exist_ok=True)
    left = [number for number in frames if number not in there]
    exposed = _exposed(scene, display) if left else display

    def write(number: int, image: Tensor) -> None:
        exposed.write(image, targets[number], scene.caption)

    for _ in _finished(scene, left, write, shown):
        pass
    return len(left)


def _pictures(
    scene: Scene, frames: Sequence[int], display: Display, shown: Shown
) -> Iterator[Pixels]:
    """`[H, W, 3]` of each frame."""
    exposed = _exposed(scene, display)

    def picture(_: int, image: Tensor) -> Pixels:
        return eight_bits(exposed.picture(image)[0], scene.caption)

    return _finished(scene, frames, picture, shown)


def _finished(
    scene: Scene, frames: Sequence[int], finish: Callable[[int, Tensor], _T], shown: Shown
) -> Iterator[_T]:
    """What `finish` makes of each frame, in a thread of its own while the next one is rendered."""
    with ThreadPoolExecutor(1) as thread:
        waiting: Future[_T] | None = None
        for place, number in enumerate(frames):
            image = scene.frame(number)
            if waiting is not None:
                yield waiting.result()
                shown(place / len(frames))
            waiting = thread.submit(finish, number, image)
        if waiting is not None:
            yield waiting.result()
            shown(1.0)


def _exposed(scene: Scene, display: Display) -> Display:
    """The same display with stops that are the same for all frames."""
    if not isinstance(display.exposure, str):
        return display
    return replace(display, exposure=display.stops(scene.frame(1)))


def _write_moving(pictures: Iterator[Pixels], path: Path, scene: Scene) -> None:
    fps = scene.table.animation.fps
    if path.suffix.lower() == ".webp":
        _write_webp(pictures, path, fps)
        return
    import cv2

    code: Any = cv2.VideoWriter.fourcc(*VIDEO_CODES[path.suffix.lower()])
    writer = cv2.VideoWriter(str(path), code, fps, scene.picture_size)
    try:
        if not writer.isOpened():
            raise InputError(
                f"{path.suffix}: expected a video that OpenCV can write here, got none; a folder "
                "takes frames as PNGs"
            )
        for picture in pictures:
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
    finally:
        writer.release()


def _write_webp(pictures: Iterator[Pixels], path: Path, fps: float) -> None:
    from PIL import Image

    first, *rest = [Image.fromarray(picture) for picture in pictures]
    first.save(
        path, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0,
        quality=_WEBP_QUALITY, method=4,
    )  # fmt: skip
