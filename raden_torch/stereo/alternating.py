"""Normals without a model: an isotropic BRDF and the normals in turn.

The first BRDF is the one of a few bodies with highlights that explains a sample of the pixels best,
each with the normals that it gives them. Then a BRDF is fitted to what the sample shows at the
normals found so far, and the normals are found anew by it, until they stay. (From Lambertian
normals alone this gets stuck: the BRDF that fits them explains them.) Where that ends worse than it
began, as of a matt body, the first BRDF stays. The object has to be of one isotropic material and
its normals have to spread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.errors import InputError
from raden_torch.stereo.isotropic_table import fitted, lobe
from raden_torch.stereo.observed_light import GRAZING, ObservedLight, sampled, shown
from raden_torch.stereo.solve import Known, ModelNormals, solve_by_model

MIN_LAMPS = 6
_TURNS = 8
_STAYS_DEG = 0.3
_SAMPLE, _FIRST_SAMPLE = 1500, 500
_MATT = (1.0, 0.0)
_LOBES = ((0.06, 4.0), (0.12, 1.0), (0.12, 4.0), (0.25, 1.0), (0.25, 4.0), (0.4, 1.0), (0.4, 4.0))
"""Widths and heights of the first highlights."""
_BETTER = 0.7
"""Of the cost by the Lambertian law: above it the fit has found nothing beyond that law."""
_LEAST_SPREAD_DEG = 10.0


@dataclass(frozen=True, eq=False)
class Alternated:
    """What was found.

    Attributes:
        found: the normals of the pixels given.
        material: its scale is that of the photographs.
        moved_deg: how far the normals of the sample moved in each turn, in the median.
        gained: whether what was fitted explains them at least as well as the first body did;
            otherwise `material` is that body.
        cost: of a pixel in the median; `lambertian`: by the Lambertian law.
    """

    found: ModelNormals
    material: RuntimeBrdf
    moved_deg: tuple[float, ...]
    gained: bool
    cost: float
    lambertian: float

    @property
    def has_settled(self) -> bool:
        return self.moved_deg[-1] <= _STAYS_DEG

    @property
    def is_better(self) -> bool:
        """Whether it explains the photographs clearly better than the Lambertian law."""
        return self.cost < _BETTER * self.lambertian


@torch.no_grad()
def alternate(
    light: ObservedLight, *, progress: Callable[[float], None] | None = None
) -> Alternated:
    """Normals and the material of pixels that show one.

    Args:
        progress: called with the share that is done, 0…1.

    Raises:
        InputError: fewer than `MIN_LAMPS` lamps, or normals that do not spread.
    """
    if len(light.value) < MIN_LAMPS:
        raise InputError(
            f"photographs: expected at least {MIN_LAMPS} to find normals and material together, "
            f"got {len(light.value)}; give a model"
        )
    done = progress or (lambda share: None)
    bodies = [lobe(*each) for each in (_MATT, *_LOBES)]
    few, costs = sampled(light, _FIRST_SAMPLE), []
    for place, body in enumerate(bodies):
        costs.append(float(_with(body, few).cost.median()))
        done(0.2 * (place + 1) / len(bodies))
    some = sampled(light, _SAMPLE)
    start = bodies[costs.index(min(costs))]
    found = first = _with(start, some)
    _check_spread(found.normal)
    moved: list[float] = []
    for turn in range(_TURNS):
        material = fit_at(some, found.normal)
        new = solve_by_model([material], some, known=Known((0.0, 0.1), 1.0))
        moved.append(float(torch.rad2deg((new.normal - found.normal).norm(dim=0).median())))
        found = new
        done(0.2 + 0.3 * (turn + 1) / _TURNS)
        if moved[-1] <= _STAYS_DEG:
            break
    gained = bool(found.cost.median() <= first.cost.median())
    material = material if gained else start
    whole = solve_by_model([material], light, progress=lambda share: done(0.5 + 0.5 * share))
    cost = float(whole.cost.median())
    return Alternated(whole, material, tuple(moved), gained, cost, costs[0])


def fit_at(light: ObservedLight, normal: Tensor) -> RuntimeBrdf:
    """The BRDF that these pixels show if their normals are these `[3, P]`."""
    n, to, view = light.vectors(normal)
    facing = ((n * to).sum(1) * light.strength[:, 0, None]).clamp(min=0)  # [K, 1, P]
    readings = (light.value / facing.clamp(min=1e-6))[:, :, None]
    weight = (light.weight * facing)[:, :, None] * (facing > GRAZING)[:, :, None]
    return fitted(n, to, view, readings, weight)


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
