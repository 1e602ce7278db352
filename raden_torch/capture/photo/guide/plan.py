"""A plan of photographs: what is photographed, how, and where lamp and camera stand for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.guide.choice import most_telling
from raden_torch.capture.photo.guide.piece import Piece
from raden_torch.capture.photo.guide.set_up import HAND, STILL, TURNTABLE, SetUp, Stance, stances
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement
from raden_torch.reflectance.log_readings import LogReadings
from raden_torch.reflectance.symmetric_kriging import FEWEST, Lengths, likely_lengths

MOST = 300
_MOST_KNOWN = 600
_TYPICAL_STD = 0.35
"""Of the logarithm of Y that the process has on simulated shells."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Photographs to take, in this order.

    Attributes:
        name: of the sample.
        assume: what is declared of it, as for `fit`; None: nothing.
        readings: `[K, 3]` of each photograph.
        known: `[M, 3]` what was read before.
        expected: `[1 + N]`, the expected relative error of Y, median over the hemisphere to 80
            degrees: before, and after each photograph. A forecast, by shells that were simulated or
            by the readings so far.
    """

    name: str
    piece: Piece
    set_up: SetUp
    assume: str | None
    stances: list[Stance]
    readings: list[Floats]
    expected: Floats
    known: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def __str__(self) -> str:
        return "\n".join([self.head(), *self.instructions(), self.forecast()])

    def head(self) -> str:
        who = f"{self.name}: " if self.name else ""
        return f"{who}{len(self.stances)} photographs of {self.piece.described()}"

    def instructions(self) -> list[str]:
        """One line a photograph."""
        return [f"{k + 1:3d}. {said(s, self.set_up)}" for k, s in enumerate(self.stances)]

    def forecast(self) -> str:
        before, after = 100 * self.expected[0], 100 * self.expected[-1]
        declared = f"declared {self.assume}" if self.assume else "nothing declared of symmetries"
        return (
            f"expected error of the hemisphere (median, {declared}): {before:.2g} % now, "
            f"{after:.2g} % after these"
        )


def plan_photographs(
    piece: Piece,
    set_up: SetUp,
    count: int,
    *,
    assume: str | None = None,
    measured: BrdfMeasurement | None = None,
    name: str = "",
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Choose where lamp and camera stand.

    Args:
        count: photographs, 1…`MOST`.
        assume: what is declared of the sample, as for `fit`.
        measured: the measurement so far; its readings count, and say how fast this shell's
            reflectance changes.

    Raises:
        InputError: a count out of its range; set-up and piece that do not go together; no place
            left.
    """
    if not 1 <= count <= MOST:
        raise InputError(f"count: expected 1 to {MOST} photographs, got {count}")
    if set_up.kind == TURNTABLE and len(piece.tilts_deg) > 1:
        raise InputError("turntable: expected one piece, which wedges lean, got several on wedges")
    if piece.shape == "plane" and piece.tilts_deg == (0.0,) and set_up.kind == STILL:
        raise InputError(
            "set_up: expected the camera or the piece moved (hand or turntable), since a flat "
            f"piece shows one place of the camera too little, got {set_up.kind!r}"
        )
    known, lengths, std = _known(measured, assume)
    possible = stances(set_up, piece.reach_mm)
    readings = [
        piece.angles_deg(np.array(stance.lamp_mm), np.array(stance.camera_mm))
        for stance in possible
    ]
    chosen, left = most_telling(
        readings, known, count, lengths=lengths, assume=assume, progress=progress
    )
    if not chosen:
        raise InputError("set_up: expected a lamp that lights what the camera sees, got none")
    return Plan(
        name,
        piece,
        set_up,
        assume,
        [possible[k] for k in chosen],
        [readings[k] for k in chosen],
        np.expm1(std * left),
        known,
    )


def _known(measured: BrdfMeasurement | None, assume: str | None) -> tuple[Floats, Lengths, float]:
    """What was read, some of it where it is much; the process' lengths and standard deviation."""
    if measured is None:
        return np.zeros((0, 3)), Lengths(), _TYPICAL_STD
    some = measured.select(measured.valid)
    angles = some.angles_deg
    rows = np.random.default_rng(0).permutation(len(angles))[:_MOST_KNOWN]
    if len(angles) < FEWEST:
        return angles, Lengths(), _TYPICAL_STD
    logs = LogReadings.of(angles[rows], some.as_xyz().values[rows])
    return angles[rows], likely_lengths(logs, assume), float(np.sqrt(logs.spread))


def said(stance: Stance, set_up: SetUp) -> str:
    """What a person with a protractor and a tape does."""
    lamp = (
        f"lamp {stance.lamp_from_vertical_deg:.0f} deg from the vertical, "
        f"{stance.lamp_azimuth_deg:.0f} deg round from {set_up.azimuth_from}, "
        f"{stance.lamp_distance_mm / 10:.0f} cm away"
    )
    if set_up.kind == HAND:
        camera = (
            f"camera {stance.camera_from_vertical_deg:.0f} deg from the vertical, "
            f"{stance.camera_azimuth_deg:.0f} deg round, {stance.camera_distance_mm / 10:.0f} cm "
            "away"
        )
        return f"{camera}; {lamp}"
    if set_up.kind == TURNTABLE:
        return f"wedge {stance.wedge_deg:.0f} deg, table turned {stance.turn_deg:.0f} deg; {lamp}"
    return lamp
