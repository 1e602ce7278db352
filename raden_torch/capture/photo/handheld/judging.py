"""Which pictures of a clip are worth keeping: sharp, and showing the board."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.board import Board, BoardView, find_board
from raden_torch.capture.photo.board_not_found import BoardNotFound
from raden_torch.capture.photo.handheld.edge_blur import Blur, edge_blur
from raden_torch.capture.photo.handheld.footage import Clip, Picture, pictures
from raden_torch.errors import InputError
from raden_torch.images.shot_settings import ShotSettings, check_alike

LOOKED_AT = 300
"""Frames of all videos together that are looked at: of each group of neighbours the sharpest."""
_SMALL_PX = 480


@dataclass(frozen=True, eq=False)
class Judged:
    """A picture that was looked at.

    Attributes:
        name, clip, number: as of `Picture`.
        size: its height and width.
        view: of the board; None where it was not found.
        blur: of the board's edges.
        refused: why it is not kept, in a few words; "" where it may be.
        thumbnail: `[h, w, 3]`, for the sheet.
        other_way: as of `Picture`.
        beside_others: as `refused`, where the board was found in others but not in this one.
    """

    name: str
    clip: int
    number: int
    size: tuple[int, int]
    view: BoardView | None
    blur: Blur | None
    refused: str
    thumbnail: NDArray[np.uint8]
    other_way: bool = False
    beside_others: str = ""

    @property
    def reason(self) -> str:
        """Why it is not kept, without its numbers."""
        return self.refused.split(":")[0]

    def because(self, reason: str) -> Judged:
        """The same, not kept."""
        return replace(self, refused=reason)


def judged(
    clips: Sequence[Clip],
    board: Board,
    *,
    most_blur_px: float,
    every: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Judged]:
    """Look at the pictures of all clips: of every `every` frames of a video at the sharpest.

    Args:
        most_blur_px: standard deviation from which a picture counts as blurred.
        every: frames, 1 or more; None: such that `LOOKED_AT` are looked at. Stills are all.
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: as for `pictures`; pictures of another size or camera than the first's; no
            picture in which the board is found, with what is wrong in the first of them.
    """
    frames = sum(len(clip) for clip in clips if clip.video is not None)
    group = every or max(1, -(-frames // LOOKED_AT))
    total = max(1, sum(len(clip) for clip in clips))
    found: list[Judged] = []
    settings: list[tuple[Path, ShotSettings]] = []
    before = 0
    for place, clip in enumerate(clips):
        for picture in _sharpest(pictures(clip, place), group if clip.video is not None else 1):
            _check_size(picture, found)
            settings.append((Path(picture.name), picture.settings))
            check_alike(settings)
            found.append(_judge(picture, board, most_blur_px))
            board = found[-1].view.board if found[-1].view is not None else board
            if progress is not None:
                progress(min(1.0, (before + picture.number + 1) / total))
        before += len(clip)
    if not any(each.view is not None for each in found):
        raise InputError(
            f"{clips[0].name}: expected pictures that show the board, got none in {len(found)}: "
            f"{found[0].refused}"
        )
    return [each.because(each.beside_others or each.refused) for each in found]


def reasons(looked: Iterable[Judged]) -> list[tuple[str, int]]:
    """Why pictures are not kept, and how many for each reason, the most frequent first."""
    return Counter(each.reason for each in looked if each.refused).most_common()


def _sharpest(all_of: Iterator[Picture], group: int) -> Iterator[Picture]:
    """Of each so many neighbours the one whose finest detail is strongest."""
    best: tuple[float, Picture] | None = None
    count = 0
    for picture in all_of:
        detail = _detail(picture.pixels) if group > 1 else 0.0
        if best is None or detail > best[0]:
            best = detail, picture
        count += 1
        if count == group:
            yield best[1]
            best, count = None, 0
    if best is not None:
        yield best[1]


def _detail(pixels: NDArray[np.uint8]) -> float:
    """Variance of the green channel's second derivative."""
    import cv2

    return float(cv2.Laplacian(pixels[::2, ::2, 1], cv2.CV_32F).var())


def _judge(picture: Picture, board: Board, most_blur_px: float) -> Judged:
    import cv2

    height, width = picture.pixels.shape[:2]
    scale = min(1.0, _SMALL_PX / max(height, width))
    small = cv2.resize(picture.pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(picture.pixels, cv2.COLOR_RGB2GRAY)
    view, blur, refused, beside_others = None, None, "", ""
    try:
        view = find_board(grey, board, picture.name)
    except InputError as error:
        refused = _no_board(picture, str(error))
        if isinstance(error, BoardNotFound):
            beside_others = _no_board(picture, error.beside_others)
    else:
        blur = edge_blur(grey, view)
        if blur is None:
            refused = "too little of the board is seen to tell whether it is sharp"
        elif blur.worst_px > most_blur_px:
            what = "moved" if blur.is_motion else "out of focus"
            refused = f"{what}: edges are blurred by {blur.worst_px:.1f} px"
    return Judged(
        picture.name,
        picture.clip,
        picture.number,
        (height, width),
        view,
        blur,
        refused,
        small,
        picture.other_way,
        beside_others,
    )


def _no_board(picture: Picture, why: str) -> str:
    return "no board found: " + why.removeprefix(f"{picture.name}: ")


def _check_size(picture: Picture, others: Sequence[Judged]) -> None:
    if others and picture.pixels.shape[:2] != others[0].size:
        (height, width), (h, w) = picture.pixels.shape[:2], others[0].size
        raise InputError(
            f"{picture.name}: expected pictures of one camera, all of {w} x {h} pixels as "
            f"{others[0].name}, got {width} x {height} (was the phone turned?)"
        )
