"""How a controller moves its axes: straight lines, one after another, each with two ramps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats


@dataclass(frozen=True)
class Segment:
    """A move from rest to rest: accelerate, cruise, decelerate (GRBL without look-ahead).

    The path is measured by its Euclidean length; speed and acceleration along it are the largest
    that no axis's own limit forbids.

    Attributes:
        start, end: positions `(axes,)`.
        began: the moment of departure, s.
        speed, acceleration: along the path, units/s and units/s².
    """

    start: Floats
    end: Floats
    began: float
    speed: float
    acceleration: float

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    @property
    def duration(self) -> float:
        ramp = self.speed / self.acceleration
        if self.length >= self.speed * ramp:
            return self.length / self.speed + ramp
        return 2 * math.sqrt(self.length / self.acceleration)

    def along(self, now: float) -> tuple[float, float]:
        """Distance covered and speed at a moment."""
        total, a = self.duration, self.acceleration
        t = min(max(now - self.began, 0.0), total)
        ramp = min(self.speed / a, total / 2)
        if t < ramp:
            return a * t**2 / 2, a * t
        if t > total - ramp:
            left = total - t
            return self.length - a * left**2 / 2, a * left
        return a * ramp**2 / 2 + a * ramp * (t - ramp), a * ramp

    def position(self, now: float) -> Floats:
        return self.start + self.direction * self.along(now)[0]

    @property
    def direction(self) -> Floats:
        length = self.length
        return (self.end - self.start) / length if length else np.zeros_like(self.start)

    def stopped_by_hold(self, now: float) -> tuple[Floats, float]:
        """Where and when it stands after decelerating from `now`."""
        covered, speed = self.along(now)
        stop = min(covered + speed**2 / (2 * self.acceleration), self.length)
        return self.start + self.direction * stop, now + speed / self.acceleration


def planned(
    start: Floats, end: Floats, began: float, rates: Floats, accelerations: Floats, feed: float
) -> Segment:
    """A segment within the limits of each axis and the feed (both per second)."""
    direction = np.abs(end - start)
    length = float(np.linalg.norm(direction)) or 1.0
    share = np.maximum(direction / length, 1e-12)
    speed = min(feed, float((rates / share).min()))
    return Segment(start, end, began, speed, float((accelerations / share).min()))
