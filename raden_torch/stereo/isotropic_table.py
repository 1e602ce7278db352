"""A simple isotropic BRDF that is fitted to readings at normals that are not yet sure.

f depends on θ_h, from the normal to the half vector, and θ_d, half the angle between light and
view (Rusinkiewicz 1998): films on facets, a matt body and their highlights are of this kind; what
also turns with the half vector's azimuth is taken as its mean. Both angles are those of the light
within a clear medium whose face is smooth, as lacquer over a shell or a shell that is polished,
and what passes that face comes on top (Fresnel, on the way in and out); an index of 1 is no medium.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import torch
from torch import Tensor

from raden_torch.arrays import Floats
from raden_torch.brdf.materials.coat import refracted
from raden_torch.brdf.materials.microfacet import fresnel
from raden_torch.brdf.materials.runtime import RuntimeBrdf, runtime_brdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.geometry import vectors_from_angles

_NODES = (32, 10)
_LAYOUT = RuntimeLayout((24, 57, 57), (0.4, 0.4))
_WARP = 0.5
"""Nodes lie densely at the highlight: in (θ_h/90°)^0.5."""
_LEAST_COSINE = 0.01
_ROUNDS, _CAUCHY = 4, 2.4
_ALONG_H, _ALONG_D = 0.02, 0.5
"""How much a second difference along θ_h, a first along θ_d weighs, of the readings at a node."""


@dataclass(frozen=True, eq=False)
class IsotropicTable:
    """A table.

    Attributes:
        nodes: `[H · D, C]` f_r in 1/sr without what the face takes, float64; C = 1 or 3.
        index: of the medium, 1 or more.
    """

    nodes: Tensor
    index: float

    @cached_property
    def material(self) -> RuntimeBrdf:
        """As a table that the kernels read."""
        return runtime_brdf(self._formula, self.nodes, _LAYOUT).float()

    def tinted(self, colour: Tensor) -> IsotropicTable:
        """The same times a factor `[C]` of each channel; of a grey table."""
        return IsotropicTable(self.nodes * colour.double(), self.index)

    def values(self, angles: Tensor) -> Floats:
        """`[M, 3]` f_r at incidence, receiving and tilt `[3, M]` in radians."""
        each = (a.reshape(1, 1, -1, 1) for a in angles)
        return np.asarray(self._formula(*vectors_from_angles(*each))[0, :, :, 0].T.numpy())

    def _formula(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        place, passed = _place(n, l, v, self.index)
        around = [self.nodes[node] * share[..., None] for node, share in _corners(place)]
        f = torch.stack(around).sum(0).movedim(-1, 1) * passed[:, None]
        return f.expand(-1, 3, -1, -1)


def fitted(
    n: Tensor,
    l: Tensor,  # noqa: E741
    v: Tensor,
    readings: Tensor,
    weight: Tensor,
    index: float,
) -> IsotropicTable:
    """By robust least squares with smoothness where readings are rare.

    Args:
        n, l, v: `[B, 3, H, W]` unit.
        readings: `[B, C, H, W]` f_r, 1/sr times the photographs' scale.
        weight: `[B, C, H, W]` one over the standard deviation of each reading; 0 where it does not
            count.
        index: of the medium, 1 or more.
    """
    from scipy.sparse import csr_matrix

    place, passed = _place(n, l, v, index)
    readings, weight = readings / passed[:, None], weight * passed[:, None]
    used = (weight > 0).all(1)
    corners = [
        (node[used].numpy(), share[used].double().numpy()) for node, share in _corners(place)
    ]
    count, rows = _NODES[0] * _NODES[1], int(used.sum())
    at = (np.tile(np.arange(rows), 4), np.concatenate([node for node, _ in corners]))
    shares = csr_matrix((np.concatenate([share for _, share in corners]), at), (rows, count))
    values = []
    for channel in range(readings.shape[1]):
        target, sure = (m[:, channel][used].double().numpy() for m in (readings, weight))
        robust = np.ones(rows)
        for _ in range(_ROUNDS):
            weighted = shares.multiply((robust * sure**2)[:, None]).tocsr()
            matrix = (shares.T @ weighted).toarray()
            smooth = np.trace(matrix) / count * _smoothness()
            found = np.linalg.solve(matrix + smooth, weighted.T @ target)
            off = (shares @ found - target) * sure
            wide = max(1.4826 * float(np.median(abs(off))), 1e-12)
            robust = 1 / (1 + (off / (_CAUCHY * wide)) ** 2)
        values.append(torch.from_numpy(found.clip(min=0)))
    return IsotropicTable(torch.stack(values, -1), index)


def lobe(width: float, height: float, index: float) -> IsotropicTable:
    """A matt body and a highlight of so many times its f_r: h exp(−tan²θ_h/(2 w²)), grey, in
    a medium."""
    at_h = np.linspace(0, 1, _NODES[0]) ** (1 / _WARP) * (math.pi / 2)
    f = (1 + height * np.exp(-(np.tan(at_h.clip(max=1.57)) ** 2) / (2 * width**2))) / math.pi
    return IsotropicTable(torch.from_numpy(np.repeat(f, _NODES[1])[:, None]), index)


@cache
def _smoothness() -> Floats:
    """`[nodes, nodes]`, of second differences along θ_h and first ones along θ_d."""
    rows, columns = _NODES
    second, first = np.diff(np.eye(rows), n=2, axis=0), np.diff(np.eye(columns), axis=0)
    along_h = np.kron(second.T @ second, np.eye(columns))
    along_d = np.kron(np.eye(rows), first.T @ first)
    return _ALONG_H * along_h + _ALONG_D * along_d + 1e-9 * np.eye(rows * columns)


def _place(
    n: Tensor,
    l: Tensor,  # noqa: E741
    v: Tensor,
    index: float,
) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Positions along both axes, and what passes the medium's face, `[B, H, W]` each; both go on
    below the horizon, as tables are read across it."""
    cosines = [(n * w).sum(1).clamp(_LEAST_COSINE, 1) for w in (l, v)]
    passed = (1 - fresnel(cosines[0], index)) * (1 - fresnel(cosines[1], index))
    l, v = (refracted(n, w, c[:, None], index) for w, c in zip((l, v), cosines, strict=True))  # noqa: E741
    half = l + v
    length = half.norm(dim=1).clamp(min=1e-9)
    along = (n * half).sum(1) / length
    across = torch.linalg.cross(n, half, dim=1).norm(dim=1) / length
    theta_h = torch.atan2(across, along).clamp(0, math.pi / 2)
    theta_d = torch.atan2((l - v).norm(dim=1), length)
    at_h = (theta_h / (math.pi / 2)).clamp(min=1e-12) ** _WARP * (_NODES[0] - 1)
    at_d = theta_d / (math.pi / 2) * (_NODES[1] - 1)
    return (at_h, at_d), passed


def _corners(place: tuple[Tensor, Tensor]) -> list[tuple[Tensor, Tensor]]:
    """The four nodes around and their shares."""
    low = [p.floor().clamp(0, n - 2) for p, n in zip(place, _NODES, strict=True)]
    part = [p - b for p, b in zip(place, low, strict=True)]
    found = []
    for i in (0, 1):
        for j in (0, 1):
            node = (low[0].long() + i) * _NODES[1] + low[1].long() + j
            share = (part[0] if i else 1 - part[0]) * (part[1] if j else 1 - part[1])
            found.append((node, share))
    return found
