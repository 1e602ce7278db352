"""ChArUco boards in a photograph: their corners, whichever of the two patterns was printed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.board_not_found import FEWEST_CORNERS, board_not_found
from raden_torch.errors import InputError

_OUTLIER_PX = 3.0


@dataclass(frozen=True)
class Board:
    """A ChArUco board as it was printed.

    Attributes:
        columns: squares of the chessboard along a row, 2…100.
        rows: squares down a column, 2…100.
        square_m: side of a square, measured on the print, metres, above 0.
        marker_m: side of a marker, metres, above 0 and below that of a square.
        dictionary: of the markers, by OpenCV's name, "DICT_6X6_250".
        legacy: whether a board with an even number of rows starts with a black square, as before
            OpenCV 4.6; None where `find_board` is to find out. With an odd number the two are one.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str = "DICT_6X6_250"
    legacy: bool | None = None

    def __post_init__(self) -> None:
        import cv2

        if not (2 <= self.columns <= 100 and 2 <= self.rows <= 100):
            raise InputError(
                f"board: expected 2…100 squares each way, got {self.columns} x {self.rows}"
            )
        if not 0 < self.marker_m < self.square_m < np.inf:
            raise InputError(
                f"board: expected 0 < marker < square, got markers of {self.marker_m:g} m in "
                f"squares of {self.square_m:g} m"
            )
        known = [n for n in dir(cv2.aruco) if n.startswith("DICT_") and n == n.upper()]
        if self.dictionary not in known:
            names = ", ".join(known)
            raise InputError(f"dictionary: expected one of {names}, got {self.dictionary!r}")
        markers = self.columns * self.rows // 2
        there = len(self._dictionary().bytesList)
        if markers > there:
            raise InputError(
                f"board of {self.columns} x {self.rows} squares: expected a dictionary of at "
                f"least {markers} markers, got {self.dictionary} with {there}"
            )

    def _dictionary(self) -> Any:
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    def opencv(self) -> Any:
        """OpenCV's board; `legacy` None counts as the present pattern."""
        import cv2

        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square_m, self.marker_m, self._dictionary()
        )
        board.setLegacyPattern(bool(self.legacy))
        return board

    @property
    def corners_m(self) -> Floats:
        """`[n, 3]` all inner corners by number: x along the rows, y down the columns, z = 0."""
        return np.asarray(self.opencv().getChessboardCorners(), np.float64)


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board's corners in one photograph.

    Attributes:
        name: of the photograph.
        size: height and width of the photograph in pixels.
        board: with `legacy` as found.
        ids: `[n]` numbers of the corners.
        pixels: `[n, 2]`, x right, y down; (0, 0) is the centre of the first pixel.
    """

    name: str
    size: tuple[int, int]
    board: Board
    ids: NDArray[np.int32]
    pixels: Floats

    @property
    def points_m(self) -> Floats:
        """`[n, 3]` of the same corners, on the board."""
        return self.board.corners_m[self.ids]


def find_board(picture: NDArray[np.uint8], board: Board, name: str) -> BoardView:
    """Find a board's corners.

    Where the pattern is not stated both are tried; on boards with an odd number of rows they agree.

    Args:
        picture: `[H, W, 3]` RGB or `[H, W]` grey, 8 bits.
        name: of the photograph, for messages.

    Raises:
        BoardNotFound: no board, too few corners, another board, or blurred.
        InputError: two boards, or a picture of less than 32 pixels.
    """
    import cv2

    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    if min(grey.shape) < 32:
        raise InputError(
            f"{name}: expected a photograph of a board, got {grey.shape[1]} x {grey.shape[0]} "
            "pixels"
        )
    forms = [board] if board.legacy is not None else [replace(board, legacy=False)]
    if board.legacy is None and board.rows % 2 == 0:
        forms.append(replace(board, legacy=True))
    views = [view for form in forms if (view := _detected(grey, form, name)) is not None]
    if not views:
        raise board_not_found(grey, board, name)
    return max(views, key=lambda view: len(view.ids))


def draw_board(picture: NDArray[np.uint8], view: BoardView) -> NDArray[np.uint8]:
    """The picture with the corners that were found and their numbers."""
    import cv2

    drawn = picture.copy()
    width = max(1, max(view.size) // 800)
    for number, (x, y) in zip(view.ids, np.rint(view.pixels).astype(int), strict=True):
        cv2.circle(drawn, (x, y), 4 * width, (0, 255, 0), width, cv2.LINE_AA)
        for colour, thick in (((0, 0, 0), 2 * width + 1), ((255, 255, 0), width)):
            at = (x + 5 * width, y - 5 * width)
            cv2.putText(drawn, str(number), at, 0, 0.4 * width, colour, thick, cv2.LINE_AA)
    return drawn


def _detected(grey: NDArray[np.uint8], board: Board, name: str) -> BoardView | None:
    import cv2

    form = board.opencv()
    parameters = cv2.aruco.CharucoParameters()
    # OpenCV's own check compares distances in the picture and rejects boards seen at a slant
    # (opencv issue 25850); _fits asks the markers instead
    parameters.checkMarkers = False
    detector = cv2.aruco.CharucoDetector(form, parameters)
    corners, ids, quads, markers = detector.detectBoard(grey)
    if markers is not None:
        twice = [n for n, count in Counter(np.ravel(markers).tolist()).items() if count > 1]
        if len(twice) > 1:
            raise InputError(
                f"{name}: markers {twice[:4]} are there twice: two boards in one photograph; "
                "cover one, or print them with different dictionaries"
            )
    if corners is None or ids is None or len(ids) < FEWEST_CORNERS:
        return None
    if not _fits(form, quads, markers, grey.shape):
        return None
    numbers = np.ravel(ids).astype(np.int32)
    pixels = np.asarray(corners, np.float64).reshape(-1, 2)
    points = np.asarray(form.getChessboardCorners(), np.float64)[numbers, :2]
    plane, inlier = cv2.findHomography(points, pixels, cv2.RANSAC, _limit_px(grey.shape))
    if plane is None or inlier.sum() < FEWEST_CORNERS:
        return None
    keep = inlier.ravel() > 0
    if np.linalg.matrix_rank(points[keep] - points[keep].mean(axis=0), 1e-6) < 2:
        return None  # all in one row: no plane
    height, width = grey.shape
    return BoardView(name, (height, width), board, numbers[keep], pixels[keep])


def _fits(form: Any, quads: Any, markers: Any, shape: tuple[int, ...]) -> bool:
    """Whether the markers lie where this board has them: corners made from the markers' places on
    another board lie in a plane as well."""
    import cv2

    places = dict(zip(np.ravel(form.getIds()).tolist(), form.getObjPoints(), strict=True))
    known = [
        (places[n], quad)
        for n, quad in zip(np.ravel(markers).tolist(), quads, strict=True)
        if n in places
    ]
    if len(known) < 2:
        return False
    points, pixels = (np.concatenate([np.reshape(p[i], (4, -1)) for p in known]) for i in (0, 1))
    plane, inlier = cv2.findHomography(points[:, :2], pixels, cv2.RANSAC, _limit_px(shape))
    return plane is not None and bool(inlier.sum() > 0.8 * len(points))


def _limit_px(shape: tuple[int, ...]) -> float:
    """How far from a plane's picture a lens may bend a corner."""
    return max(_OUTLIER_PX, 0.01 * max(shape))
