"""The material of a format that is nearest to a model, by least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import torch
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from raden_torch.arrays import Bools, Floats
from raden_torch.export.forms import RuntimeForm

_PAIRS = 800
_HELD_OUT = 4000
_FIRST_STEPS, _FOLLOWED, _STEPS = 15, 3, 100
_STRAIGHT = 0.02


class Material(Protocol):
    """What a format can say."""

    def f_r(self, n_l: Floats, n_v: Floats, n_h: Floats, v_h: Floats) -> Floats:
        """f_r in 1/sr, `[N, 3]`, by cosines `[N]` between normal, light, viewer, half vector."""


M = TypeVar("M", bound=Material)


@dataclass(frozen=True)
class Parameters(Generic[M]):
    """What is varied, `[P]` each.

    Attributes:
        low, high: bounds.
        step: how much of each is a change of about the same weight.
        material: of the values.
        rooted: whether square roots are compared, which are nearer to what is seen.
    """

    low: Floats
    high: Floats
    step: Floats
    material: Callable[[Floats], M]
    rooted: bool = False


@dataclass(frozen=True)
class Nearest(Generic[M]):
    """A material, and how far it is from the model.

    Attributes:
        error: RMS of the difference of f_r cos θi over the RMS of the model's, for pairs of
            directions spread evenly by projected solid angle.
        highlight_error: the same where the half vector is within some 20° of the normal.
    """

    material: M
    error: float
    highlight_error: float


def nearest(form: RuntimeForm, of: Parameters[M], starts: list[Floats]) -> Nearest[M]:
    """The material whose f_r cos θi, or the root of it, is nearest in the least-squares sense, the
    best that is found from any of the starts; its error is of other pairs than it was fitted to."""
    cosines, wanted = geometries(form, _PAIRS, seed=1)
    weight = cosines[:, :1]
    scale = np.sqrt(np.mean((wanted * weight) ** 2)) or 1.0

    shown = _root if of.rooted else _as_it_is
    target = shown(wanted * weight / scale)

    def residual(x: Floats) -> Floats:
        return (shown(of.material(x).f_r(*cosines.T) * weight / scale) - target).ravel()

    def followed(starts: list[Floats], steps: int) -> list[Any]:
        found = [
            least_squares(residual, x, bounds=(of.low, of.high), x_scale=of.step, max_nfev=steps)
            for x in starts
        ]
        return sorted(found, key=lambda one: float(one.cost))

    with threadpool_limits(1):  # the matrices are small
        promising = followed(starts, _FIRST_STEPS)[:_FOLLOWED]
        best, *_ = followed([one.x for one in promising], _STEPS)
    material = of.material(best.x)
    cosines, wanted = geometries(form, _HELD_OUT, seed=2)
    off = (material.f_r(*cosines.T) - wanted) * cosines[:, :1]
    wanted = wanted * cosines[:, :1]
    even, near = np.arange(len(off)) < _HELD_OUT // 2, cosines[:, 2] > np.cos(np.deg2rad(20))
    return Nearest(material, _share(off, wanted, even), _share(off, wanted, near))


def _root(value: Floats) -> Floats:
    # straight near 0, where a model may be negative
    return np.sign(value) * (np.sqrt(np.abs(value) + _STRAIGHT) - np.sqrt(_STRAIGHT))


def _as_it_is(value: Floats) -> Floats:
    return value


def matt_colour(form: RuntimeForm) -> Floats:
    """`[3]`: π times the median of f_r, a start for a base's colour."""
    return np.clip(np.pi * np.median(geometries(form, _PAIRS, seed=1)[1], axis=0), 0.02, 0.98)


def _share(off: Floats, wanted: Floats, where: Bools) -> float:
    whole = np.sqrt(np.mean(wanted[where] ** 2))
    return float(np.sqrt(np.mean(off[where] ** 2)) / whole) if whole else 0.0


def geometries(form: RuntimeForm, count: int, seed: int) -> tuple[Floats, Floats]:
    """`[N, 4]` cosines N·L, N·V, N·H, V·H and the model's f_r `[N, 3]`: half of them pairs of
    directions that are even by projected solid angle, half with the half vector near the normal."""
    random = np.random.default_rng(seed)
    light, view = _projected(random, count // 2), _projected(random, count // 2)
    v = _projected(random, count)
    h = _around(random, count, np.deg2rad(25))
    l = 2 * (v * h).sum(1, keepdims=True) * h - v  # noqa: E741
    seen = np.flatnonzero((l[:, 2] > 0.02) & (v[:, 2] > 0.02))[: count // 2]
    light, view = np.concatenate([light, l[seen]]), np.concatenate([view, v[seen]])
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosines = np.stack([light[:, 2], view[:, 2], half[:, 2], (view * half).sum(1)], axis=1)
    maps = [torch.from_numpy(x.T.copy())[None, :, None] for x in (light, view)]
    normal = maps[0].new_tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(maps[0])
    with torch.no_grad():
        f = form.of_unit_vectors(normal, *maps)[0, :, 0].T
    return np.clip(cosines, 1e-4, 1), f.numpy()


def _projected(random: np.random.Generator, count: int) -> Floats:
    square, azimuth = random.random(count), 2 * np.pi * random.random(count)
    radius = np.sqrt(square)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)], 1)


def _around(random: np.random.Generator, count: int, most: float) -> Floats:
    angle, azimuth = most * random.random(count), 2 * np.pi * random.random(count)
    sine = np.sin(angle)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(angle)], 1)
