"""The model's formulas on single components: fastest in runtimes that do not fuse operators.

ONNX Runtime and its like run a graph an operator at a time, each a pass over memory. What is cheap
there is elementwise arithmetic on maps of one size; reductions over x, y, z, `Where`, and every
`Gather` cost ten to thirty times as much. So x, y and z are planes of their own, choices are sums
with factors 0 and 1, and the eight neighbours in the table are fetched by two gathers.

The formulas are those of `geometry`, `brdf.diffuse` and `brdf.table`; every export is checked
against them. Pixels without a valid geometry come out as NaN here; `shaders` makes them 0.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.errors import InputError
from raden_torch.geometry import XYZ_DIM

Vector = tuple[Tensor, Tensor, Tensor]
"""x, y, z, each `[..., 1, H, W]`."""

_EPS = torch.finfo(torch.float32).eps
_LEAST_SINE = 1e-15
"""Keeps a division by |L × V| finite; far below what counts as apart."""
_MOST_NODES = 2**24
"""Of a table: as far as float32 counts."""
_CODE = 256
"""Two small numbers in one float: `first · _CODE + second`, so that one gather brings both."""


def unit(vectors: Tensor) -> Vector:
    """`geometry.normalised` of `[..., 3, H, W]`; NaN where a vector is zero or not finite."""
    v = xyz(vectors)
    largest = torch.maximum(torch.maximum(v[0].abs(), v[1].abs()), v[2].abs())
    x, y, z = (c / largest for c in v)
    length = torch.sqrt(x * x + y * y + z * z) * largest
    beyond = length - 1
    is_unit = (beyond.abs() < 8 * _EPS).float()
    length = length - is_unit * beyond  # exactly 1 where it is unit already
    return v[0] / length, v[1] / length, v[2] / length


def xyz(vectors: Tensor) -> Vector:
    """The three planes of `[..., 3, H, W]`."""
    x, y, z = vectors.split(1, XYZ_DIM)
    return x, y, z


def dot(a: Vector, b: Vector) -> Tensor:
    """a·b, `[..., 1, H, W]`."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class PlanarBrdf(nn.Module):
    """A `RadenBrdf` over planes. Its parameters have the names that they have in the model."""

    def __init__(self, model: RadenBrdf) -> None:
        super().__init__()
        self.diffuse = model.diffuse
        self.table = model.table
        self.diffuse_gain = model.diffuse_gain
        self.specular_gain = model.specular_gain
        if model.table is not None:
            self.lookup = Lookup(model.table)

    def forward(self, n: Vector, l: Vector, v: Vector) -> tuple[Tensor, Tensor]:  # noqa: E741
        """f_r, and the cosine that light falls in at.

        Args:
            n, l, v: unit vectors, from `unit`.

        Returns:
            f_r `[..., 3, H, W]` in 1/sr, 0 below the horizon; N·L `[..., 1, H, W]`. Either may be
            NaN where a vector is invalid.
        """
        n_l, n_v, half_angles = _half_angles(n, l, v)
        above = (torch.minimum(n_l, n_v) > 0).float()
        diffuse_share = self.diffuse_gain * above
        if self.table is None:
            return self._diffuse(n_v, half_angles[0]) * diffuse_share, n_l
        a, r, t = (torch.atan(u) for u in half_angles)
        flip = 1 - 2 * (a < 0).float()  # a ≥ 0: (a, r, t) → (−a, −r, −t)
        total, weight = self.lookup(self.table.values, a.abs(), r * flip, t * flip)
        share = self.specular_gain * weight * above
        f = total * share
        if self.diffuse is not None:
            f = f + self._diffuse(n_v, half_angles[0]) * (diffuse_share - share)
        return f, n_l

    def _diffuse(self, n_v: Tensor, half_incidence: Tensor) -> Tensor:
        """S cos θr (1 − cos a)^n, eqs (3)–(6): cos t cos r is cos θr, 1 − cos a is 2u²/(1 + u²)."""
        if self.diffuse is None:
            return torch.zeros_like(n_v).expand(*n_v.shape[:XYZ_DIM], 3, *n_v.shape[-2:])
        square = half_incidence * half_incidence
        logarithm = torch.log(2 * square / (1 + square))
        power = torch.exp(self.diffuse.exponent.view(-1, 1, 1) * logarithm)
        return power * n_v * self.diffuse.scale.view(-1, 1, 1)


