"""A shell's reflection and its layers, from the inlay's own photographs.

Light and camera are known, the layers' normals and the reflection are not. Each pixel has two
unknown angles and K lamps' values, all pixels of a shell have one reflection: so both are found
from the photographs, but for a stretch of the tilts (the same pictures come of steeper layers and a
wider highlight), which changes nothing as long as the inlay is seen from where it was photographed.

The first reflections are grey bodies whose highlights stand at several tilts. In every turn a table
is fitted at the normals found so far (`shell_table.py`), and the normals are found anew by it. At
first values count as much less certain than they are, which keeps it from the nearest of many
minima; the bodies that explain the photographs best after a few turns go on to the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from raden_torch.stereo.learnt_model import MEAN, box_of, seen_share
from raden_torch.stereo.normal_refine import cauchy_cost
from raden_torch.stereo.observed_light import ObservedLight, sampled, shown
from raden_torch.stereo.shell_table import ShellTable, body, fitted, readings_deg
from raden_torch.stereo.solve import Known, ModelNormals, solve_by_model

_BODIES = ((8.0, 4.0, 0.0), (15.0, 4.0, 0.0), *((6.0, 6.0, t) for t in (8.0, 12.0, 16.0)),
           (10.0, 6.0, 12.0))  # fmt: skip
"""Width in degrees, height and tilt of the first highlights."""
_NOISE = (0.3, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.03, 0.03)
"""Standard deviation of a value over itself, turn by turn."""
_RACE, _GO_ON = 3, 2
"""After so many turns so many of the bodies go on."""
_FEW, MOST_PIXELS = 400, 1200
"""Pixels of a shell; the second number in the last turns."""
_LAST = 2
_SCALE_WIDTH, _START_WIDTH = 0.1, 0.3
"""Standard deviations of the logarithm of a pixel's brightness over the table's."""
_ODD = 3.0
"""A pixel whose cost is so many times the median counts half."""


@dataclass(frozen=True, eq=False)
class LearntShell:
    """What the photographs tell of a shell.

    Attributes:
        table: its reflection; `scale`: the photographs' value for a radiance of 1 of it.
        pixels: how many it was learnt from.
        residual: what is left, in standard deviations of 3 %.
        spread_deg: how far the layers lean to and fro, root mean square.
        seen: as `seen_share` says.
        box_deg: the least and greatest incidence, receiving and tilt that were seen.
    """

    table: ShellTable
    scale: float
    pixels: int
    residual: float
    spread_deg: float
    seen: float
    box_deg: tuple[tuple[float, float], ...]

    def as_dict(self) -> dict[str, object]:
        """For inlay.json and the model's provenance."""
        return {
            "pixels": self.pixels,
            "residual": round(self.residual, 3),
            "spread_deg": round(self.spread_deg, 2),
            "seen": round(self.seen, 4),
        }


@torch.no_grad()
def learn_shell(light: ObservedLight, done: Callable[[float], None]) -> LearntShell:
    """The reflection of pixels that show one shell.

    Args:
        light: its pixels; their surface is known.
        done: called with the share that is done, 0…1.
    """
    few, many = sampled(light, _FEW), sampled(light, MOST_PIXELS)
    scale = float(
        (light.value / (light.light * light.film_surface).sum(1)[:, None].clamp(min=0.1)).mean()
    )
    scale /= MEAN
    turns = len(_BODIES) * _RACE + _GO_ON * (len(_NOISE) - _RACE)
    made = 0
    race: list[tuple[float, int, ShellTable, ModelNormals]] = []

    def turn(on: ObservedLight, k: int, found: ModelNormals, start: ShellTable | None) -> _Turn:
        nonlocal made
        made += 1
        done(made / turns)
        return _turn(replace(on, relative=_NOISE[k]), found, scale, start)

    for place, each in enumerate(_BODIES):
        table, found = None, _first(body(*each), few)
        for k in range(_RACE):
            table, found = turn(few, k, found, table)
        assert table is not None
        race.append((_cost(table, few, found), place, table, found))
    best: tuple[float, ShellTable, ModelNormals] | None = None
    for _, _, start, found in sorted(race, key=lambda each: each[:2])[:_GO_ON]:
        table, on = start, few
        for k in range(_RACE, len(_NOISE)):
            if k == len(_NOISE) - _LAST:
                on, found = many, _solved(table, many, scale)
            table, found = turn(on, k, found, table)
        cost = _cost(table, many, found)
        if best is None or cost < best[0]:
            best = cost, table, found
    assert best is not None
    cost, table, found = best
    angles = readings_deg(many, found.normal).reshape(-1, 3)
    return LearntShell(
        table,
        scale,
        many.pixels,
        math.sqrt(2 * cost),
        _spread_deg(found.normal),
        seen_share(angles),
        box_of(angles),
    )


_Turn = tuple[ShellTable, ModelNormals]


def _turn(
    light: ObservedLight, found: ModelNormals, scale: float, start: ShellTable | None
) -> _Turn:
    """A table at these normals, and the normals by it. What a pixel shows of the ground or of
    another shell makes it darker or not to be explained: then it counts little."""
    if start is None:  # a grey body's gains and costs tell nothing yet
        gain, trust = torch.full_like(found.gain, scale), torch.ones_like(found.gain)
    else:
        gain = found.gain * (scale / float(found.gain.median()))
        usual = float(found.cost.median())
        trust = 1 / (1 + (found.cost / max(_ODD * usual, 1e-12)) ** 2)
    table = fitted(light, found.normal, gain, trust, start=start, rounds=4 if start is None else 2)
    return table, _solved(table, light, scale)


def _solved(table: ShellTable, light: ObservedLight, scale: float) -> ModelNormals:
    known = Known((math.log(scale), _SCALE_WIDTH), 1.0)
    return solve_by_model([table.material], light, known=known)


def _first(table: ShellTable, light: ObservedLight) -> ModelNormals:
    """Normals by a grey body, of the photographs' brightness alone."""
    grey = replace(light, value=light.value.mean(1, keepdim=True), relative=_NOISE[0])
    material = table.material
    flat = shown(material, light.film_surface.expand(3, light.pixels), grey)
    scale = math.log(max(float(grey.value.mean() / flat.mean()), 1e-12))
    return solve_by_model([material], grey, known=Known((scale, _START_WIDTH), 1.0))


def _cost(table: ShellTable, light: ObservedLight, found: ModelNormals) -> float:
    """Of a value, in the median over the pixels."""
    off = (shown(table.material, found.normal, light) * found.gain - light.value) * light.weight
    return float((cauchy_cost(off) / light.counted.clamp(min=1)).median())


def _spread_deg(normal: Tensor) -> float:
    mean = normal.mean(1, keepdim=True)
    return float(torch.rad2deg((normal - mean).square().sum(0).mean().sqrt()))
