"""The runtime form of a model: one regular table of f_r over the whole hemisphere, read without
trigonometry.

With h, e, p the unit vectors along L + V, V − L and L × V, and x, y, z the components of N along
them, a geometry is the half angle α between L and V, y and z: sin α = |V − L|/2,
tan((a − r)/2) = y/x, sin t = z and a + r = 2α, where a, r and t have their signs from before the
flip (see `geometry`). The table's axes are

- u = tan(α/2), from 0 (L ∥ V) to 1 (L ∥ −V);
- v = y/(|y| + c m) with m = min(N·L, N·V) = x cos α − |y| sin α: −1 and 1 are the horizon;
- w = z/(|z| + k x): −1 and 1 are N = ±p.

The constants c and k (`RuntimeLayout.warp`) put the nodes where the highlight is, at y = z = 0.

With d = V − L, δ = |d|, Y = N·d and Z = N·(L × d): y = Y/δ, x = (N·L + N·V)/√(4 − δ²) and
z/x = 2Z/(δ (N·L + N·V)). So an address takes dot products, two roots and three divisions. It loses
nothing where L and V almost agree: d is exact there, and what it has along L + V, where L and V are
unit vectors but for rounding, is taken off. At L = V the plane of L and N is taken, as in
`geometry`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.model.reflectance_table import trilinear
from raden_torch.errors import InputError

_LEAST_NODES = 3
_MOST_NODES = 2**21  # 25 MB in single precision, and some 300 MB while it is baked
_WARP = (1e-3, 1e3)
_LEAST = 1e-30
"""Keeps a quotient of numbers that underflow finite."""


@dataclass(frozen=True)
class RuntimeLayout:
    """The nodes of a runtime table.

    Attributes:
        shape: nodes along u, v and w.
        warp: c and k, in 0.001…1000; the smaller, the closer the nodes to the highlight.
    """

    shape: tuple[int, int, int]
    warp: tuple[float, float]

    def __post_init__(self) -> None:
        if len(self.shape) != 3 or min(self.shape) < _LEAST_NODES:
            raise InputError(
                f"runtime table: expected three axes of at least {_LEAST_NODES} nodes, got "
                f"{list(self.shape)}"
            )
        if self.nodes > _MOST_NODES:
            raise InputError(
                f"runtime table: expected at most {_MOST_NODES} nodes, got {list(self.shape)}"
            )
        if len(self.warp) != 2 or not all(_WARP[0] <= c <= _WARP[1] for c in self.warp):
            raise InputError(
                f"runtime table: expected two warp constants within {_WARP[0]}…{_WARP[1]:g}, got "
                f"{list(self.warp)}"
            )

    @property
    def nodes(self) -> int:
        """How many nodes there are."""
        return self.shape[0] * self.shape[1] * self.shape[2]


def read(values: Tensor, warp: tuple[float, float], n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
    """f_r of unit vectors (zero where invalid), 0 unless both L and V are above the horizon.

    Args:
        values: `[U, V, W, C]` in 1/sr.
        n, l, v: `[..., 3, H, W]` of the dtype of `values`.

    Returns:
        `[..., C, H, W]` in 1/sr.
    """
    *at, above = address(warp, n, l, v)
    f = read_at(values, *at)
    return torch.where(above, f, torch.zeros_like(f))


def address(
    warp: tuple[float, float],
    n: Tensor,
    l: Tensor,  # noqa: E741
    v: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """u, v, w of unit vectors, each `[..., 1, H, W]`, and where both L and V are above the horizon.

    Finite, and so is the gradient. Below the horizon u, v and w mean nothing.
    """
    n_l, n_v = geometry.dot(n, l), geometry.dot(n, v)
    above = (n_l > 0) & (n_v > 0)
    d = v - l
    square = geometry.dot(d, d)
    apart = square > (4 * torch.finfo(n.dtype).eps) ** 2
    delta = torch.sqrt(torch.where(apart, square, torch.ones_like(square)))
    sine = geometry.length(geometry.cross(n, l))
    middle = n_l + n_v
    # unit vectors are so to a few roundings: what d has along L + V is not the angle between them
    radial = geometry.dot(d, l + v)
    y = torch.where(apart, geometry.dot(n, d) - radial * middle / 4, sine)
    z = geometry.dot(n, geometry.cross(l, d))
    z = torch.where(apart, z, torch.zeros_like(z))
    tiny = torch.finfo(n.dtype).tiny ** 0.5
    opposite = torch.sqrt((4 - square).clamp(min=tiny))
    u = torch.where(apart, delta / (2 + opposite), torch.zeros_like(delta))
    least = torch.minimum(n_l, n_v).clamp(min=0)
    across = y / (y.abs() + warp[0] * delta * least).clamp(min=_LEAST)
    along = z / (z.abs() + warp[1] / 2 * delta * middle.clamp(min=0)).clamp(min=_LEAST)
    return u, across, along, above


def node_angles(
    layout: RuntimeLayout, device: torch.device | str = "cpu"
) -> tuple[Tensor, Tensor, Tensor]:
    """Incidence, receiving and tilt of the nodes, `[U, V, W]` in radians and float64."""
    u, v, w = (
        torch.linspace(low, 1, count, dtype=torch.float64, device=device)
        for low, count in zip((0.0, -1.0, -1.0), layout.shape, strict=True)
    )
    return angles_of(layout.warp, u[:, None, None], v[:, None], w)


def angles_of(
    warp: tuple[float, float], u: Tensor, v: Tensor, w: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The angles at addresses: the inverse of `address`.

    Args:
        u, v, w: broadcastable, in 0…1, −1…1 and −1…1.

    Returns:
        incidence, receiving and tilt in radians, broadcast.
    """
    u, v, w = torch.broadcast_tensors(u, v, w)
    half = 2 * torch.atan(u)
    # with x = 1: y = ρ m and m = cos α − |y| sin α; the ends, where ρ and z are infinite, are near
    near = 1 - 1e-9
    rho, z = (
        c * s.clamp(-near, near) / (1 - s.abs().clamp(max=near))
        for c, s in zip(warp, (v, w), strict=True)
    )
    y = rho * half.cos() / (1 + rho.abs() * half.sin())
    across = torch.atan(y)
    tilt = torch.atan(z * across.cos())
    incidence, receiving = half + across, half - across
    flip = torch.where(incidence < 0, -torch.ones_like(half), torch.ones_like(half))
    return incidence * flip, receiving * flip, tilt * flip


