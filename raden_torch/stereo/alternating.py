"""Normals without a model: an isotropic BRDF and the normals in turn.

The first BRDF is the one of a few bodies with highlights that explains a sample of the pixels best,
each with the normals that it gives them. Then a BRDF is fitted to what the sample shows at the
normals found so far, and the normals are found anew by it, until they stay. (From Lambertian
normals alone this gets stuck: the BRDF that fits them explains them.) Of all
turns the one that explains the sample best is kept, the first body where none is better, as of a
matt one. This is done for a bare surface and for one under lacquer, whose highlights move otherwise
with the normal; the one is kept that predicts photographs better which its normals do not know.
The object has to be of one isotropic material and its normals have to spread.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.errors import InputError
from raden_torch.stereo.isotropic_table import IsotropicTable, fitted, lobe
from raden_torch.stereo.learnt_model import MEAN, box_of, seen_share
from raden_torch.stereo.observed_light import GRAZING, ObservedLight, sampled, shown, thinned
from raden_torch.stereo.shell_table import readings_deg
from raden_torch.stereo.solve import Known, ModelNormals, prior_of, solve_by_model

MIN_LAMPS = 6
_INDICES = (1.0, 1.5)
"""Of nothing, and of lacquer or of a polished shell's own face."""
_TURNS = 8
_STAYS_DEG, _SETTLED_DEG = 0.1, 0.3
"""A turn that moves the normals by less ends it; after one that moves them by more they have not
settled."""
_SAMPLE, _FIRST_SAMPLE = 1500, 500
_MATT = (1.0, 0.0)
_LOBES = ((0.06, 4.0), (0.12, 1.0), (0.12, 4.0), (0.25, 1.0), (0.25, 4.0), (0.4, 1.0), (0.4, 4.0))
"""Widths and heights of the first highlights."""
_LEFT_OUT_PIXELS, _LEFT_OUT_LAMPS = 400, 12
_BETTER = 0.75
"""Of a matt body's error: above it nothing beyond the Lambertian law has been found. Simulated
shells came to 0.2 to 0.6, real objects that are nearly matt or in shadow to 0.9 and more.
"""
_LEAST_GAIN_WIDTH = 0.1
"""Standard deviation of the logarithm of a pixel's brightness over the material's, where the
surface is evenly bright."""
_BLACK = 3.0
"""Times the floor of the photographs, on average: what is darker shows nothing."""
_USUAL_COSINE = 0.6
_LEAST_SPREAD_DEG = 10.0


@dataclass(frozen=True, eq=False)
class Alternated:
    """What was found.

    Attributes:
        found: the normals of the pixels given.
        table: the material.
        moved_deg: how far the normals of the sample moved in each turn, in the median.
        gained: whether what was fitted explains them better than the first body did; otherwise
            `table` is that body.
        left_out: how far off it shows a photograph that a pixel's normal was found without, over
            the pixel's mean, on average, each error counting as 1 at most; `matt_left_out`: the
            same of a matt body.
        box_deg: the least and greatest incidence, receiving and tilt that were seen.
        seen: as `seen_share` says.
    """

    found: ModelNormals
    table: IsotropicTable
    moved_deg: tuple[float, ...]
    gained: bool
    left_out: float
    matt_left_out: float
    box_deg: tuple[tuple[float, float], ...]
    seen: float

    @property
    def has_settled(self) -> bool:
        return self.moved_deg[-1] <= _SETTLED_DEG

    @property
    def is_better(self) -> bool:
        """Whether it predicts photographs clearly better than a matt body does."""
        return self.left_out < _BETTER * self.matt_left_out


@torch.no_grad()
def alternate(
    light: ObservedLight, *, progress: Callable[[float], None] | None = None
) -> Alternated:
    """Normals and the material of pixels that show one.

    Args:
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: fewer than `MIN_LAMPS` lamps, no pixel that is lit, or normals that do not
            spread.
    """
    if len(light.value) < MIN_LAMPS:
        raise InputError(
            f"photographs: expected at least {MIN_LAMPS} to find normals and material together, "
            f"got {len(light.value)}; give a model"
        )
    done = progress or (lambda share: None)
    lit, bright = _lit(light)
    scale = bright / (_USUAL_COSINE * MEAN)
    whole = replace(light, value=light.value / scale, floor=light.floor / scale)
    light = whole.at(lit)
    some, few = sampled(light, _SAMPLE), sampled(light, _FIRST_SAMPLE)
    colour = light.value.mean((0, 2))
    colour = colour / colour.mean()
    tried = []
    for k, index in enumerate(_INDICES):

        def part(share: float, before: int = k) -> None:
            done(0.5 * (before + share) / len(_INDICES))

        bodies = [lobe(*each, index).tinted(colour) for each in (_MATT, *_LOBES)]
        tried.append(_turned(some, few, bodies, part))
    judges = sampled(light, _LEFT_OUT_PIXELS)
    errors = [_left_out(each.table.material, judges) for each in tried]
    # the median, since which medium it is shows where there is no shadow
    chosen = min(range(len(tried)), key=lambda k: float(errors[k].median()))
    best, off = tried[chosen], float(errors[chosen].mean())
    # the mean, since few lamps may show a highlight
    matt_off = float(_left_out(lobe(*_MATT, 1.0).tinted(colour).material, judges).mean())
    materials = [best.table.material]
    found = solve_by_model(materials, whole, progress=lambda share: done(0.5 + 0.5 * share))
    normal = found.normal[:, lit]
    angles = readings_deg(light, normal)[(_facing(light, normal)[:, 0] > 0).numpy()]
    found = replace(found, gain=found.gain * scale)
    return Alternated(
        found,
        best.table,
        best.moved_deg,
        best.gained,
        off,
        matt_off,
        box_of(angles),
        seen_share(angles),
    )


