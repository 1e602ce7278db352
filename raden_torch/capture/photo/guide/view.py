"""How much of a piece, and what lies around it, a known camera sees from where it stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.capture.photo.camera import Camera
from raden_torch.capture.photo.guide.piece import Piece
from raden_torch.errors import InputError

AROUND = 1.5
"""Times the piece's reach from its middle: white and board beside it are to be seen, too."""
NEAREST_MM = 200.0
"""No distance below this is proposed: few lenses focus there, and the camera hides the lamp."""
_STEP_MM = 10.0


@dataclass(frozen=True)
class View:
    """A camera that looks at a piece's middle.

    Attributes:
        camera_mm: from the piece's middle.
        mm_per_pixel: there.
        seen_mm: radius of the ball around the middle that is wholly in the picture from any side,
            without distortion.
        reach_mm: from the piece's middle, or that of a row of them, to its farthest edge.
    """

    camera_mm: float
    mm_per_pixel: float
    seen_mm: float
    reach_mm: float

    def __str__(self) -> str:
        return (
            f"camera {self.camera_mm / 10:g} cm away: {self.mm_per_pixel:.2g} mm a pixel; "
            f"{self.seen_mm:.0f} mm around the piece's middle are seen, it reaches "
            f"{self.reach_mm:.0f} mm"
        )


def view_of(piece: Piece, camera: Camera, camera_mm: float | None = None) -> View:
    """What is seen from a distance.

    Args:
        camera_mm: from the piece's middle; None: the least, in whole centimetres, from which
            `AROUND` times the piece's reach is seen, and not below `NEAREST_MM`.

    Raises:
        InputError: a distance from which the piece is not wholly seen.
    """
    sine, reach = float(np.sin(_half_angle(camera))), _reach_mm(piece)
    if camera_mm is None:
        least = max(NEAREST_MM, AROUND * reach / sine)
        camera_mm = _STEP_MM * float(np.ceil(least / _STEP_MM - 1e-9))
    elif camera_mm * sine < reach:
        raise InputError(
            f"camera: distance: expected {np.ceil(reach / sine):.0f} mm or more, from "
            f"which this camera sees the whole piece, got {camera_mm:g} mm"
        )
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    return View(camera_mm, camera_mm / focal, camera_mm * sine, reach)


def _reach_mm(piece: Piece) -> float:
    """Of its outline; `Piece.reach_mm` is that of points within it. Several flat pieces count as a
    row, end to end along their longer side, without room between them."""
    first, second = piece.size_mm
    if piece.shape == "plane":
        return float(np.hypot(len(piece.tilts_deg) * max(first, second), min(first, second))) / 2
    half = first / 2 if piece.shape == "cylinder" else 0.0
    return float(np.hypot(half, np.sqrt(2) * second))


def _half_angle(camera: Camera) -> float:
    """From the optical axis to the picture's nearest edge, radians."""
    height, width = camera.size
    x, y = camera.matrix[:2, 2] + 0.5  # a pixel's middle has whole coordinates
    fx, fy = np.diag(camera.matrix)[:2]
    edge = min(x / fx, (width - x) / fx, y / fy, (height - y) / fy)
    if edge <= 0:
        raise InputError("camera: expected its optical axis within the picture, got it outside")
    return float(np.arctan(edge))
