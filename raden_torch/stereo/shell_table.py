"""The reflection of a shell as it is learnt from photographs: smooth where no photograph looked.

log(f + floor) over half the angle between light and view α, and the angles |s| and |t| by which
the layers' normal stands off the half vector, in the plane of light and view and across it: with
incidence a, receiving r and tilt t, α = (a + r)/2 and s = (a − r)/2. So it is one value for light
and view exchanged, and for a shell turned by half a turn. The nodes lie where an inlay seen from
above shows something; beyond them the last node's value holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raden_torch.arrays import Floats
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout, angles_of
from raden_torch.geometry import angles_from_unit_vectors
from raden_torch.stereo.normal_refine import CAUCHY
from raden_torch.stereo.observed_light import GRAZING, ObservedLight

_NODES_DEG = (
    np.array([0, 3, 6, 9, 12, 15, 18, 21, 24, 28, 32, 36, 42, 50.0]),
    np.array([0, 5, 10, 15, 20, 25, 30, 35, 45.0]),
    np.array([0, 2.5, 5, 7.5, 10, 12.5, 15, 18, 22, 30.0]),
)
"""Of |s|, α and |t|; the longest axis first, for the band of the normal equations."""
SHAPE = tuple(len(nodes) for nodes in _NODES_DEG)
COUNT = math.prod(SHAPE)
_BAND = 2 * math.prod(SHAPE[1:])
_FLOOR = 0.01
"""In 1/sr, where the shell's mean is `MEAN`."""
_CURVE = (0.03, 0.003, 0.03)
"""Standard deviation of the second derivatives of log f that are expected, per degree squared."""
_SLOPE = (0.15, 0.03, 0.15)
"""The same of the first, per degree."""
_LAYOUT = RuntimeLayout((24, 57, 57), (0.4, 0.4))


@dataclass(frozen=True, eq=False)
class ShellTable:
    """A table.

    Attributes:
        logs: `[COUNT, 3]` log(f + floor), float64.
    """

    logs: Floats

    @property
    def material(self) -> RuntimeBrdf:
        """As a table that the kernels read."""
        values = self._at(_runtime_nodes()).reshape(*_LAYOUT.shape, 3)
        return RuntimeBrdf(torch.from_numpy(values).float(), _LAYOUT)

    def values(self, angles: Tensor) -> Floats:
        """`[M, 3]` f_r at incidence, receiving and tilt `[3, M]` in radians."""
        return self._at(_shares(angles))

    def _at(self, shares: Any) -> Floats:
        return np.asarray(np.clip(np.exp(shares @ self.logs) - _FLOOR, 0, None))


def body(width_deg: float, height: float, tilt_deg: float) -> ShellTable:
    """A matt grey body and a pair of highlights of so many times its f_r, at s = 0 and t = ± tilt:
    the planes of a shell stand at an angle to its surface."""
    s, _, t = np.meshgrid(*_NODES_DEG, indexing="ij")
    across = sum(np.exp(-(((t - c) / width_deg) ** 2) / 2) for c in (tilt_deg, -tilt_deg))
    pair = 1.0 if tilt_deg > 0 else 0.5
    f = (1 + height * pair * np.exp(-((s / width_deg) ** 2) / 2) * across) / math.pi
    return ShellTable(np.repeat(np.log(f + _FLOOR).reshape(-1, 1), 3, axis=1))


def readings_deg(light: ObservedLight, normal: Tensor) -> Floats:
    """`[K, P, 3]` incidence, receiving and tilt of pixels whose layers' normals are `[3, P]`."""
    angles = torch.stack(_angles(light, normal))
    return np.asarray(np.rad2deg(angles.numpy()).transpose(1, 2, 0))


