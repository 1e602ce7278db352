"""What stands before the simulated camera, in Mitsuba's words. Lengths are millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.simulation.colours import chart_colours

CHROME = 0.6
"""Reflectance of the chrome balls."""
_PIXELS_A_SQUARE = 60
_PIXELS_A_PATCH = 40


@dataclass(frozen=True)
class Lamp:
    """A small lamp that shines alike in all directions.

    Attributes:
        position_mm: in the world.
        intensity: `[3]` in the simulation's channels; a white that faces it at d mm has the
            radiance intensity / (π d²).
        radius_mm: of the ball that mirrors show; the light comes from its middle.
    """

    position_mm: tuple[float, float, float]
    intensity: tuple[float, float, float]
    radius_mm: float


@dataclass(frozen=True)
class Ball:
    centre_mm: tuple[float, float, float]
    radius_mm: float


@dataclass(frozen=True, eq=False)
class Sheet:
    """A flat rectangle.

    Attributes:
        corner_mm: its upper left corner.
        right, down: `[3]` unit vectors along its edges; right × down points into it.
        width_mm, height_mm: of its edges.
    """

    corner_mm: Floats
    right: Floats
    down: Floats
    width_mm: float
    height_mm: float

    def at(self, x: float, y: float) -> Floats:
        """A point of it, x and y in mm from its upper left corner."""
        return np.asarray(self.corner_mm + x * self.right + y * self.down)

    @property
    def normal(self) -> Floats:
        """`[3]` towards the viewer."""
        return np.asarray(np.cross(self.down, self.right))


@dataclass(frozen=True)
class PrintedBoard:
    """A ChArUco board of OpenCV's."""

    columns: int = 7
    rows: int = 5
    square_mm: float = 12.0
    marker_mm: float = 9.0
    dictionary: str = "DICT_6X6_250"

    @property
    def size_mm(self) -> tuple[float, float]:
        return self.columns * self.square_mm, self.rows * self.square_mm

    def picture(self) -> NDArray[np.float32]:
        """`[H, W]` reflectance, ink 0.04 and paper 0.85."""
        import cv2

        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square_mm, self.marker_mm, markers
        )
        size = self.columns * _PIXELS_A_SQUARE, self.rows * _PIXELS_A_SQUARE
        ink = np.asarray(board.generateImage(size)) < 128
        return np.where(ink, 0.04, 0.85).astype(np.float32)


def sphere(ball: Ball, bsdf: Any) -> dict[str, Any]:
    shape = {"type": "sphere", "center": list(ball.centre_mm), "radius": ball.radius_mm}
    return shape | {"bsdf": bsdf}


def rod(start: Floats, end: Floats, radius_mm: float, bsdf: Any) -> dict[str, Any]:
    """A cylinder's mantle."""
    ends = {"p0": np.asarray(start).tolist(), "p1": np.asarray(end).tolist()}
    return {"type": "cylinder", **ends, "radius": radius_mm, "bsdf": bsdf}


def sheet(mi: Any, place: Sheet, bsdf: Any) -> dict[str, Any]:
    """A rectangle, black from behind."""
    matrix = np.eye(4)
    matrix[:3, 0] = place.right * place.width_mm / 2
    matrix[:3, 1] = -place.down * place.height_mm / 2
    matrix[:3, 2] = place.normal
    matrix[:3, 3] = place.at(place.width_mm / 2, place.height_mm / 2)
    shape = {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix.tolist())}
    return shape | {"bsdf": bsdf}


def matt(*reflectance: float) -> dict[str, Any]:
    """A Lambertian surface; one number is grey."""
    value = list(reflectance) if len(reflectance) == 3 else reflectance[0]
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def printed(mi: Any, picture: NDArray[np.float32]) -> dict[str, Any]:
    """A Lambertian print: `[H, W]` or `[H, W, 3]` reflectances, upper row first."""
    colours = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, 2)
    # v runs upwards over a rectangle
    bitmap = mi.Bitmap(np.ascontiguousarray(colours[::-1], np.float32))
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "nearest"}
    return {"type": "diffuse", "reflectance": texture}


def chrome() -> dict[str, Any]:
    """A perfect mirror that keeps `CHROME` of the light."""
    colour = {"type": "rgb", "value": CHROME}
    return {"type": "conductor", "material": "none", "specular_reflectance": colour}


def chart_picture() -> NDArray[np.float32]:
    """`[H, W, 3]` a ColorChecker in its black frame: 6 x 4 patches, half a patch around them."""
    pitch, gap = _PIXELS_A_PATCH, 3
    picture = np.full((5 * pitch, 7 * pitch, 3), 0.03, np.float32)
    for number, colour in enumerate(chart_colours()):
        row, column = divmod(number, 6)
        y, x = (round((n + 0.5) * pitch) for n in (row, column))
        picture[y + gap : y + pitch - gap, x + gap : x + pitch - gap] = colour
    return picture
