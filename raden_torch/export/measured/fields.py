"""The fields of a `measured` file: what they are made of, and the reflection that they hold.

Directions to the viewer (i) and of half vectors (m) lie in the square by u = √(2θ/π) and
v = φ/2π + 1/2, with m's azimuth from i's, so that a file of one `phi_i` holds every reflection that
does not change when light and viewer turn together about the normal. A reader maps (u, v) of m by
the warp of `vndf` to a point s, and takes

    f_r cos θo = spectra(θi, s) ndf(m) / (4 sigma(i)).

`luminance` is a density of s to sample from. Source: Mitsuba 3, src/bsdfs/measured.cpp; pbrt-v4,
src/pbrt/bxdfs.cpp; Dupuy and Jakob 2018, §5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.export.measured.warp import Warp, between, bilinear

Reflectance = Callable[[Floats, Floats], Floats]
"""f_r `[N, C]` in 1/sr of directions to light and viewer, `[N, 3]` each, the normal being +z."""

LAST_DEG = 89.9
_NDF_NODES = 256
_WARP_ROWS, _WARP_COLUMNS = 64, 96
_NEAREST = 1e-4
_FLOOR = 1e-3
_HORIZON = 1e-3
_SHARES = (0.4, 0.3, 0.3)


@dataclass(frozen=True, eq=False)
class Measured:
    """The fields, in double precision.

    Attributes:
        theta_i: of the viewers, radians, `[T]`.
        ndf, sigma: `[2, K]`: they do not change with the azimuth.
        warp: of `vndf`, `[T, Y, X]`.
        luminance: `[T, N, N]`.
        values: f_r cos θo · 4 sigma / ndf, `[T, C, N, N]`.
    """

    theta_i: Floats
    ndf: Floats
    sigma: Floats
    warp: Warp
    luminance: Floats
    values: Floats

    def f_r(self, light: Floats, view: Floats) -> Floats:
        """`[M, C]` in 1/sr, as a reader has it, of directions above the horizon `[M, 3]`."""
        theta, phi = elevation(view), np.arctan2(view[:, 1], view[:, 0])
        m = light + view
        m = m / np.linalg.norm(m, axis=1, keepdims=True)
        turn = np.arctan2(m[:, 1], m[:, 0]) - phi
        place = np.stack([_u(elevation(m)), (turn / (2 * np.pi) + 0.5) % 1], 1)
        s = self.warp.inverse(theta, place)
        low, share = between(self.theta_i, theta)
        found = np.empty((len(light), self.values.shape[1]))
        for t in np.unique(low):
            own = low == t
            two = (bilinear(self.values[at], s[own]) for at in (t, t + 1))
            before, after = two
            found[own] = (before + share[own] * (after - before)).T
        own_view = np.stack([_u(theta), np.full(len(theta), 0.5)], 1)
        by = bilinear(self.ndf, place) / (4 * bilinear(self.sigma, own_view))
        return found * (by / light[:, 2])[:, None]


def fields_of(f_r: Reflectance, viewers: int, side: int) -> Measured:
    """A reflection in the format.

    Args:
        viewers: how many incidences it is tabulated for.
        side: nodes along each side of the square of s.
    """
    theta = np.deg2rad(np.linspace(0, LAST_DEG, viewers))
    at = _square(_WARP_ROWS, _WARP_COLUMNS)
    energy = np.stack([_energy(f_r, x, at) for x in theta])
    energy = energy.reshape(viewers, _WARP_ROWS, _WARP_COLUMNS)
    ndf = _ndf(energy)
    sigma = _sigma(ndf)
    warp = Warp.of(theta, _spread(energy, theta, at))
    corners = _square(side, side)
    values, luminance = [], []
    for t, x in enumerate(theta):
        place = warp.forward(t, corners)
        lit = _lit(f_r, x, place)
        by = 4 * bilinear(sigma, np.array([[_u(x), 0.5]])) / bilinear(ndf, place)
        values.append((lit * by[:, None]).T.reshape(-1, side, side))
        luminance.append(_remaining(f_r, warp, t, x, corners).reshape(side, side))
    return Measured(theta, ndf, sigma, warp, np.stack(luminance), np.stack(values))


def elevation(w: Floats) -> Floats:
    """The angle to +z of unit vectors `[N, 3]`, exact near it."""
    return 2 * np.arcsin(np.clip(np.linalg.norm(w - (0, 0, 1), axis=1) / 2, 0, 1))


def _u(theta: Floats) -> Floats:
    return np.sqrt(theta * (2 / np.pi))


def _square(rows: int, columns: int) -> Floats:
    """`[rows·columns, 2]` (x, y) of a grid over the unit square, x fastest."""
    y, x = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    return np.stack([x.ravel(), y.ravel()], 1)


def _geometry(theta: float, place: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Light, viewer `[N, 3]` each, i·m, and the solid angle of m for an area of the square."""
    polar, turn = place[:, 0] ** 2 * (np.pi / 2), 2 * np.pi * (place[:, 1] - 0.5)
    sine = np.sin(polar)
    m = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.cos(polar)], 1)
    view = np.array([np.sin(theta), 0.0, np.cos(theta)])
    along = m @ view
    light = 2 * along[:, None] * m - view
    return light, np.broadcast_to(view, light.shape), along, 2 * np.pi**2 * place[:, 0] * sine


