"""What a person can place where: three set-ups, and all stances of lamp and camera in each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.exchange.directions import unit_vectors
from raden_torch.capture.photo.directions import apart_deg
from raden_torch.errors import InputError

HAND, TURNTABLE, STILL = "hand", "turntable", "still"
SET_UPS = {
    HAND: "the piece lies still; camera and lamp are moved by hand",
    TURNTABLE: "the camera stands still; the piece is turned, and tilted by wedges; one lamp is "
    "moved",
    STILL: "camera and piece stand still; one lamp is moved",
}
BODY_MM = 60.0
"""Of a camera or lamp from its middle: so near to the other's ray it throws a shadow."""
ABOVE_MM = 40.0
"""Of the lamp's middle over the table, at least."""
_LAMP_STEP_DEG, _CAMERA_STEP_DEG, _TURN_STEP_DEG = 5.0, 10.0, 30.0
_WEDGES_DEG = (0.0, 15.0, 30.0, 45.0)


@dataclass(frozen=True)
class SetUp:
    """A set-up and its limits.

    Attributes:
        kind: a key of `SET_UPS`.
        camera_mm: from the piece's middle.
        camera_deg: of a camera that stands still, from the vertical.
        lamp_mm: least and greatest distance of the lamp from the piece's middle.
        camera_to_deg, lamp_to_deg: from the piece's normal, at most.

    Raises:
        InputError: limits that leave no place, or none that a person can reach.
    """

    kind: str = HAND
    camera_mm: float = 400.0
    camera_deg: float = 40.0
    lamp_mm: tuple[float, float] = (300.0, 600.0)
    camera_to_deg: float = 60.0
    lamp_to_deg: float = 70.0

    def __post_init__(self) -> None:
        if self.kind not in SET_UPS:
            raise InputError(f"set_up: expected {', '.join(SET_UPS)}, got {self.kind!r}")
        low, high = self.lamp_mm
        if not 0 < low <= high < 1e5:
            raise InputError(
                "lamp: distance: expected the least and the greatest, above 0 mm, got "
                f"{low:g} and {high:g} mm"
            )
        if not 0 < self.camera_mm < 1e5:
            raise InputError(f"camera: distance: expected above 0 mm, got {self.camera_mm:g} mm")
        limits = {
            "camera: angle": self.camera_deg,
            "camera: limit": self.camera_to_deg,
            "lamp: limit": self.lamp_to_deg,
        }
        for name, value in limits.items():
            if not 0 <= value <= 85:
                raise InputError(
                    f"{name}: expected 0 to 85 deg from the normal, where it still lights or sees "
                    f"the piece, got {value:g} deg"
                )
        if self.kind == STILL and self.camera_deg > self.camera_to_deg:
            raise InputError(
                f"camera: angle: expected at most its limit of {self.camera_to_deg:g} deg, got "
                f"{self.camera_deg:g} deg"
            )

    @property
    def azimuth_from(self) -> str:
        """Where azimuths begin."""
        return "the mark" if self.kind == HAND else "the camera's side"


@dataclass(frozen=True)
class Stance:
    """Lamp and camera for one photograph.

    Attributes:
        lamp_mm, camera_mm: places in the piece's frame (`piece.py`).
        turn_deg, wedge_deg: of the piece on the table: first leaning by the wedge, its x side down,
            then turned counter-clockwise seen from above; 0 where it lies still.
        lamp_from_vertical_deg, lamp_azimuth_deg, lamp_distance_mm: as a person sets the lamp up
            over the table; the azimuth counter-clockwise from where the camera stands (turntable,
            still) or from the mark along x (hand).
        camera_from_vertical_deg, camera_azimuth_deg, camera_distance_mm: of the camera.
    """

    lamp_mm: tuple[float, float, float]
    camera_mm: tuple[float, float, float]
    turn_deg: float
    wedge_deg: float
    lamp_from_vertical_deg: float
    lamp_azimuth_deg: float
    lamp_distance_mm: float
    camera_from_vertical_deg: float
    camera_azimuth_deg: float
    camera_distance_mm: float