def _lit(light: ObservedLight) -> tuple[Tensor, float]:
    """Pixels that are not black, by their numbers, and the mean of their value over the lamp's
    strength; what is clipped does not count."""
    counted = light.usable.sum(0).clamp(min=1)
    mean = (light.value * light.usable).sum(0) / counted
    lit = (mean.mean(0) > _BLACK * light.floor).nonzero()[:, 0]
    if len(lit) == 0:
        raise InputError(
            "photographs: expected pixels that are lit and not clipped, got none in the mask"
        )
    over = light.usable / light.strength
    return lit, float(((light.value * over).sum(0) / counted)[:, lit].mean())


@dataclass(frozen=True, eq=False)
class _Turned:
    """The best material in one medium, as it explains a sample; the rest is as of `Alternated`."""

    table: IsotropicTable
    moved_deg: tuple[float, ...]
    gained: bool


def _turned(
    some: ObservedLight,
    few: ObservedLight,
    bodies: Sequence[IsotropicTable],
    done: Callable[[float], None],
) -> _Turned:
    costs = []
    for place, body in enumerate(bodies):
        costs.append(float(_with(body.material, few).cost.median()))
        done(0.4 * (place + 1) / len(bodies))
    table = start = bodies[costs.index(min(costs))]
    found = _with(start.material, some)
    _check_spread(found.normal)
    least, moved = float(found.cost.median()), []
    gain, width = torch.ones_like(found.gain), _LEAST_GAIN_WIDTH
    for turn in range(_TURNS):
        fitted_to = fit_at(some, found.normal, gain, start.index)
        new = solve_by_model([fitted_to.material], some, known=Known((0.0, width), 1.0))
        middle, width = prior_of(new.gain, _LEAST_GAIN_WIDTH)
        gain = new.gain / math.exp(middle)
        moved.append(float(torch.rad2deg((new.normal - found.normal).norm(dim=0).median())))
        found, cost = new, float(new.cost.median())
        if cost < least:
            table, least = fitted_to, cost
        done(0.4 + 0.6 * (turn + 1) / _TURNS)
        if moved[-1] <= _STAYS_DEG:
            break
    return _Turned(table, tuple(moved), table is not start)


def _left_out(material: RuntimeBrdf, light: ObservedLight) -> Tensor:
    """Errors as of `Alternated.left_out`: what explains more need not predict more."""
    every = list(range(len(light.value)))
    usual, off = light.value.mean((0, 1)).clamp(min=1e-12), []
    for out in thinned(torch.tensor(every), _LEFT_OUT_LAMPS).tolist():
        kept, left = light.under([k for k in every if k != out]), light.under([out])
        found = solve_by_model([material], kept)
        predicted = shown(material, found.normal, left) * found.gain
        error = (predicted - left.value)[0].abs().mean(0) / usual
        off.append(torch.where(left.usable[0, 0] > 0, error.clamp(max=1), torch.nan))
    every_error = torch.stack(off)
    return every_error[~every_error.isnan()]


def _facing(light: ObservedLight, normal: Tensor) -> Tensor:
    """`[K, 1, P]` irradiance where a table is fitted to what is seen there, else 0."""
    n, to, view = light.vectors(normal)
    facing = (n * to).sum(1) * light.strength[:, 0, None]
    counts = (facing > GRAZING) & ((n * view).sum(1) > 0) & (light.usable > 0)
    return facing * counts


def fit_at(light: ObservedLight, normal: Tensor, gain: Tensor, index: float) -> IsotropicTable:
    """The BRDF in a medium that these pixels show if their normals are these `[3, P]`, and they are
    `gain` `[P]` times as bright."""
    facing = _facing(light, normal) * gain
    readings = (light.value / facing.clamp(min=1e-6))[:, :, None]
    weight = (light.weight * facing)[:, :, None]
    return fitted(*light.vectors(normal), readings, weight, index)


def _with(material: RuntimeBrdf, light: ObservedLight) -> ModelNormals:
    """Normals by a material of which the scale is not known."""
    facing = shown(material, light.middle.view, light.middle)
    scale = math.log(max(float(light.value.mean() / facing.mean()), 1e-12))
    return solve_by_model([material], light, known=Known((scale, 1.5), 1.0))


def _check_spread(normal: Tensor) -> None:
    mean = normal.mean(1, keepdim=True)
    apart = torch.rad2deg(torch.linalg.cross(normal, mean.expand_as(normal), dim=0).norm(dim=0))
    spread = float((apart / mean.norm()).quantile(0.9))
    if spread < _LEAST_SPREAD_DEG:
        raise InputError(
            f"photographs: expected normals that spread by {_LEAST_SPREAD_DEG:g} degrees to find "
            f"the material with them, got {spread:.1f}; give a model"
        )
