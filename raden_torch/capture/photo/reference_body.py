"""A matt reference sphere that is not quite matt: its response, its highlight, lamps that moved.

Under lamp k a pixel shines with s_k ρ (N·L_k + h exp(−t²/(2 w²))), t the angle from its normal N
to the half vector, and is photographed as that to the power 1/p. The sphere's normals are known and
each pixel has its own ρ, so that p, h and w follow from how the lamps compare. p is the camera's
and holds for other objects; h and w are the sphere's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats

_EXPONENTS, _HEIGHTS, _WIDTHS_DEG = (0.4, 2.6), (0.0, 2.0), (8.0, 40.0)
_START = (1.1, 0.1, 14.0)
_LOG_BRIGHT = (-3.0, 3.0)
_LIT, _DARK = 0.12, 0.03
"""Cosine of the incidence, and share of the brightest value, below which nothing is compared."""
_SCALE = 0.02
"""Of the residuals, relative to the median ρ: what is off by more counts by its absolute value."""
_LARGEST = 5 * _SCALE
"""A residual counts as no more in a lamp's own."""
_LEAST_NOISE = 0.7
_MOVED, _MOVED_LEAST = 2.5, 0.02
_LEAST_LAMPS = 6
"""With fewer, nothing tells which of them moved."""
_ROUNDS, _STEP = 20, 0.15
_FLOOR, _DOUBT = 0.01, 1.0
"""A floor of the solver's residuals, relative to ρ, and how much of the highlight is doubted."""


@dataclass(frozen=True, eq=False)
class ReferenceBody:
    """What K photographs of a reference sphere say of the camera, the lamps and its material.

    Attributes:
        exponent: p, which makes the photographs linear.
        height, width_deg: h and w of the highlight.
        residual: `[K]` root mean square of what is left, relative to the median ρ.
        moved: `[K]` bool, lamps that fit the sphere nowhere near as well as the others do.
        intensity: `[K]` of the lamps, relative; alike unless they were fitted.
    """

    exponent: float
    height: float
    width_deg: float
    residual: Floats
    moved: NDArray[np.bool_]
    intensity: Floats

    @property
    def noise(self) -> Floats:
        """`[K]` residuals over their median, those of the best lamps held to 0.7."""
        usual = max(float(np.median(self.residual[~self.moved])), 1e-12)
        return np.maximum(self.residual / usual, _LEAST_NOISE)

    def highlight(self, normal: Floats, lights: Floats, view: Floats) -> Floats:
        """`[K, P]` of normals and views `[3, P]` under lights `[K, 3, P or 1]`, beside N·L."""
        return _highlight(normal, lights, view, self.height, self.width_deg)

    def shown(self, normal: Floats, lights: Floats, view: Floats) -> Floats:
        """`[K, P]` linear light for ρ = 1."""
        cosine = (lights * normal).sum(1).clip(0)
        return np.asarray(cosine + self.highlight(normal, lights, view))


def fit_body(
    value: Floats,
    lights: Floats,
    normal: Floats,
    view: Floats,
    usable: NDArray[np.bool_],
    *,
    alike: bool = True,
) -> ReferenceBody:
    """Exponent and highlight that explain the photographs best, lamps that moved left out.

    Args:
        value: `[K, P]` as photographed.
        alike: the lamps are equally bright; else their intensities are fitted, too.
        lights: `[K, 3, P or 1]` unit vectors to the lamps.
        normal, view: `[3, P]` unit, known.
        usable: `[K, P]` values that are not clipped.
    """
    count = len(value)
    value = value / value.max()
    kept = np.ones(count, bool)
    while True:
        body = _fitted(value, lights, normal, view, usable, kept, alike=alike)
        ratio = np.where(kept, body.residual / np.median(body.residual[kept]), 0.0)
        worst = int(ratio.argmax())
        if (
            count < _LEAST_LAMPS
            or (~kept).sum() >= count // 4
            or ratio[worst] < _MOVED
            or body.residual[worst] < _MOVED_LEAST
        ):
            return body
        kept[worst] = False