def stances(set_up: SetUp, reach_mm: float, *, most: int = 2500) -> list[Stance]:
    """All stances of a set-up, or `most` of them at random.

    Left out are those in which camera and lamp stand in each other's way (the ray of one passes
    within `BODY_MM` of the other's middle), a lamp below the table or
    less than `ABOVE_MM` over it, and angles beyond the limits.

    Args:
        reach_mm: of the piece around its middle.

    Raises:
        InputError: none is left.
    """
    table = np.array(_table(set_up))
    lamps, cameras = _in_piece(table)
    possible = np.flatnonzero(_possible(set_up, table, lamps, cameras, reach_mm))
    if not len(possible):
        raise InputError(
            "set_up: expected limits that leave a place for lamp and camera, got none; allow the "
            "lamp a greater distance or angle, or the camera another angle"
        )
    rows = np.random.default_rng(0).permutation(len(possible))[:most]
    return [
        Stance(_place(lamps[k]), _place(cameras[k]), *(float(v) for v in table[k]))
        for k in possible[np.sort(rows)]
    ]


def _table(set_up: SetUp) -> list[tuple[float, ...]]:
    """turn, wedge, lamp's angle, azimuth and distance, camera's angle, azimuth and distance."""
    low, high = set_up.lamp_mm
    middle = 10.0 * round((low * high) ** 0.5 / 10)
    reaches = sorted({low, min(max(middle, low), high), high})
    lamps = [
        (angle, azimuth, reach)
        for angle in np.arange(0, 90, _LAMP_STEP_DEG)
        for azimuth in np.arange(0, 360, 15.0 if angle else 360.0)
        for reach in reaches
    ]
    if set_up.kind == HAND:
        steps = np.arange(0, set_up.camera_to_deg + 1e-6, _CAMERA_STEP_DEG)
        return [
            (0, 0, *lamp, angle, azimuth, set_up.camera_mm)
            for angle in steps
            for azimuth in ((0.0, 45.0, 90.0) if angle else (0.0,))
            for lamp in lamps
        ]
    camera = set_up.camera_deg, 0.0, set_up.camera_mm
    if set_up.kind == STILL:
        return [(0, 0, *lamp, *camera) for lamp in lamps]
    return [
        (turn, wedge, *lamp, *camera)
        for wedge in _WEDGES_DEG
        for turn in np.arange(0, 360, _TURN_STEP_DEG if wedge else 360.0)
        for lamp in lamps
    ]


def _possible(
    set_up: SetUp, table: Floats, in_piece_lamp: Floats, in_piece_camera: Floats, reach_mm: float
) -> Bools:
    lamp = from_polar(table[:, 2], table[:, 3], table[:, 4])
    camera = from_polar(table[:, 5], table[:, 6], table[:, 7])
    apart = np.radians(apart_deg(lamp / table[:, 4:5], camera / table[:, 7:8]))  # at the piece
    near, far = (pick(table[:, 4], table[:, 7]) for pick in (np.minimum, np.maximum))
    # the rays between the piece and the farther one, where they pass the nearer one
    clear = near * np.sin(np.minimum(apart, np.pi / 2)) > BODY_MM + reach_mm * (far - near) / far
    above = lamp[:, 2] > ABOVE_MM
    lit = in_piece_lamp[:, 2] / table[:, 4] > np.cos(np.radians(set_up.lamp_to_deg + 1e-6))
    seen = in_piece_camera[:, 2] / table[:, 7] > np.cos(np.radians(set_up.camera_to_deg + 1e-6))
    return np.asarray(clear & above & lit & seen)


def _in_piece(table: Floats) -> tuple[Floats, Floats]:
    """Places of lamp and camera `[N, 3]`, from the table's frame to the piece's."""
    turn, wedge = np.radians(table[:, 0]), np.radians(table[:, 1])
    found = []
    for columns in (table[:, 2:5], table[:, 5:8]):
        x, y, z = from_polar(*columns.T).T
        x, y = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        x, z = x * np.cos(wedge) - z * np.sin(wedge), x * np.sin(wedge) + z * np.cos(wedge)
        found.append(np.stack([x, y, z], 1))
    return found[0], found[1]


def from_polar(angle_deg: Floats, azimuth_deg: Floats, distance: Floats) -> Floats:
    """`[N, 3]` places over a table, by angles from the vertical and round it."""
    return np.asarray((unit_vectors(angle_deg, azimuth_deg) * distance).T)


def _place(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 3) for v in point)
    return x, y, z
