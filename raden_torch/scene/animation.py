"""Frames of a scene as one moving picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.brdf.files.display import Display, eight_bits
from raden_torch.errors import InputError
from raden_torch.files import check_output, written_beside
from raden_torch.packages import require
from raden_torch.scene.scene import Scene

VIDEO_CODES = {".mp4": "mp4v", ".webm": "VP80"}
MOVING = (*VIDEO_CODES, ".webp")
"""Suffixes of one file that moves."""
_WEBP_QUALITY = 70

Shown = Callable[[float], object]
Pixels = NDArray[np.uint8]


def render_moving(
    scene: Scene,
    frames: Sequence[int],
    output: Path,
    display: Display,
    *,
    shown: Shown = lambda share: None,
) -> None:
    """Render frames into an .mp4, .webm or .webp, which appears when it is whole.

    All are exposed alike: for the first frame of the scene, where exposure is automatic.

    Args:
        frames: numbers, from 1.
        shown: called with the share that is done.

    Raises:
        InputError: another suffix; OpenCV cannot write such a video.
    """
    require("animations", "images")
    check_output(output, MOVING, inputs=scene.files)
    with written_beside(output) as temporary:
        _write_moving(_pictures(scene, frames, display, shown), temporary, scene)


def _pictures(
    scene: Scene, frames: Sequence[int], display: Display, shown: Shown
) -> Iterator[Pixels]:
    """`[H, W, 3]` of each frame."""
    exposed = _exposed(scene, display)

    def picture(image: Tensor) -> Pixels:
        return eight_bits(exposed.picture(image)[0], scene.caption)

    with ThreadPoolExecutor(1) as thread:  # each is made while the next frame is rendered
        waiting: Future[Pixels] | None = None
        for place, number in enumerate(frames):
            image = scene.frame(number)
            if waiting is not None:
                yield waiting.result()
                shown(place / len(frames))
            waiting = thread.submit(picture, image)
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
