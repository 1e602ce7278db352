"""A lamp as the sample's points see it: which way, and how bright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.capture_settings import CaptureSetup
from raden_torch.capture.photo.brdf.rays import carried
from raden_torch.capture.photo.brdf.shots import Shot
from raden_torch.capture.photo.camera import Camera, Pose
from raden_torch.capture.photo.directions import directions_across
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.errors import InputError

LEAN_DEG = 0.1
"""By which a lamp is turned to see what that does."""
LAMP_STD_DEG = 0.5
"""Of a lamp's direction, where neither the lights file nor the person states one."""


@dataclass(frozen=True, eq=False)
class Lamp:
    """One lamp in the frame of one photograph's camera.

    Attributes:
        direction: `[3]` unit, to the lamp.
        position: `[3]` of a near lamp, else None.
        rgb: `[3]` relative irradiance at the sample's middle, as the lights file knows it.
        std_deg: standard deviation of its direction, in each of two directions across it.
        across: `[2, 3]` these directions: two lamps that are one have the same error along them.
        number: in the lights file, from 0.
    """

    direction: Floats
    position: Floats | None
    rgb: Floats
    std_deg: float
    across: Floats
    number: int = 0

    def turned(self, lean_deg: Floats, middle: Floats) -> Lamp:
        """The lamp turned about the sample's middle by small angles `[2]` along `across`."""
        lean = np.radians(lean_deg) @ self.across
        position = self.position
        if position is not None:
            away = position - middle
            distance = np.linalg.norm(away)
            away = away / distance + lean
            position = middle + distance * away / np.linalg.norm(away)
        direction = self.direction + lean
        return replace(self, direction=direction / np.linalg.norm(direction), position=position)

    def carried(self, before: Pose, after: Pose) -> Lamp:
        """The lamp that stands beside the board: from the camera's frame at one pose of the board
        to that at another."""
        return replace(
            self,
            direction=carried(self.direction, before, after, point=False),
            across=carried(self.across, before, after, point=False),
            position=None if self.position is None else carried(self.position, before, after),
        )

    def at(self, points: Floats, middle: Floats) -> tuple[Floats, Floats]:
        """Unit directions `[P, 3]` from points to the lamp, and the irradiance `[P]` on a plane
        that faces it, relative to that at the sample's middle: (d_middle / d)²."""
        if self.position is None:
            return np.broadcast_to(self.direction, points.shape), np.ones(len(points))
        to_lamp = self.position - points
        square = (to_lamp**2).sum(1)
        reference = float(((self.position - middle) ** 2).sum())
        return to_lamp / np.sqrt(square)[:, None], reference / square


def lamps_of_shots(
    lamps: Lamps,
    shots: Sequence[Shot],
    camera: Camera | None,
    setup: CaptureSetup,
    seen_in: Pose | None,
) -> list[Lamp]:
    """Each shot's lamp, in the frame of its camera.

    Args:
        lamps: those of the lights file.
        setup: its `lights` is named in messages.
        seen_in: the pose of the board in the photograph in whose frame the lights file is, where
            the lamps stand still beside the board and the camera moves; None: they stand still
            beside the camera.

    Raises:
        InputError: positions in another unit than the camera's, or a shot without a pose.
    """
    unit = "px" if camera is None else "mm"
    if lamps.position is not None and lamps.unit != unit:
        raise InputError(
            f"{setup.lights}: its lamps' positions are in {lamps.unit}; "
            + (
                "give the camera file"
                if camera is None
                else "find them with `raden capture lights --camera`"
            )
        )
    found = []
    for shot in shots:
        k = shot.lamp
        rgb = lamps.intensity[k] * (np.ones(3) if lamps.tint is None else lamps.tint[k])
        direction = lamps.direction[k]
        across = directions_across(direction)
        position = None if lamps.position is None else lamps.position[k]
        std_deg = setup.lamp_std_deg
        if std_deg is None:
            std_deg = LAMP_STD_DEG if lamps.std_deg is None else float(lamps.std_deg[k])
        lamp = Lamp(direction, position, rgb, std_deg, across, k)
        if seen_in is not None:
            if shot.pose is None:
                raise InputError(
                    f"{shot.files[0]}: the board's pose in it is not known; with lamps that stand "
                    "beside the board each photograph needs one"
                )
            lamp = lamp.carried(seen_in, shot.pose)
        found.append(lamp)
    return found