def _fitted(
    value: Floats,
    lights: Floats,
    normal: Floats,
    view: Floats,
    usable: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    *,
    alike: bool,
) -> ReferenceBody:
    """By robust least squares over the lamps kept, twice: the second time each lamp weighs by what
    it left the first time."""
    from scipy.optimize import least_squares

    cosine = (lights * normal).sum(1)
    good = usable & (cosine > _LIT) & (value > _DARK)
    base = value.clip(1e-6)
    noise = np.ones(len(value))

    def intensities(x: Floats) -> Floats:
        """`[K]` of mean 1."""
        bright = np.exp(x[3:]) if len(x) > 3 else np.ones(len(value))
        return np.asarray(bright / bright.mean())

    def left(x: Floats, lamps: NDArray[np.bool_]) -> Floats:
        """`[K, P]` what is left, relative to the median ρ, with each ρ from these lamps."""
        exponent, height, width = x[:3]
        shown = cosine.clip(0) + _highlight(normal, lights, view, height, width)
        linear = base**exponent / intensities(x)[:, None]
        weight = good / noise[:, None] ** 2 * lamps[:, None]
        rho = (weight * shown * linear).sum(0) / (weight * shown**2).sum(0).clip(1e-9)
        middle = max(float(np.median(rho[rho > 0])), 1e-12) if (rho > 0).any() else 1.0
        return np.asarray((linear - rho * shown) * good / middle)

    def residuals(x: Floats) -> Floats:
        return np.asarray((left(x, kept) / (_SCALE * noise[:, None]))[kept].ravel())

    bright = 0 if alike else len(value)
    low, high = zip(_EXPONENTS, _HEIGHTS, _WIDTHS_DEG, *[_LOG_BRIGHT] * bright, strict=True)
    scale = np.array([0.1, 0.1, 5.0, *[0.1] * bright])
    x = np.array([*_START, *[0.0] * bright])
    for turn in range(2):
        found = least_squares(residuals, x, bounds=(low, high), loss="soft_l1", x_scale=scale)
        x = found.x
        square = np.minimum(left(x, kept) ** 2, _LARGEST**2).sum(1)
        residual = np.sqrt(square / good.sum(1).clip(1))
        if turn == 0:
            noise = np.maximum(residual / max(np.median(residual[kept]), 1e-12), _LEAST_NOISE)
    exponent, height, width = (float(v) for v in x[:3])
    return ReferenceBody(exponent, height, width, residual, ~kept, intensities(x))


def _highlight(
    normal: Floats, lights: Floats, view: Floats, height: float, width_deg: float
) -> Floats:
    half = lights + view
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    square = 2 * (1 - (half * normal).sum(1))  # the chord's, of small angles the angle's
    lobe = height * np.exp(-square / (2 * np.radians(width_deg) ** 2))
    return np.asarray(lobe * ((lights * normal).sum(1) > 0))


def normals_by_body(
    body: ReferenceBody, linear: Floats, lights: Floats, view: Floats, start: Floats, usable: Floats
) -> Floats:
    """`[3, P]` normals of the body's own material with the least absolute residuals.

    Lamps that moved are left out, others weigh by one over their noise, and what may be highlight
    is believed the less the brighter that is.

    Args:
        linear: `[K, P]` linear light over the lamps' intensities.
        lights: `[K, 3, P or 1]`.
        view, start: `[3, P]` unit, `start` the normals by the matt law.
        usable: `[K, P]`, 1 where a value counts: not clipped, not in shadow.
    """
    normal = start.astype(np.float64)
    trust = usable * ~body.moved[:, None] / body.noise[:, None]
    small = 1e-3
    for _ in range(_ROUNDS):
        aside = np.where(abs(normal[1]) < 0.9, [[0.0], [1.0], [0.0]], [[1.0], [0.0], [0.0]])
        first = _unit(np.cross(normal.T, aside.T).T)
        second = np.cross(normal.T, first.T).T
        shown = body.shown(normal, lights, view)
        rho = (trust * shown * linear).sum(0) / (trust * shown**2).sum(0).clip(1e-12)
        slopes = [
            (
                body.shown(_unit(normal + small * along), lights, view)
                - body.shown(_unit(normal - small * along), lights, view)
            )
            / (2 * small)
            for along in (first, second)
        ]
        terms = np.stack([shown, *(rho * slope for slope in slopes)], -1)
        left = linear - rho * shown
        doubt = _FLOOR + _DOUBT * body.highlight(normal, lights, view)
        weight = trust / np.maximum(abs(left) / body.noise[:, None], doubt * rho).clip(1e-12)
        square = np.einsum("kpi,kp,kpj->pij", terms, weight, terms)
        square += 1e-9 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30
        right = np.einsum("kpi,kp->pi", terms, weight * left)
        step = np.linalg.solve(square + 1e-12 * np.eye(3), right[..., None])[:, 1:, 0].T
        step *= np.minimum(1, _STEP / np.linalg.norm(step, axis=0).clip(1e-12))
        normal = _unit(normal + step[0] * first + step[1] * second)
    return normal


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=0).clip(1e-12))
