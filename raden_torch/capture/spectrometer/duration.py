"""How long will a scan take? A model, to plan the day by; the instruments decide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.spectrometer.rig import ANGLES, GoniometerSettings, angles_of
from raden_torch.capture.spectrometer.scan_plan import Plan
from raden_torch.capture.spectrometer.travel import longest_axis_deg
from raden_torch.capture.spectrometer.white_reference import White

READING_S = 3.0
"""What a reading takes where nobody says: a CS-2000 on a well-lit sample, its replies included."""
CHANGE_S = 5.0
"""To change between sample and white reference, or to shut the lamp, by motor."""
HOMING_S = 60.0


@dataclass(frozen=True)
class Duration:
    """The expected duration of a scan in seconds, part by part."""

    moving_s: float
    settling_s: float
    reading_s: float
    references_s: float
    homing_s: float = HOMING_S

    @property
    def total_s(self) -> float:
        return self.moving_s + self.settling_s + self.reading_s + self.references_s + self.homing_s

    def __str__(self) -> str:
        parts = (
            ("moving", self.moving_s),
            ("settling", self.settling_s),
            ("reading", self.reading_s),
            ("dark and white", self.references_s),
            ("homing", self.homing_s),
        )
        return f"{hours(self.total_s)} ({', '.join(f'{name} {hours(s)}' for name, s in parts)})"


def expected_duration(
    plan: Plan,
    settings: GoniometerSettings,
    white: White,
    *,
    every_s: float,
    readings: int,
    reading_s: float = READING_S,
) -> Duration:
    """Add up moves, settling, readings, and the trips to the white reference.

    The axes move together, so that a move takes its longest axis's degrees at the rig's speed; one
    that has to come from the other side first goes `approach_deg` further, and back. Accelerating
    is left out. What a plan decides on the way is not known: see `Plan.likely_cells`.
    """
    cells = plan.likely_cells()
    feed = settings.feed_deg_per_min
    speed = settings.rapid_deg_per_s if feed is None else feed / 60
    moves = longest_axis_deg(cells)
    from_above = _arrives_from_above(cells, settings)
    moving = (moves.sum() + 2 * settings.approach_deg * from_above) / speed
    settling = (settings.settle_s + settings.poll_s) * len(cells)
    reading = reading_s * plan.steps
    if plan.white_at_each:
        moving += CHANGE_S * len(cells)
    there = abs(cells - angles_of(white.position)).max(axis=1).mean() / speed
    series = 2 * readings * reading_s + 2 * there + 3 * CHANGE_S
    count = 2 + int((moving + settling + reading) / every_s)
    return Duration(float(moving), settling, reading, float(count * series))


def _arrives_from_above(cells: Floats, settings: GoniometerSettings) -> int:
    """How many moves have an axis whose motor falls."""
    directions = np.array([settings.axes[name].direction for name in ANGLES])
    return int((np.diff(cells * directions, axis=0) < 0).any(axis=1).sum())


def hours(seconds: float) -> str:
    """As 10:31 h, or 42 s where it is less than two minutes."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60}:{minutes % 60:02d} h"
