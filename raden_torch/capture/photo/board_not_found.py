"""Why no board was found in a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.capture.photo.board import Board

FEWEST_CORNERS = 6
_BLURRED_PX = 3.5
_UNCLEAR = (
    "other pictures show the board; here it is too blurred or too dark to be made out, or too "
    "little of it is in the picture"
)


class BoardNotFound(InputError):
    """A picture without a board.

    Attributes:
        beside_others: the message where other pictures show that the board is the right one.
    """

    def __init__(self, message: str, beside_others: str) -> None:
        super().__init__(message)
        self.beside_others = beside_others


def board_not_found(grey: NDArray[np.uint8], board: Board, name: str) -> BoardNotFound:
    """What to raise of a picture `[H, W]`; `name` is its own."""
    reason, may_be_another = _reason(grey, board)
    return BoardNotFound(f"{name}: {reason}", f"{name}: {_UNCLEAR if may_be_another else reason}")


def _reason(grey: NDArray[np.uint8], board: Board) -> tuple[str, bool]:
    """What is wrong, and whether the picture may show another board than the one looked for."""
    import cv2

    wanted = f"a {board.columns} x {board.rows} board of {board.dictionary}"
    if (grey > 250).mean() > 0.9:
        return f"expected {wanted}, got an image that is over-exposed nearly everywhere", False
    detector = cv2.aruco.ArucoDetector(board.opencv().getDictionary())
    for scale in (1.0, 0.5, 0.25, 0.125):
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if min(small.shape) < 32:
            break
        _, ids, _ = detector.detectMarkers(small)
        found = 0 if ids is None else len(ids)
        if found >= 3 and scale < 1:
            return (
                f"blurred: markers are found only at 1/{round(1 / scale)} of its size; focus, "
                "hold still, add light"
            ), False
        if found >= 3:
            return (
                f"expected {wanted}, got {found} markers that do not form one (fewer than "
                f"{FEWEST_CORNERS} corners fit); check the numbers of squares, their order "
                "(columns x rows) and the legacy setting, or show more of the board"
            ), True
    if _edges_px(grey) > _BLURRED_PX:
        return (
            f"expected {wanted}, got no board and a blurred image (its sharpest edges are "
            f"{_edges_px(grey):.0f} pixels wide); focus, hold still, add light, or name the right "
            "board"
        ), True
    return f"expected {wanted}, whole or nearly so, sharp and lit, got no board", True


def _edges_px(grey: NDArray[np.uint8]) -> float:
    """About how wide the sharpest edges are: the picture's range over its steepest slope."""
    low, high = np.quantile(grey, [0.02, 0.98])
    steepest = np.quantile(np.abs(np.diff(grey.astype(np.float32), axis=1)), 0.999)
    return float((high - low) / max(steepest, 1e-3))
