"""A room to see lacquer in: a lattice window of paper, a lamp, dim walls and a pale table.

A lat-long map made by code, so that pictures need no file. Lacquer is a dark mirror: what it shows
is the room, and the pale paper of a window is what brings out its depth and the shell's colours.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.shading.area_lights import on_rectangle
from raden_torch.brdf.shading.latlong import directions
from raden_torch.errors import InputError

_SAMPLES = 3
"""Rays per texel along each side."""
_WALL = (0.060, 0.054, 0.048)
_CEILING = (0.085, 0.078, 0.070)
_FLOOR = (0.050, 0.046, 0.042)
_PAPER = (1.00, 0.97, 0.92)


@dataclass(frozen=True)
class Window:
    """A lattice of paper panes, or one pane, in a plane.

    Attributes:
        middle, across, up: its middle from the object, and its half sides, in any unit of length.
        panes: across and up.
        bar: width of the wooden bars over a pane's; 0: none.
        radiance: of the paper, linear RGB.
        fading: how much darker its lower edge is than its upper one, 0…1.
    """

    middle: tuple[float, float, float]
    across: tuple[float, float, float]
    up: tuple[float, float, float]
    panes: tuple[int, int] = (1, 1)
    bar: float = 0.0
    radiance: tuple[float, float, float] = _PAPER
    fading: float = 0.0

    def light(self, towards: Tensor) -> Tensor:
        """`[3, N]` radiance and `[1, N]` cover below each other, for directions `[3, N]`."""
        middle, across, up = (
            torch.tensor(x, dtype=towards.dtype) for x in (self.middle, self.across, self.up)
        )
        origin = torch.zeros_like(towards[:, :1])
        (u, v), reach, _ = on_rectangle(origin, towards, middle, across, up)
        inside = (reach > 0) & (u.abs() < 1) & (v.abs() < 1)
        for place, count in ((u, self.panes[0]), (v, self.panes[1])):
            within = torch.remainder((place + 1) / 2 * count, 1.0)
            inside &= (within - 0.5).abs() < 0.5 - self.bar / 2
        shade = 1 - self.fading * (1 - v.clamp(-1, 1)) / 2
        colour = towards.new_tensor(self.radiance)[:, None] * shade
        cover = inside.to(towards.dtype)[None]
        return torch.cat([colour * cover, cover])


SHOJI = (
    # a skylight beyond what the lid mirrors, which colours the shell; a lattice window whose image
    # lies in the lacquer; a window at the right side; a paper lamp at the left
    Window((-0.6, 3.1, -2.3), (0.62, 0.0, 0.0), (0.0, 0.30, 0.40), (1, 1), 0.0, (30.0, 30.0, 30.0)),
    Window((-1.62, 2.35, -3.4), (0.78, 0.0, -0.1), (0.0, 0.95, 0.0), (3, 4), 0.15,
           (1.7, 1.68, 1.62), 0.5),
    Window((4.2, 1.6, 1.4), (-0.5, 0.0, 1.2), (0.0, 1.1, 0.0), (3, 4), 0.07, (2.6, 2.6, 2.6), 0.3),
    Window((-4.2, 2.4, 3.2), (0.5, 0.0, 0.5), (0.0, 0.7, 0.0), (1, 1), 0.0, (7.0, 4.9, 3.2), 0.2),
)  # fmt: skip
"""What lights `room` unless one says otherwise."""


def room(height: int = 256, windows: tuple[Window, ...] = SHOJI) -> Tensor:
    """`[3, height, 2 · height]` linear RGB of the room, as `EnvironmentLight` takes it.

    Args:
        height: rows, 8…4096.
        windows: what shines; the first covers those after it.
    """
    if not 8 <= height <= 4096:
        raise InputError(f"room: expected 8…4096 rows, got {height}")
    fine = directions(height * _SAMPLES, 2 * height * _SAMPLES).double().flatten(1)
    up = fine[1]
    # walls grow dimmer towards the floor; the ceiling is lit by what comes in
    high = torch.sigmoid((up - 0.62) / 0.05)
    low = torch.sigmoid((-up - 0.08) / 0.03)
    wall, ceiling, floor = (fine.new_tensor(c)[:, None] for c in (_WALL, _CEILING, _FLOOR))
    light = wall * (0.75 + 0.5 * up.clamp(-0.5, 0.8)) * (1 - high - low)
    light = light.clamp(min=0) + ceiling * high + floor * low
    for window in reversed(windows):
        shone = window.light(fine)
        light = light * (1 - shone[3]) + shone[:3]
    image = light.reshape(1, 3, height * _SAMPLES, -1)
    return torch.nn.functional.avg_pool2d(image, _SAMPLES)[0].float().contiguous()