def fitted(
    light: ObservedLight,
    normal: Tensor,
    scale: Tensor,
    trust: Tensor,
    *,
    start: ShellTable | None = None,
    rounds: int = 4,
) -> ShellTable:
    """What these pixels show if their layers' normals are these `[3, P]`.

    Robust least squares on log f by Gauss–Newton, with smoothness.

    Args:
        scale: `[P]`, of the photographs, over f_r times the irradiance.
        trust: `[P]`, how much each pixel counts.
        start: where it begins; it is flat where None.
    """
    from scipy.linalg import solveh_banded

    facing = light.strength[:, 0] * (light.light * light.film_surface).sum(1)
    facing = facing.expand(-1, light.pixels)[:, None].clamp(min=0)
    sure = (
        (light.weight * facing * scale * trust.sqrt()).movedim(1, -1).flatten(0, 1).double().numpy()
    )
    shown = light.value / (facing * scale).clamp(min=1e-9)
    f = shown.movedim(1, -1).flatten(0, 1).double().numpy()
    used = ((facing > GRAZING) & (light.usable > 0))[:, 0].flatten().numpy()
    shares = _shares(torch.stack(_angles(light, normal)).flatten(1))[used]
    f, sure = f[used], sure[used]
    prior, logs = _smoothness(), []
    for channel in range(f.shape[1]):
        value, weight = f[:, channel], sure[:, channel]
        if start is None:
            found = np.full(COUNT, math.log(float(np.median(value)) + _FLOOR))
        else:
            found = start.logs[:, channel]
        for _ in range(rounds):
            at = shares @ found
            lifted = np.exp(at)
            off = (lifted - _FLOOR - value) * weight
            counts = (weight * lifted) ** 2 / (1 + (off / CAUCHY) ** 2)
            wanted = at + np.clip((value + _FLOOR - lifted) / lifted, -1, 1)
            matrix = (shares.T @ shares.multiply(counts[:, None])).toarray() + prior
            found = solveh_banded(_banded(matrix), shares.T @ (counts * wanted))
        logs.append(found)
    return ShellTable(np.stack(logs * (3 // len(logs)), 1))


def _banded(matrix: Floats) -> Floats:
    """The upper diagonals as `solveh_banded` takes them."""
    found = np.zeros((_BAND + 1, COUNT))
    for k in range(_BAND + 1):
        found[_BAND - k, k:] = np.diagonal(matrix, k)
    return found


def _angles(light: ObservedLight, normal: Tensor) -> tuple[Tensor, ...]:
    """Incidence, receiving, tilt, `[K, P]` each, in radians."""
    vectors = light.vectors(normal)
    return tuple(angle[:, 0, 0].double() for angle in angles_from_unit_vectors(*vectors))


def _shares(angles: Tensor) -> Any:
    """`[M, COUNT]` sparse: how far each node counts at angles `[3, M]` in radians."""
    from scipy.sparse import csr_matrix

    a, r, t = np.rad2deg(angles.numpy())
    places = (abs(a - r) / 2, abs(a + r) / 2, abs(t))
    low, part = [], []
    for place, nodes in zip(places, _NODES_DEG, strict=True):
        below = np.clip(np.searchsorted(nodes, place, side="right") - 1, 0, len(nodes) - 2)
        low.append(below)
        part.append(np.clip((place - nodes[below]) / np.diff(nodes)[below], 0, 1))
    columns, entries = [], []
    for corner in np.ndindex(2, 2, 2):
        at = [below + c for below, c in zip(low, corner, strict=True)]
        columns.append(np.ravel_multi_index(at, SHAPE))
        entries.append(
            np.prod([p if c else 1 - p for p, c in zip(part, corner, strict=True)], axis=0)
        )
    rows = np.tile(np.arange(angles.shape[1]), 8)
    place_of = (rows, np.concatenate(columns))
    return csr_matrix((np.concatenate(entries), place_of), (angles.shape[1], COUNT))


@cache
def _runtime_nodes() -> Any:
    """`_shares` at the nodes of the runtime table."""
    u, v, w = (
        torch.linspace(low, 1, count, dtype=torch.float64)
        for low, count in zip((0.0, -1.0, -1.0), _LAYOUT.shape, strict=True)
    )
    u, v, w = (axis.clamp(-0.999, 0.999) for axis in (u, v, w))
    angles = angles_of(_LAYOUT.warp, u[:, None, None], v[:, None], w)
    return _shares(torch.stack(torch.broadcast_tensors(*angles)).flatten(1))


@cache
def _smoothness() -> Floats:
    """`[COUNT, COUNT]`, of second and first differences along each axis."""
    whole = np.zeros((COUNT, COUNT))
    for axis, nodes in enumerate(_NODES_DEG):
        for difference, size in ((_second, _CURVE), (_first, _SLOPE)):
            matrix = difference(nodes, mirrored=axis != 1) / size[axis]
            each = [np.eye(len(n)) for n in _NODES_DEG]
            each[axis] = matrix.T @ matrix
            whole += np.kron(np.kron(each[0], each[1]), each[2])
    return whole


def _first(nodes: Floats, *, mirrored: bool) -> Floats:
    return np.diff(np.eye(len(nodes)), axis=0) / np.diff(nodes)[:, None]


def _second(nodes: Floats, *, mirrored: bool) -> Floats:
    """Second derivatives at the inner nodes; at the first, too, where it is a mirror plane."""
    slopes = _first(nodes, mirrored=mirrored)
    inner = 2 * np.diff(slopes, axis=0) / (nodes[2:] - nodes[:-2])[:, None]
    return np.concatenate([2 * slopes[:1] / nodes[1], inner]) if mirrored else inner
