"""Where does a photograph itself say that its lamp stands?

Light that is exchanged with the view leaves a reflectance as it is, and so does, on a surface that
is alike on all sides, the mirror image in the plane of incidence. So within one photograph the
reflectance at (s, u, t), s = (a + r)/2 and u = (a − r)/2, is that at (s, −u, −t), (s, u, −t) and
(s, −u, t): the highlight lies at the half vector, and what is divided by cos θi is alike on its
two sides. A lamp that stands elsewhere than is said breaks this. Gauss–Newton on its two angles
finds where it mends; no other photograph is asked, so that a lamp whose cells no other fills is
told, too. A sphere has all these geometries beside each other; of a plane and a cylinder too few
are, and what they say of a lamp is not reliable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Floats, Ints
from raden_torch.capture.photo.brdf.lighting import LEAN_DEG, Lamp
from raden_torch.capture.photo.brdf.photo_series import PhotoSeries
from raden_torch.capture.photo.brdf.reservoir import Reservoir
from raden_torch.capture.photo.brdf.sample_moves import SamplesByShot, ShotSamples
from raden_torch.capture.photo.brdf.sample_shapes import Sphere

LEAST_DEG = 0.5
"""An offset below this is not told of."""
SIGMAS = 4.0
"""Nor one below so many of its standard deviations."""

_BIN_DEG = 2.5
_FEWEST = 5
_FEWEST_PAIRS = 40
_ROUNDS = 10
_STILL_DEG = 0.02
_MOST = 16_000
"""Samples of a photograph that are asked."""
_FAR_DEG = 5.0
"""A step of Gauss–Newton is at most so long."""
_SURE_DEG = 1.0
"""Where the place is known worse than this, nothing is said."""
_HUBER = 1.345
"""Scales from which a difference counts less: convex, so that a wrong start is no trap."""
_SIDES = ((-1, -1), (1, -1), (-1, 1))
"""Signs of u and t of the places where the reflectance is the same."""


@dataclass(frozen=True, eq=False)
class LampPlace:
    """How far each of K shots' lamps stands from where the lights file says; NaN: not known.

    Attributes:
        lean_deg: `[K, 2]` along the lamp's two directions.
        covariance: `[K, 2, 2]` of it, as the photograph tells, degrees².
        towards: `[K, 3]` unit, which way it stands off.
    """

    lean_deg: Floats
    covariance: Floats
    towards: Floats

    @property
    def offset_deg(self) -> Floats:
        """`[K]` how far off, in all."""
        return np.asarray(np.linalg.norm(self.lean_deg, axis=1))

    def warnings(
        self, names: Sequence[str], lamps: Sequence[Lamp], outline_deg: float
    ) -> list[str]:
        """A line for each lamp that stands elsewhere, beyond its stated uncertainty.

        Args:
            lamps: with their numbers and stated standard deviations.
            outline_deg: what the outline's standard deviation is as an angle of the normals: a
                mirror turns by twice as much.
        """
        found = []
        for k, lamp in enumerate(lamps):
            lean, own = self.lean_deg[k], self.covariance[k]
            if not np.isfinite(lean).all():
                continue
            whole = own + (lamp.std_deg**2 + (2 * outline_deg) ** 2) * np.eye(2)
            size = float(np.linalg.norm(lean))
            if size < LEAST_DEG or lean @ np.linalg.solve(whole, lean) < SIGMAS**2:
                continue
            way = lean / size
            std = float(np.sqrt(way @ (own + (2 * outline_deg) ** 2 * np.eye(2)) @ way))
            found.append(
                f"{names[k]}: lamp {lamp.number + 1} seems to stand {size:.1f}° ± {std:.1f}° from "
                f"where the lights file says, towards {_said(self.towards[k])}, as the two sides "
                "of the highlight differ; find the lamp again (or the sample looks different when "
                "turned)"
            )
        return found


def lamp_places(by_shot: SamplesByShot, kept: Reservoir, series: PhotoSeries) -> LampPlace:
    """Of each shot of a sphere, from its chosen samples; of other shapes nothing is known."""
    count = len(series.lamps)
    lean, covariance = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
    towards = np.full((count, 3), np.nan)
    for k in range(count):
        part = by_shot.of(k, at_most=_MOST)
        if not isinstance(part.shape, Sphere):
            continue
        found = _placed(part, kept.y[part.rows].mean(axis=1).astype(np.float64))
        if found is None:
            continue
        lamp, covariance[k] = found
        before, after = _way(part.lamp, part), _way(lamp, part)
        off = after - before * float(after @ before)
        lean[k] = np.degrees(np.arctan2(np.linalg.norm(off), after @ before)) * (
            part.lamp.across @ off / max(float(np.linalg.norm(off)), 1e-12)
        )
        towards[k] = off / max(float(np.linalg.norm(off)), 1e-12)
    return LampPlace(lean, covariance, towards)


def _placed(part: ShotSamples, value: Floats) -> tuple[Lamp, Floats] | None:
    """The lamp where the photograph is the most symmetrical, and its covariance; None where it
    does not tell."""
    lamp, step = part.lamp, np.full(2, np.inf)
    signal = value * part.light
    for _ in range(_ROUNDS):
        pairs = _differences(part, lamp, signal)
        if pairs is None:
            return None
        step, covariance = _solved(*pairs)
        length = float(np.linalg.norm(step))
        lamp = lamp.turned(step * min(1.0, _FAR_DEG / max(length, 1e-9)), part.shape.middle)
        if length < max(_STILL_DEG, 0.1 * float(np.sqrt(np.trace(covariance)))):
            break
    if not np.trace(covariance) < 2 * _SURE_DEG**2 or length > 1:
        return None
    return lamp, covariance


def _differences(
    part: ShotSamples, lamp: Lamp, signal: Floats
) -> tuple[Floats, Floats, Floats] | None:
    """Of pairs of places that should be alike: the difference `[P]`, what a degree of the lamp
    does to it `[P, 2]`, and its standard deviation `[P]`; None where there are too few."""
    angles, light = part.seen_under(lamp)
    good = light > 0.1
    a, r, t = angles[good].astype(np.float64).T
    place = np.stack([(a - r) / 2, t, (a + r) / 2], axis=1)
    value = signal[good] / light[good]
    leans = []
    for along in LEAN_DEG * np.eye(2):
        there, back = (part.seen_under(lamp.turned(s * along, part.shape.middle)) for s in (1, -1))
        da, dr, dt = (there[0][good] - back[0][good]).astype(np.float64).T / (2 * LEAN_DEG)
        move = np.stack([(da - dr) / 2, dt], axis=1)
        leans.append((move, (there[1] - back[1])[good] / light[good] / (2 * LEAN_DEG)))
    known = (abs(leans[0][0]) < 5).all(1) & (abs(leans[1][0]) < 5).all(1)
    cells = _Patches(place[known], value[known])
    if cells.first is None:
        return None
    out: list[tuple[Floats, Floats, Floats]] = []
    effect = np.stack(
        [
            cells.mean(
                cells.slope[cells.group, 0] * move[known, 0]
                + cells.slope[cells.group, 1] * move[known, 1]
                + cells.fitted * more[known]
            )
            for move, more in leans
        ],
        axis=1,
    )
    for signs in _SIDES:
        mine, other = cells.partners(signs)
        out.append(
            (
                cells.first[mine] - cells.first[other],
                effect[mine] - effect[other],
                np.hypot(cells.std[mine], cells.std[other]),
            )
        )
    difference, slope, std = (np.concatenate(p) for p in zip(*out, strict=True))
    if len(difference) < _FEWEST_PAIRS:
        return None
    return difference, slope, std


class _Patches:
    """A photograph's samples in patches of (s, u, t), in each a plane through them.

    Attributes:
        group: `[n]` patch of each sample; those of too few samples have none and are left out.
        first: `[G]` value at the middle of each patch; None where there are no patches.
        slope: `[G, 2]` along u and t, a degree.
        std: `[G]` of `first`.
        fitted: `[n]` the plane's values at the samples.
    """

    def __init__(self, place: Floats, value: Floats) -> None:
        size = np.array([_BIN_DEG, _BIN_DEG, 2 * _BIN_DEG])
        # u and t are told apart symmetrically about 0
        index = np.where(
            np.arange(3) < 2, np.floor(abs(place) / size) + 1, np.floor(place / size) + 1
        ).astype(np.intp)
        index[:, :2] *= np.where(place[:, :2] < 0, -1, 1)
        keys, group, count = np.unique(index, axis=0, return_inverse=True, return_counts=True)
        middle = np.sign(keys) * (abs(keys) - 0.5) * size
        self._keys, self.group, self._count = keys, group.ravel(), count
        x = place[:, :2] - middle[self.group, :2]
        terms = np.c_[np.ones(len(x)), x]
        square = np.stack(
            [[self._sum(terms[:, i] * terms[:, j]) for j in range(3)] for i in range(3)]
        ).transpose(2, 0, 1)
        right = np.stack([self._sum(terms[:, i] * value) for i in range(3)], axis=1)
        self.good = (count >= _FEWEST) & (
            np.linalg.det(square) > 1e-3 * count**3 * (_BIN_DEG**2 / 12) ** 2
        )
        self.first = None
        if not self.good.any():
            return
        safe = np.where(self.good[:, None, None], square, np.eye(3))
        inverse = np.linalg.inv(safe)
        solved = np.einsum("gij,gj->gi", inverse, right)
        self.fitted = (terms * solved[self.group]).sum(1)
        left = self._sum((value - self.fitted) ** 2) / np.maximum(count - 3, 1)
        self.first, self.slope = solved[:, 0], solved[:, 1:]
        spread = np.maximum(left, np.median(left[self.good]))
        self.std = np.sqrt(spread * inverse[:, 0, 0])

    def _sum(self, column: Floats) -> Floats:
        return np.asarray(np.bincount(self.group, column, len(self._keys)), np.float64)

    def mean(self, column: Floats) -> Floats:
        """`[G]` over the samples of each patch."""
        return np.asarray(self._sum(column) / self._count)

    def partners(self, signs: tuple[int, int]) -> tuple[Ints, Ints]:
        """Rows of patches, and of those with u and t of these signs; each pair once."""
        key = {tuple(k): g for g, k in enumerate(self._keys.tolist()) if self.good[g]}
        pairs = [
            (g, key[other])
            for k, g in key.items()
            if (other := (signs[0] * k[0], signs[1] * k[1], k[2])) in key and g < key[other]
        ]
        found = np.array(pairs, np.intp).reshape(-1, 2)
        return found[:, 0], found[:, 1]


def _solved(difference: Floats, slope: Floats, std: Floats) -> tuple[Floats, Floats]:
    """The lean `[2]` that explains the differences best (Huber), and its covariance, by what
    they scatter."""
    weight = np.ones(len(difference))
    for _ in range(8):
        w = weight / std**2
        square = (slope * w[:, None]).T @ slope + 1e-12 * np.eye(2)
        lean = np.linalg.solve(square, (slope * w[:, None]).T @ difference)
        off = (difference - slope @ lean) / std
        scale = max(1.4826 * float(np.median(abs(off))), 1.0)
        weight = np.minimum(1, _HUBER * scale / np.maximum(abs(off), 1e-12))
    # a patch stands in three pairs
    return np.asarray(lean, np.float64), np.asarray(
        3 * scale**2 * np.linalg.inv(square), np.float64
    )


def _way(lamp: Lamp, part: ShotSamples) -> Floats:
    if lamp.position is None:
        return lamp.direction
    away = lamp.position - part.shape.middle
    return np.asarray(away / np.linalg.norm(away))


def _said(way: Floats) -> str:
    return f"({', '.join(f'{c:+.2f}' for c in way)})"
