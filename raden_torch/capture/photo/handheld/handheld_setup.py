"""What a person says of footage by hand: what lies on the board, and how it was taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats, Floats32
from raden_torch.capture.photo.board import Board
from raden_torch.capture.photo.handheld.lamp_sights import ChromeBall, FlatMirror, Shadow
from raden_torch.errors import InputError

FEWEST = 4
"""Photographs; fewer tell of no lamp."""


@dataclass(frozen=True, eq=False)
class GreyPatch:
    """A matt grey patch on the board: its middle, metres, and its reflectance, 0…1."""

    x_m: float
    y_m: float
    reflectance: float

    def __post_init__(self) -> None:
        if not 0 < self.reflectance <= 1.2:
            raise InputError(
                f"grey patch: reflectance factor: expected above 0 and at most 120, got "
                f"{100 * self.reflectance:g}"
            )


@dataclass(frozen=True, eq=False)
class HandheldSetup:
    """What lies before the phone, and what shows the lamp.

    Attributes:
        board: as printed.
        region_m: `[n, 2]` corners of the piece on the board, metres.
        white_m: `[n, 2]` corners of the white reference, which is matt and alike all over.
        lamp_on_camera: whether the lamp is fixed to the camera, as a phone's flash; else it stands
            beside the board, in each clip elsewhere.
        flash_m: `[3]` of a lamp on the camera, in its frame (x right, y up, z to the viewer),
            metres; None: found by balls and mirrors.
        balls, mirrors, shadows: what shows the lamp.
        greys: what shows the tone curve; none: it is taken for sRGB's, or for what `response` says.
        response: `[256]` stored value → linear light; None: as above.
        locked: the exposure was the same in all pictures.
        camera: a camera file; None: calibrated on the pictures themselves.
        photographs: to choose, at most.
        most_blur_px: standard deviation from which a picture counts as blurred.
        every: frames of a video of which the sharpest is looked at; None: as many as make
            `judging.LOOKED_AT`.
    """

    board: Board
    region_m: Floats
    white_m: Floats
    lamp_on_camera: bool = False
    flash_m: Floats | None = None
    balls: tuple[ChromeBall, ...] = ()
    mirrors: tuple[FlatMirror, ...] = ()
    shadows: tuple[Shadow, ...] = ()
    greys: tuple[GreyPatch, ...] = ()
    response: Floats32 | None = None
    locked: bool = False
    camera: Path | None = None
    photographs: int = 60
    most_blur_px: float = 1.5
    every: int | None = None

    def __post_init__(self) -> None:
        if self.flash_m is not None and not np.isfinite(self.flash_m).all():
            raise InputError("flash: expected three finite numbers, got others")
        if self.flash_m is not None and not self.lamp_on_camera:
            raise InputError("flash: expected a lamp on the camera, got one beside the board")
        if not (self.balls or self.mirrors or self.shadows or self.flash_m is not None):
            raise InputError(
                "lamp: expected what shows where it is (a chrome ball, a flat mirror or a pin's "
                "shadow, or the flash's place), got none"
            )
        if self.lamp_on_camera and self.shadows:
            raise InputError("shadow: expected a lamp that stands still, got one on the camera")
        if self.photographs < FEWEST:
            raise InputError(
                f"photographs: expected {FEWEST} or more to choose, got {self.photographs}"
            )
        if not self.most_blur_px > 0:
            raise InputError(f"blur: expected above 0 pixels, got {self.most_blur_px:g}")
        if self.every is not None and self.every < 1:
            raise InputError(f"every: expected 1 frame or more, got {self.every}")

    @property
    def middle_m(self) -> Floats:
        """`[3]` of the piece."""
        return np.append(self.region_m[:, :2].mean(axis=0), 0.0)
