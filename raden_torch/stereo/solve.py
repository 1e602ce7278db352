"""Normals of a material that is known: photographs under known lamps and a model → normals.

Each pixel takes the normal, and a scale, whose radiance I s f_r(N, L, V) N·L over all lamps and
channels is nearest to what was photographed: a table of normals is searched (`normal_search.py`),
and the best few are refined (`normal_refine.py`). What is dark under a lamp counts: it says that
the highlight is not there. What is clipped does not, and what disagrees weighs little.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.capture.photo.photometric_stereo import confidence_of
from raden_torch.capture.photo.tile_threads import in_threads
from raden_torch.stereo.normal_refine import Refined, refine
from raden_torch.stereo.normal_search import search
from raden_torch.stereo.observed_light import ObservedLight, sampled, shown

TILE = 1 << 10
_STARTS = 4
_FIRST_ROUNDS, _LAST_ROUNDS = 4, 10
SAMPLE = 1 << 12
"""Pixels that tell of all."""
_TRUST = 10.0
"""So many values of each pixel's noise are believed to be what the object's median is."""
_TOGETHER = 6.0
"""So many values err as one: a model's error is shared by channels and by lamps that stand near
each other. Chosen on simulated shells, whose errors are then as `error_deg` says (docs/normals.md).
"""
_LEAST_SPREAD = 0.05
"""However well the photographs fit: the standard deviations that are assumed are not 5 times too
large."""
_APART_DEG = 1.0
"""Minima closer than this are one."""
_LEAST_PRIOR = 0.05
_WIDEST_PRIOR = 1.0


@dataclass(frozen=True, eq=False)
class Known:
    """What a sample of the pixels tells of all.

    Attributes:
        prior: mean and standard deviation of log g.
        spread: the median `Refined.spread`.
    """

    prior: tuple[float, float]
    spread: float


@dataclass(frozen=True, eq=False)
class ModelNormals:
    """Of P pixels.

    Attributes:
        normal: `[3, P]`; gain: `[P]`, the scale on the model's radiance.
        error_deg: `[P]`, the standard error: of the nearest fit, and of other minima as far as they
            are as likely.
        cost: `[P]`; member: `[P]`, which of the materials.
    """

    normal: Tensor
    gain: Tensor
    error_deg: Tensor
    cost: Tensor
    member: Tensor

    def split(self, sizes: list[int]) -> list[ModelNormals]:
        """So many pixels each, one after the other."""
        fields = (getattr(self, name).split(sizes, -1) for name in self.__dataclass_fields__)
        return [ModelNormals(*parts) for parts in zip(*fields, strict=True)]

    @property
    def confidence(self) -> Tensor:
        """`[P]`, as that of `SurfaceNormals`."""
        return confidence_of(self.error_deg)


@torch.no_grad()
def learnt(materials: Sequence[Reflection], light: ObservedLight) -> Known:
    """How bright and how noisy the object is, by a sample of its pixels."""
    unknown = Known((0.0, math.inf), 1.0)
    some = sampled(light, SAMPLE)
    tiles = torch.arange(some.pixels).split(TILE)

    def solve(index: Tensor) -> Refined:
        with torch.no_grad():
            return _solved(materials, some.at(index), unknown)[0]

    found = list(in_threads(solve, tiles, light.value.device))
    spread = float(torch.cat([f.spread for f in found]).median())
    prior = prior_of(torch.cat([f.gain for f in found]), _LEAST_PRIOR)
    return Known(prior, max(spread, _LEAST_SPREAD))


def prior_of(gain: Tensor, least: float) -> tuple[float, float]:
    """What gains `[P]` tell of those of other pixels: the median of their logarithm, and the
    standard deviation to expect around it, at least `least`."""
    log_gain = gain.log()
    middle = log_gain.median()
    width = 1.5 * 1.4826 * float((log_gain - middle).abs().median())
    return float(middle), min(max(width, least), _WIDEST_PRIOR)


@torch.no_grad()
def solve_by_model(
    materials: Sequence[Reflection],
    light: ObservedLight,
    *,
    known: Known | None = None,
    progress: Callable[[float], None] | None = None,
) -> ModelNormals:
    """The normals of pixels that show one of these materials.

    Args:
        known: what is known of all pixels; `learnt` where None.
        progress: called with the share that is done, 0…1.
    """
    told = known or learnt(materials, light)
    tiles = torch.arange(light.pixels, device=light.value.device).split(TILE)

    def solve(index: Tensor) -> ModelNormals:
        with torch.no_grad():  # which is a thread's own
            return _judged(materials, light.at(index), told)

    found = []
    for k, part in enumerate(in_threads(solve, tiles, light.value.device)):
        found.append(part)
        if progress is not None:
            progress((k + 1) / len(tiles))
    return joined(found)


def joined(parts: Sequence[ModelNormals]) -> ModelNormals:
    """Pixels one after the other."""
    return ModelNormals(
        **{
            name: torch.cat([getattr(part, name) for part in parts], dim=-1)
            for name in ModelNormals.__dataclass_fields__
        }
    )


@torch.no_grad()
def residuals(
    materials: Sequence[Reflection], light: ObservedLight, found: ModelNormals
) -> tuple[Tensor, Tensor]:
    """`[K, C, P]` what the materials show there, and `[K, P]` how far the photographs are from it,
    relative to the pixel's mean over the lamps; NaN where a value is clipped."""
    radiance = torch.zeros_like(light.value)
    for place, material in enumerate(materials):
        of = (found.member == place).nonzero()[:, 0]
        radiance[..., of] = shown(material, found.normal[:, of], light.at(of))
    radiance = radiance * found.gain
    usual = radiance.mean((0, 1)).clamp(min=1e-12)
    off = (radiance - light.value).abs().mean(1) / usual
    return radiance, torch.where(light.usable[:, 0] > 0, off, torch.nan)