def _lit(f_r: Reflectance, theta: float, place: Floats) -> Floats:
    """f_r cos θo `[N, C]`; below the horizon that of the horizon above it goes on, negative, so
    that what lies between the nodes reaches 0 at the horizon."""
    light, view, _, _ = _geometry(theta, place)
    up = light.copy()
    up[:, 2] = up[:, 2].clip(_HORIZON)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return f_r(up, view) * light[:, 2:]


def _energy(f_r: Reflectance, theta: float, place: Floats) -> Floats:
    """Σ|f_r| cos θo over the channels, 0 below the horizon, `[N]`."""
    light, _, along, _ = _geometry(theta, place)
    seen = (light[:, 2] > 0) & (along > 0)
    return np.where(seen, np.abs(_lit(f_r, theta, place)).sum(1), 0.0)


def _ndf(energy: Floats) -> Floats:
    """The energy of half vectors by their angle alone, as a density of normals: its projected area
    is 1. `[2, K]`."""
    seen = energy > 0
    mean = energy.sum((0, 1)) / np.maximum(seen.sum((0, 1)), 1)
    mean = np.maximum(mean, max(_FLOOR * mean.max(), 1e-30))
    nodes = np.linspace(0, 1, _NDF_NODES)
    found = np.interp(nodes, np.linspace(0, 1, len(mean)), mean)
    polar = nodes**2 * (np.pi / 2)
    area = 2 * np.pi * np.trapezoid(found * np.cos(polar) * np.sin(polar), polar)
    return np.tile(found / area, (2, 1))


def _sigma(ndf: Floats) -> Floats:
    """∫ D(m) max(i·m, 0) dm by the viewer's angle, `[2, K]` (Dupuy and Jakob 2018, eq. (5))."""
    polar = np.linspace(0, 1, ndf.shape[1]) ** 2 * (np.pi / 2)
    turn = (np.arange(64) + 0.5) / 64 * np.pi
    flat = np.sin(polar)[:, None] * np.cos(turn)
    found = []
    for theta in polar:
        seen = (np.sin(theta) * flat + np.cos(theta) * np.cos(polar)[:, None]).clip(0)
        ring = ndf[0] * np.sin(polar) * seen.mean(1) * 2 * np.pi
        found.append(np.trapezoid(ring, polar))
    return np.tile(found, (2, 1))


def _spread(energy: Floats, theta: Floats, at: Floats) -> Floats:
    """Where the nodes go: by energy, evenly by solid angle, evenly over the square; `[T, Y, X]`.

    Evenly means over what is above the horizon, and a node further, so that the horizon lies
    between nodes on its two sides.
    """
    found = []
    for own, x in zip(energy, theta, strict=True):
        light, _, along, solid = _geometry(x, at)
        by_place = (solid * along.clip(0)).reshape(own.shape)
        seen = _widened(((light[:, 2] > 0) & (along > 0)).reshape(own.shape))
        parts = own * by_place, seen * by_place, seen * 1.0
        found.append(sum(w * p / p.mean() for w, p in zip(_SHARES, parts, strict=True)))
    return np.stack(found)


def _widened(seen: Bools) -> Bools:
    """With the neighbours along both axes; y is an azimuth, and goes round."""
    wider = seen.copy()
    wider[:, 1:] |= seen[:, :-1]
    wider[:, :-1] |= seen[:, 1:]
    inner = wider[:-1]  # the last row is the first
    inner = inner | np.roll(inner, 1, 0) | np.roll(inner, -1, 0)
    return np.concatenate([inner, inner[:1]])


def _remaining(f_r: Reflectance, warp: Warp, t: int, theta: float, corners: Floats) -> Floats:
    """The energy over the density of the warp, at s: what is left to sample. `[N]`."""
    place = warp.forward(t, corners.clip(_NEAREST, 1 - _NEAREST))
    _, _, along, solid = _geometry(theta, place)
    wanted = _energy(f_r, theta, place) * solid * along.clip(0)
    left = wanted / np.maximum(bilinear(warp.density[t], place), 1e-30)
    return np.maximum(left, max(_FLOOR * left.mean(), 1e-30))