def address_of_angles(
    warp: tuple[float, float], incidence: Tensor, receiving: Tensor, tilt: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """u, v and w at angles in radians, of one shape: the inverse of `angles_of`."""
    half, across = (incidence + receiving) / 2, (incidence - receiving) / 2
    # L and V change sides where a + r < 0: the angles from before the flip
    flip = torch.where(half < 0, -torch.ones_like(half), torch.ones_like(half))
    half, across, tilt = half * flip, across * flip, tilt * flip
    x, y, z = tilt.cos() * across.cos(), tilt.cos() * across.sin(), tilt.sin()
    least = (x * half.cos() - y.abs() * half.sin()).clamp(min=0)
    v = y / (y.abs() + warp[0] * least).clamp(min=_LEAST)
    w = z / (z.abs() + warp[1] * x.clamp(min=0)).clamp(min=_LEAST)
    return torch.tan(half / 2), v, w


def read_at(values: Tensor, u: Tensor, v: Tensor, w: Tensor) -> Tensor:
    """The table `[U, V, W, C]` at addresses `[..., 1, H, W]` → `[..., C, H, W]`."""
    positions = (
        (x * (count - 1)).clamp(0, count - 1)
        for x, count in zip((u, (v + 1) / 2, (w + 1) / 2), values.shape, strict=False)
    )
    return trilinear(values, *positions)