def _solved(
    materials: Sequence[Reflection], light: ObservedLight, known: Known
) -> tuple[Refined, Tensor, Tensor]:
    """The best of all starts and materials; its material `[P]`; and `[P]` the variance, in radians
    squared, that the other minima bring."""
    prior = None if math.isinf(known.prior[1]) else known.prior
    tried: list[Refined] = []
    for material in materials:
        starts = search(material, light, _STARTS, prior)
        for k in range(_STARTS):
            start = starts.normal[k], starts.gain[k]
            tried.append(refine(material, light, *start, rounds=_FIRST_ROUNDS, prior=prior))
    costs = torch.stack([t.cost for t in tried])
    best = costs.argmin(0)
    member = best // _STARTS
    normal = _chosen([t.normal for t in tried], best)
    gain = _chosen([t.gain for t in tried], best)
    parts = []
    for place, material in enumerate(materials):
        of = (member == place).nonzero()[:, 0]
        start = normal[:, of], gain[of]
        part = refine(material, light.at(of), *start, rounds=_LAST_ROUNDS, prior=prior)
        parts.append((of, part))
    final = _scattered(parts, light.pixels)
    likely = torch.exp(-(costs - final.cost).clamp(min=0) / max(_TOGETHER * known.spread, 1e-12))
    apart = torch.stack([(t.normal - final.normal).norm(dim=0) for t in tried])
    other = likely * (apart > math.radians(_APART_DEG))
    return final, member, (other * apart**2).sum(0) / (1 + other.sum(0))


def _judged(materials: Sequence[Reflection], light: ObservedLight, known: Known) -> ModelNormals:
    final, member, elsewhere = _solved(materials, light, known)
    free = (light.counted - 3).clamp(min=1)
    spread = (final.spread * free + known.spread * _TRUST) / (free + _TRUST)
    variance = _TOGETHER * _across(final.hessian) * spread + elsewhere
    error = torch.rad2deg(variance.sqrt()).clamp(max=90.0)
    return ModelNormals(final.normal, final.gain, error, final.cost, member)


def _across(hessian: Tensor) -> Tensor:
    """The trace `[P]` of the inverse `[3, 3, P]` over the two turns, the scale being free."""
    h = hessian.double()
    scale = h[2, 2].clamp(min=1e-12)
    xx, yy, xy = (h[i, j] - h[i, 2] * h[j, 2] / scale for i, j in ((0, 0), (1, 1), (0, 1)))
    xx, yy = xx.clamp(min=1e-9), yy.clamp(min=1e-9)
    least = 1e-6 * xx * yy  # by rounding it may be anything where one turn changes nothing
    return ((xx + yy) / (xx * yy - xy * xy).clamp(min=1e-30).maximum(least)).to(hessian)


def _chosen(each: Sequence[Tensor], place: Tensor) -> Tensor:
    """Of S tensors `[…, P]`, the one of each pixel."""
    stack = torch.stack(list(each))
    index = place.view(1, *[1] * (stack.ndim - 2), -1).expand(1, *stack.shape[1:])
    return stack.gather(0, index)[0]


def _scattered(parts: Sequence[tuple[Tensor, Refined]], pixels: int) -> Refined:
    """Pixels by their numbers, put together."""
    whole = {}
    for name in Refined.__dataclass_fields__:
        like = getattr(parts[0][1], name)
        whole[name] = like.new_zeros(*like.shape[:-1], pixels)
        for of, part in parts:
            whole[name][..., of] = getattr(part, name)
    return Refined(**whole)
