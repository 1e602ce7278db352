"""The film layers across a sheet of shell: how they lean, and how thick their tablets are.

A sheet is endless and the same at any resolution: sums of plane waves, drawn by a seed. Its layers
are not flat: they wave slowly and fold at growth lines; tablets change in bands along the direction
of growth. All of it is this project's assumption (docs/shells.md), shaped after photographs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

WAVES = 20
"""Plane waves of a field."""


@dataclass(frozen=True)
class Habit:
    """How the layers of one kind of shell lie. Lengths are in the plate's unit.

    Attributes:
        lean_deg: standard deviation of the layers' slope, as an angle, without growth lines.
        wave_length: longest and shortest wave of it.
        line_deg: amplitude of the growth lines' slope.
        line_pitch: mean distance between growth lines.
        tablets: relative standard deviation of the tablets' thickness over the sheet.
        band_length: longest and shortest wave of the thickness, along the growth.
    """

    lean_deg: float
    wave_length: tuple[float, float]
    line_deg: float
    line_pitch: float
    tablets: float
    band_length: tuple[float, float]


HABITS: dict[str, Habit] = {
    "yakogai": Habit(5.5, (2.4, 0.12), 0.8, 0.020, 0.040, (1.6, 0.15)),
    "abalone": Habit(8.0, (1.2, 0.07), 1.6, 0.014, 0.080, (0.8, 0.08)),
    "akoya": Habit(2.8, (2.4, 0.20), 0.4, 0.016, 0.025, (2.0, 0.20)),
    "awabi": Habit(6.5, (1.6, 0.10), 1.2, 0.016, 0.055, (1.0, 0.10)),
    "mexican": Habit(9.0, (1.0, 0.06), 2.0, 0.014, 0.090, (0.7, 0.07)),
}


def sheet(habit: Habit, u: Tensor, v: Tensor, pixel: float, seed: int) -> tuple[Tensor, Tensor]:
    """Slopes and tablet thickness at places of a sheet, as a sample of size `pixel` averages them.

    Args:
        u, v: `[N]` places; growth goes along v.
        pixel: size of a sample in the same unit: waves that are finer fade, so that a small map is
            a large one averaged.
        seed: draws the sheet.

    Returns:
        `[2, N]` slopes along u and v, and `[N]` thickness over the shell's own.
    """
    generator = torch.Generator().manual_seed(seed)
    lean = _Waves.drawn(generator, habit.wave_length, stretch=1.0).at(u, v, pixel)
    bands = _Waves.drawn(generator, habit.band_length, stretch=0.35).at(u, v, pixel)
    slope = lean.gradient * math.tan(math.radians(habit.lean_deg))
    # growth lines follow v, bent by the bands; their pitch is the mean
    bend = 0.35 * habit.band_length[1]
    phase = 2 * math.pi / habit.line_pitch * (v + bend * bands.value)
    strong = (1 + bands.value).clamp(0, 2) * _kept(2 * math.pi / habit.line_pitch, pixel)
    fold = torch.cos(phase + 1.5 * torch.sin(0.37 * phase)) * strong
    line = math.tan(math.radians(habit.line_deg)) * fold
    slope = slope + torch.stack([torch.zeros_like(line), line])
    tablets = 1 + habit.tablets * (bands.value + 0.15 * fold)
    return slope, tablets


def _kept(wave_number: Tensor | float, pixel: float) -> Tensor:
    """What averaging over a sample leaves of a wave: the box filter's, as a Gaussian."""
    return torch.exp(-((torch.as_tensor(wave_number) * pixel) ** 2) / 24)


@dataclass(frozen=True)
class _Field:
    """A field of variance 1, and the unit-variance slopes of one whose slopes have these waves."""

    value: Tensor
    gradient: Tensor


@dataclass(frozen=True)
class _Waves:
    """Plane waves `[WAVES]`: wave vectors and phases."""

    along_u: Tensor
    along_v: Tensor
    phase: Tensor

    @classmethod
    def drawn(
        cls, generator: torch.Generator, lengths: tuple[float, float], stretch: float
    ) -> _Waves:
        """Lengths spread evenly in octaves; `stretch` < 1 makes them long along u."""
        angle, phase, shift = torch.rand(3, WAVES, generator=generator, dtype=torch.float64)
        octave = (torch.arange(WAVES, dtype=torch.float64) + shift) / WAVES
        length = lengths[0] * (lengths[1] / lengths[0]) ** octave
        angle, number = 2 * math.pi * angle, 2 * math.pi / length
        across = stretch * torch.cos(angle)
        return cls(number * across, number * torch.sin(angle), 2 * math.pi * phase)

    def at(self, u: Tensor, v: Tensor, pixel: float) -> _Field:
        value, slope_u, slope_v = (torch.zeros_like(u) for _ in range(3))
        each = math.sqrt(2 / WAVES)
        number = torch.hypot(self.along_u, self.along_v)
        kept = each * _kept(number, pixel)
        waves = zip(self.along_u, self.along_v, self.phase, number, kept, strict=True)
        for k_u, k_v, phase, k, size in (map(float, wave) for wave in waves):
            angle = k_u * u + k_v * v + phase
            value += size * torch.cos(angle)
            swing = -size * torch.sin(angle) / k
            slope_u += k_u * swing
            slope_v += k_v * swing
        return _Field(value, torch.stack([slope_u, slope_v]))
