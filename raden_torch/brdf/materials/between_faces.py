"""Light that goes to and fro between a base and the face of the coat above it.

With l and v inside the coat, f the base's f_r, and R(μ) what the face throws back of light that
rises to it, absorption on the way up and down included,

    X(v, l) = f(v, l) + ∫ f(v, w) R(w) X(w̄, l) μ_w dω,   w̄ = w turned by half a turn,

which is what van de Hulst's adding method is for a mirror over a base (Multiple Light Scattering,
1980, ch. 4; as layered materials: Jakob et al., A comprehensive framework for rendering layered
materials, SIGGRAPH 2014). Where the base is the same at every azimuth, it is one linear system for
each Fourier order of the azimuth between l and v, solved here on Gauss-Legendre nodes: those
outside the coat for the directions that leave it, others for those that are totally reflected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.errors import InputError
from raden_torch.geometry import dot

_LEAVING, _TRAPPED, _AZIMUTHS = 24, 16, 64

BaseAt = Callable[[Tensor, Tensor, Tensor], Tensor]
"""f_r of n, l, v, unit vectors inside the coat."""


@dataclass(frozen=True, eq=False)
class BetweenFaces:
    """X − f: all but the first reflection.

    Attributes:
        nodes: `[I]` cosines outside the coat, rising.
        values: `[I, I, azimuths, C]` of v, of l, and of the azimuth from l to v, in 1/sr.
    """

    nodes: Tensor
    values: Tensor

    def at(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """`[B, C, H, W]` by directions outside the coat, read linearly."""
        n_l, n_v = dot(n, l), dot(n, v)
        across_l, across_v = l - n_l * n, v - n_v * n
        cosine = dot(across_l, across_v)
        sine = dot(n, geometry.cross(across_l, across_v))
        straight = (cosine == 0) & (sine == 0)
        azimuth = torch.atan2(sine, torch.where(straight, torch.ones_like(cosine), cosine))
        count = self.values.shape[2]
        turn = torch.remainder(azimuth / (2 * math.pi), 1) * count
        found = torch.zeros((), dtype=n.dtype, device=n.device)
        values = self.values.to(n)
        azimuth_low = turn.detach().floor()
        for i, share_i in self._beside(n_v):
            for j, share_j in self._beside(n_l):
                for k in (0, 1):
                    share_k = turn - azimuth_low if k else 1 - (turn - azimuth_low)
                    at = torch.broadcast_tensors(i, j, (azimuth_low.long() + k) % count)
                    rows = values[tuple(x.squeeze(geometry.XYZ_DIM) for x in at)]
                    share = share_i * share_j * share_k
                    found = found + share * rows.movedim(-1, geometry.XYZ_DIM)
        return found

    def _beside(self, cosine: Tensor) -> list[tuple[Tensor, Tensor]]:
        nodes = self.nodes.to(cosine)
        inside = cosine.clamp(float(nodes[0]), float(nodes[-1]))
        high = torch.searchsorted(nodes, inside.detach().contiguous()).clamp(1, len(nodes) - 1)
        part = (inside - nodes[high - 1]) / (nodes[high] - nodes[high - 1])
        return [(high - 1, 1 - part), (high, part)]


def between_faces(
    base: BaseAt, index: float, face: Callable[[Tensor], Tensor], depth: Tensor, like: Tensor
) -> BetweenFaces:
    """Solves for a base under a coat.

    Args:
        base: the same at every azimuth.
        index: of the coat.
        face: what its face reflects of light from outside, by the cosine outside, `[B, 1, H, W]`.
        depth: `[C]`, the coat's absorption along its normal: optical depth.
        like: a tensor of the dtype and on the device in which the base is evaluated.

    Raises:
        InputError: the base reflects more than it receives, so that light between the faces grows.
    """
    leaving, leaving_share = _gauss(0.0, 1.0, _LEAVING)
    inside = torch.sqrt(1 - (1 - leaving**2) / index**2)
    least = math.sqrt(1 - 1 / index**2)
    trapped, trapped_share = _gauss(0.0, least, _TRAPPED)
    # μ dμ of each node: inside it is 1/η² of what it is outside
    measure = torch.cat([trapped * trapped_share, leaving * leaving_share / index**2])
    mu = torch.cat([trapped, inside]).to(like)
    back = torch.ones(len(mu), dtype=torch.float64, device="cpu")
    back[_TRAPPED:] = face(leaving.view(1, 1, -1, 1)).flatten()
    orders = torch.fft.rfft(_sampled(base, mu), dim=2, norm="forward").movedim(2, 0)
    order = torch.arange(len(orders), device=mu.device)
    # the mirror sends azimuth φ back as φ + π
    sign = (1 - 2 * (order % 2)).view(-1, 1, 1, 1)
    lost = torch.exp(-2 * depth.to(mu) / mu[:, None])
    passed = 2 * math.pi * sign * ((measure * back).to(mu)[:, None] * lost)
    weighted = (orders * passed).movedim(-1, 1)  # [order, C, v, w]
    growth = float(weighted[0].real.detach().sum(-1).amax())
    if not growth < 1:
        raise InputError(
            "base: expected one that reflects less than all light within the coat, got "
            f"{growth:.3g} times as much from some direction"
        )
    unit = torch.eye(len(mu), dtype=weighted.dtype, device=mu.device)
    first = orders.movedim(-1, 1)
    more = torch.linalg.solve(unit - weighted, weighted @ first)[..., _TRAPPED:, _TRAPPED:]
    values = torch.fft.irfft(more.movedim(0, 2), n=_AZIMUTHS, dim=2, norm="forward")
    return BetweenFaces(*_to_the_normal(leaving, values.permute(1, 3, 2, 0)))


def _to_the_normal(nodes: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """One more node, the normal itself, of which every azimuth is the same."""
    for axis in (0, 1):
        last = values.narrow(axis, values.shape[axis] - 1, 1).mean(2, keepdim=True)
        values = torch.cat([values, last.expand(-1, -1, values.shape[2], -1)], axis)
    return torch.cat([nodes, nodes.new_ones(1)]), values


def _gauss(low: float, high: float, count: int) -> tuple[Tensor, Tensor]:
    node, weight = np.polynomial.legendre.leggauss(count)
    half = (high - low) / 2
    return torch.from_numpy(low + half * (node + 1)), torch.from_numpy(half * weight)


def _sampled(base: BaseAt, mu: Tensor) -> Tensor:
    """`[v, l, azimuth, C]` f_r of a base between the nodes."""
    count = len(mu)
    sine = torch.sqrt(1 - mu**2)
    turn = torch.arange(_AZIMUTHS, device=mu.device) * (2 * math.pi / _AZIMUTHS)
    zero = torch.zeros_like(mu)
    l = torch.stack([sine, zero, mu])[None, :, :, None]  # noqa: E741
    v = torch.stack(
        [
            (sine[:, None] * turn.cos()),
            (sine[:, None] * turn.sin()),
            mu[:, None].expand(-1, _AZIMUTHS),
        ]
    ).reshape(1, 3, 1, -1)
    n = torch.stack([zero[:1], zero[:1], zero[:1] + 1]).view(1, 3, 1, 1)
    shape = (1, 3, count, count * _AZIMUTHS)
    f = base(n, l, v).expand(shape)
    return f[0].reshape(3, count, count, _AZIMUTHS).permute(2, 1, 3, 0)