def _half_angles(n: Vector, l: Vector, v: Vector) -> tuple[Tensor, Tensor, Vector]:  # noqa: E741
    """N·L, N·V, and the tangents of half of a, r, t before the flip; see `geometry`.

    With d the short diagonal from ±L to V, |L × V|² is d² − (d·L)², which loses nothing: d² ≤ 2.
    """
    facing = 1 - 2 * (dot(l, v) < 0).float()
    k = l[0] * facing, l[1] * facing, l[2] * facing  # L, or −L where L and V are far apart
    d = v[0] - k[0], v[1] - k[1], v[2] - k[2]
    square = dot(d, d)
    n_k, n_v, n_d, d_k = dot(n, k), dot(n, v), dot(n, d), dot(d, k)
    d_v = d_k + square

    # L ∥ V: the diagonal N − L takes d's place, all of whose products follow from its length e
    parallel = (square < (4 * _EPS) ** 2).float()
    e = n[0] - k[0], n[1] - k[1], n[2] - k[2]
    e_square = dot(e, e) * parallel
    half = 0.5 * e_square
    n_d, d_k, d_v = n_d + half, d_k - half, d_v - half
    # a clamp: the exporter's optimiser drops the addition of anything below 1e-8
    s = torch.sqrt(square + e_square - d_k * d_k).clamp(min=_LEAST_SINE)

    out_of_plane = (
        n[0] * (k[1] * d[2] - k[2] * d[1])
        + n[1] * (k[2] * d[0] - k[0] * d[2])
        + n[2] * (k[0] * d[1] - k[1] * d[0])
    )
    n_l = n_k * facing
    across_l = (n_d - d_k * n_k) / s
    across_v = (n_d - d_v * n_v) / s * facing
    height = torch.sqrt(n_l * n_l + across_l * across_l)
    sine = out_of_plane / s * (facing - parallel)
    half_angles = across_l / (height + n_l), -across_v / (height + n_v), sine / (1 + height)
    return n_l, n_v, half_angles


class Lookup(nn.Module):
    """The table of a model, its neighbours packed into rows."""

    def __init__(self, table: ReflectanceTable) -> None:
        super().__init__()
        nodes = table.values.shape[:3]
        if math.prod(nodes) > _MOST_NODES:
            raise InputError(f"table: expected at most {_MOST_NODES} nodes, got {math.prod(nodes)}")
        self.first_deg, self.step_deg, self.cells = table.first_deg, table.step_deg, table.cells
        self.baked = table.pieces is not None
        for axis, cuts in enumerate(table.cuts):
            start, pieces = cuts[:, 0], cuts[:, 1]
            if pieces.max() >= _CODE:
                raise InputError(
                    f"table: expected a cell in fewer than {_CODE} pieces, got {int(pieces.max())}"
                )
            self.register_buffer(f"_codes_{axis}", start * _CODE + pieces, persistent=False)

    def forward(self, values: Tensor, *half_angles: Tensor) -> tuple[Tensor, Tensor]:
        """As `ReflectanceTable.forward`, of the halves of incidence, receiving and tilt."""
        inside, weight = [], None
        for half, first, step, n in zip(
            half_angles, self.first_deg, self.step_deg, self.cells, strict=True
        ):
            x = half * (2 * math.degrees(1) / step) - first / step
            within = x.clamp(0, n)
            fading = torch.relu(1 - (x - within).abs())
            weight = fading if weight is None else weight * fading
            inside.append(within)
        assert weight is not None
        if self.baked:
            a, r, t = inside
            inside = [self._cut(k, x) for k, x in enumerate((a, r - a + self.cells[0], t))]
        return _packed_trilinear(values, inside), weight

    def _cut(self, axis: int, x: Tensor) -> Tensor:
        """Measured cells → nodes, as in `ReflectanceTable`."""
        codes = getattr(self, f"_codes_{axis}")
        last = len(codes) - 1
        cell = x.floor().clamp(0, last)
        code = codes[_index(cell, last)]
        start = torch.floor(code * (1 / _CODE))
        return start + (x - cell) * (code - start * _CODE)


def _packed_trilinear(values: Tensor, position: list[Tensor]) -> Tensor:
    """`table.trilinear`, in two gathers.

    Each row holds, for the square of four neighbours along y and z, the coefficients of
    (d z + c) y + (b z + a), so that the sums are short.
    """
    nx, ny, nz, channels = values.shape
    low = [p.floor().clamp(0, n - 2) for p, n in zip(position, (nx, ny, nz), strict=True)]
    x, y, z = (p - i for p, i in zip(position, low, strict=True))
    rows = _packed(values)
    first = _index((low[0] * ny + low[1]) * nz + low[2], (nx * ny - 2) * nz - ny * nz + nz - 2)
    near, far = (_planes(rows[index]) for index in (first, first + ny * nz))
    square = near + x * (far - near)
    with_z, without_z = square.split(2 * channels, XYZ_DIM)
    with_y, without_y = (z * with_z + without_z).split(channels, XYZ_DIM)
    return y * with_y + without_y


def _packed(values: Tensor) -> Tensor:
    """`[X, Y, Z, C]` → `[nodes, 4 C]`: d, b, c, a of `_packed_trilinear`.

    A runtime does this at every call, or once where the table is a constant.
    """
    nz, channels = values.shape[2:]
    nodes = values.reshape(-1, channels).t()  # joined in long runs, then turned
    count = nodes.shape[1] - nz - 1
    a, beyond_y = nodes[:, :count], nodes[:, nz : nz + count]
    b = nodes[:, 1 : count + 1] - a
    c = beyond_y - a
    d = nodes[:, nz + 1 :] - beyond_y - b
    return torch.cat([d, b, c, a]).t()


def _planes(rows: Tensor) -> Tensor:
    """`[..., 1, H, W, C]` → `[..., C, H, W]`."""
    return rows.squeeze(-4).movedim(-1, XYZ_DIM)


def _index(position: Tensor, last: int) -> Tensor:
    """int32 within the table, whatever NaN becomes."""
    return position.to(torch.int32).clamp(0, last)
