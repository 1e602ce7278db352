"""Beyond the measured box: the measured logarithms, continued by learnt weights.

At a geometry q = (incidence a, receiving r, tilt t) outside the box the reflectance factor f is

    log(ε + f(q)) = log(ε + f(c)) + Σ over faces Σₖ wₖ(q) Dₖ,    wₖ(q) = Σⱼ Wₖⱼ bⱼ(q),

with c the nearest geometry in the box and Dₖ differences of log(ε + f) inside it: how far from c
it is at the places where the line of one half vector (r − a) and that of one difference angle
(r + a) enter the box, and the slopes at these places. The basis b vanishes at the face. As all Dₖ
are differences, a constant is continued by itself and a scaled table, far above ε, by scaled
values; incidence and receiving share their weights, so what is reciprocal stays so.

The W were learnt from real materials by `benchmarks/learn_continuation.py`, and stand in
`continuation.json` (docs/decisions/0017-outside-the-box.md).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from scipy.ndimage import map_coordinates

from raden_torch.arrays import Floats
from raden_torch.reflectance.grid import AngleGrid
from raden_torch.reflectance.interpolation import Interpolant

Look = Callable[[Floats], Floats]
"""`[M, 3]` angles in degrees → `[M, C]` logarithms log(ε + f). Incidence may be negative, which is
the equivalent geometry (−a, −r, −t); outside the box it is the value at the nearest geometry."""

FLOOR = 1e-3
"""ε, a reflectance factor (perfect diffuser = 100)."""

_STEP_DEG = 5.0  # between the two geometries of a slope; the unit of d
_KNOWN_TO_DEG = 80.0  # the truth that W was learnt from ends here; beyond it growth does,
_GROWTH_DEG = 5.0  # within about this much
_FARTHEST = 6.0  # d, in steps: no truth was farther from its box
_SMALLEST_DEG = 50.0  # the smallest box that was learnt from
_LARGEST_DEG = 70.0
_HELD_TO_DEG = 30.0  # a face nearer to 0 than this holds its value, one below the smallest partly
_MOST = 2.0  # of the logarithm: how far a value may leave the range of those it is made of
_HORIZON_DEG = 90.0
_AT_ONCE = 100_000  # geometries: the memory that their differences take


@dataclass(frozen=True)
class Continued:
    """A function of the angles up to the horizon: in the box an interpolant, beyond it continued.

    Attributes:
        grid: the interpolant's, longer by whole steps, to the horizon or just beyond.
        inner: in the box.
        look: the logarithms at and between its nodes.
    """

    grid: AngleGrid
    inner: Interpolant
    look: Look

    def __call__(self, angles_deg: Floats, channels: slice = slice(None)) -> Floats:
        """`[M, 3]` incidence, receiving, tilt in degrees → `[M, C]` reflectance factors ≥ 0."""
        held = np.clip(angles_deg, self.inner.grid.low, self.inner.grid.high)
        found = self.inner(held, channels)
        outside = np.flatnonzero(~self.inner.grid.contains(angles_deg))
        for start in range(0, len(outside), _AT_ONCE):
            rows = outside[start : start + _AT_ONCE]
            logs = self._logs(angles_deg[rows], held[rows], found[rows], channels)
            found[rows] = np.maximum(np.exp(logs) - FLOOR, 0)
        return found

    def _logs(self, q: Floats, held: Floats, nearest: Floats, channels: slice) -> Floats:
        """log(ε + f) outside the box, of the nearest geometries in it and their values."""
        box = np.stack([self.inner.grid.low, self.inner.grid.high])
        logs = np.log(FLOOR + nearest) + log_change(self.look, q, box)[:, channels]
        # within a step of the box a narrow ridge is followed as in it
        near = np.maximum(1 - abs(q - held) / self.inner.grid.step, 0).prod(axis=1)
        beside = near > 0
        along = held[beside]
        along[:, 1] = q[beside, 1]
        ridge = np.log(FLOOR + self.inner(along, channels))
        logs[beside] += near[beside, None] * (ridge - logs[beside])
        return np.asarray(logs)


def continued(inner: Interpolant, values: Floats) -> Continued:
    """Continue an interpolant to the horizon.

    Args:
        values: `[A, R, T, C]` reflectance factors at its nodes, without gaps.
    """
    look = look_into(inner.grid, np.log(FLOOR + np.maximum(values, 0)))
    return Continued(to_horizon(inner.grid), inner, look)


def to_horizon(grid: AngleGrid) -> AngleGrid:
    """The grid continued on its steps to the horizon, or just beyond."""
    lows = 0.0, -_HORIZON_DEG, -_HORIZON_DEG
    return AngleGrid(*(_longer(axis, low) for axis, low in zip(grid, lows, strict=True)))


def log_change(look: Look, angles_deg: Floats, low_high: Floats) -> Floats:
    """By how much log(ε + f) at geometries outside the box differs from the nearest one in it.

    Args:
        look: those in the box.
        angles_deg: `[M, 3]` incidence ≥ 0, receiving, tilt.
        low_high: `[2, 3]`, the box.

    Returns:
        `[M, C]`.
    """
    change, least, most = 0.0, 0.0, 0.0
    for face in faces(look, angles_deg, low_high):
        weights = face.basis @ learnt_weights()[face.kind].T
        change = change + np.einsum("mk,mkc->mc", weights, face.differences)
        lines = face.differences[:, : face.lines] * (face.basis[:, :1, None] > 0)
        least = np.minimum(least, lines.min(axis=1, initial=0))
        most = np.maximum(most, lines.max(axis=1, initial=0))
    return np.clip(change, least - _MOST, most + _MOST)


@cache
def learnt_weights() -> dict[str, Floats]:
    """W by kind of face, `[K, J]`."""
    text = resources.files("raden_torch.reflectance").joinpath("continuation.json").read_text()
    return {kind: np.array(rows) for kind, rows in json.loads(text)["weights"].items()}


@dataclass(frozen=True)
class Face:
    """What one pair of opposite faces of the box contributes.

    Attributes:
        kind: "side" (incidence, receiving) or "tilt".
        basis: b, `[M, J]`; 0 where a geometry is not beyond this face.
        differences: D, `[M, K, C]`.
        lines: how many of them, the first, lead to another place of the box; the rest are slopes.
    """

    kind: str
    basis: Floats
    differences: Floats
    lines: int


def faces(look: Look, angles_deg: Floats, low_high: Floats) -> tuple[Face, Face, Face]:
    """The faces of incidence, receiving and tilt; arguments as in `log_change`."""
    q = np.clip(angles_deg, -_HORIZON_DEG, _HORIZON_DEG)
    held = np.clip(q, *low_high)
    # not outward, as below the first incidence: there the value is held
    outward = (abs(q) > abs(held)) & (q * held > 0)
    beyond = np.where(outward, abs(q - held), 0.0)
    d = np.where(outward, abs(_growth(q) - _growth(held)) / _STEP_DEG, 0.0)
    trust = np.clip((abs(held) - _HELD_TO_DEG) / (_SMALLEST_DEG - _HELD_TO_DEG), 0, 1)
    d = np.minimum(d, _FARTHEST) * trust
    return (
        _side(look, q, held, beyond, d, axis=0),
        _side(look, q, held, beyond, d, axis=1),
        _tilt(look, q, held, d),
    )


def _side(look: Look, q: Floats, held: Floats, beyond: Floats, d: Floats, axis: int) -> Face:
    """Beyond the last incidence (axis 0), or the first or last receiving angle (1).

    b = d · (1, d, ρ, max(ρ, 0), ρ², τ, τ², o, min(d, o) / max(d, o), k, d k), with d and o the
    angles beyond this and the other side in steps, ρ the other angle over 90 degrees (positive
    where the mirror is), τ = |t| / 90, and k by how much the box is smaller than 70 degrees, in 20.
    """
    sign = np.where(q[:, axis] < 0, -1.0, 1.0)[:, None]
    out, across = sign * np.eye(3)[axis], sign * np.eye(3)[1 - axis]
    up, down = out + across, out - across  # along r + a, the half vector kept; and along r − a
    tilted = np.sign(q[:, 2:]) * np.eye(3)[2]
    back = beyond[:, :2].max(axis=1, keepdims=True)
    c, c_up, c_down = held, q - back * up, q - back * down
    c_up[:, 2], c_down[:, 2] = held[:, 2], held[:, 2]
    h = _STEP_DEG
    at_c, at_up, at_down = look(c), look(c_up), look(c_down)
    inner, inner_up = look(c - h * out), look(c_up - h * up)
    differences = [
        at_up - at_c,
        at_down - at_c,
        at_c - inner,
        inner - look(c - 2 * h * out),
        at_up - inner_up,
        inner_up - look(c_up - 2 * h * up),
        at_down - look(c_down - h * down),
        look(c + h * across) - at_c,
        at_c - look(c - h * across),
        look(c + h * tilted) - look(c - h * tilted),
    ]
    own, o = d[:, axis], d[:, 1 - axis]
    rho = sign[:, 0] * _growth(q[:, 1 - axis]) / 90
    t = abs(_growth(q[:, 2])) / 90
    k = (_LARGEST_DEG - np.clip(abs(held[:, axis]), _SMALLEST_DEG, _LARGEST_DEG)) / 20
    one = np.ones_like(own)
    both = np.minimum(own, o) / np.maximum(np.maximum(own, o), 1e-9)
    basis = [one, own, rho, np.maximum(rho, 0), rho**2, t, t**2, o, both, k, own * k]
    return Face("side", own[:, None] * np.stack(basis, 1), np.stack(differences, 1), lines=2)


def _tilt(look: Look, q: Floats, held: Floats, d: Floats) -> Face:
    """Beyond the first or last tilt: b = d · (1, d, cos a cos r, sin a sin r)."""
    h = _STEP_DEG
    out_a, out_r, out_t = (np.sign(q[:, [i]]) * np.eye(3)[i] for i in range(3))
    at_c, inner = look(held), look(held - h * out_t)
    differences = [
        at_c - inner,
        inner - look(held - 2 * h * out_t),
        2 * at_c - look(held - h * out_a) - look(held - h * out_r),
    ]
    a, r, _ = np.deg2rad(_growth(q)).T
    own = d[:, 2]
    basis = [np.ones_like(own), own, np.cos(a) * np.cos(r), np.sin(a) * np.sin(r)]
    return Face("tilt", own[:, None] * np.stack(basis, 1), np.stack(differences, 1), lines=0)


def _growth(angle_deg: Floats) -> Floats:
    """The angle up to where truth is known; beyond it growth ends, smoothly."""
    over = np.maximum(abs(angle_deg) - _KNOWN_TO_DEG, 0)
    grown = np.minimum(abs(angle_deg), _KNOWN_TO_DEG) - _GROWTH_DEG * np.expm1(-over / _GROWTH_DEG)
    return np.asarray(np.copysign(grown, angle_deg))


def look_into(grid: AngleGrid, logs: Floats) -> Look:
    """Trilinear in a table of logarithms `[A, R, T, C]`."""
    first, last, step = grid.low, grid.high, grid.step

    def look(angles_deg: Floats) -> Floats:
        turn = np.where(angles_deg[:, :1] < 0, -1.0, 1.0) if grid.is_mirrored else 1.0
        node = (np.clip(angles_deg * turn, first, last) - first) / step
        node = np.where(abs(node - np.rint(node)) < 1e-9, np.rint(node), node)
        channels = np.moveaxis(logs, 3, 0)
        return np.stack([map_coordinates(x, node.T, order=1, mode="nearest") for x in channels], 1)

    return look


def _longer(axis: Floats, low: float) -> Floats:
    """The axis continued on its step to `low` and to the horizon, or just beyond."""
    step = (axis[-1] - axis[0]) / (len(axis) - 1)
    before = max(int(np.ceil((axis[0] - low) / step - 1e-6)), 0)
    after = max(int(np.ceil((_HORIZON_DEG - axis[-1]) / step - 1e-6)), 0)
    below = axis[0] - step * np.arange(before, 0, -1)
    above = axis[-1] + step * np.arange(1, after + 1)
    return np.concatenate([below, axis, above])
