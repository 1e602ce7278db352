"""The runtime form once more, for programs that run a graph an operator at a time.

There each operator is a pass over memory. What is cheap is arithmetic on maps of one size; a sum
over x, y, z as one operator costs five times as much, a choice for each channel three times. So x,
y, z are planes of their own, all choices are made once a pixel, what is invalid is NaN until the
end, and one gather brings all eight neighbours in the table.

The formulas are those of `brdf.model.runtime_table`, which every export is checked against. All but
the cosine are homogeneous in N, so only L and V are made unit vectors, and N as long as makes
N·(L + V) = 4. Then N·L = (4 − N·d)/2 and N·V = (4 + N·d)/2; n = N − (L + V) is across L + V where L
and V almost agree; and |N|² = n·n + d·d + 4.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from raden_torch.export.forms import RuntimeForm
from raden_torch.geometry import XYZ_DIM

_EPS = torch.finfo(torch.float32).eps
_LEAST_SQUARE = 1e-12
"""The least |d|² that is divided by where N, L and V are parallel."""
_COEFFICIENTS = torch.tensor(
    [[1.0, 0.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 1.0, 0.0], [1.0, -1.0, -1.0, 1.0]]
)
"""Of y z, y, z and 1 (columns), by the corners (1, 1), (1, 0), (0, 1) and (0, 0) of a cell."""


def unit(vectors: Tensor) -> Tensor:
    """`geometry.normalised` of `[..., 3, H, W]` of a length of 1e-18 to 1e18; NaN of any other."""
    square = dot(vectors, vectors)
    length = torch.sqrt(square)
    is_unit = length.clamp(1 - 7.5 * _EPS, 1 + 7.5 * _EPS) == length
    # not over the length: where the square overflows or vanishes, this is ∞/∞ or 0/0
    return vectors * torch.where(is_unit, torch.ones(()), length / square)


def xyz(vectors: Tensor) -> tuple[Tensor, ...]:
    """The three planes of `[..., 3, H, W]`."""
    x, y, z = vectors.split(1, XYZ_DIM)
    return x, y, z


def dot(a: Tensor, b: Tensor) -> Tensor:
    """a·b, `[..., 1, H, W]`."""
    x, y, z = xyz(a * b)
    return x + y + z


def yzx(vectors: Tensor) -> Tensor:
    """y, z and x of `[..., 3, H, W]`, in one operator."""
    return _components(vectors, [1, 2, 0])


def zxy(vectors: Tensor) -> Tensor:
    """z, x and y of `[..., 3, H, W]`, in one operator."""
    return _components(vectors, [2, 0, 1])


def _components(vectors: Tensor, order: list[int]) -> Tensor:
    axis = vectors.dim() + XYZ_DIM
    # int64 indices give silently wrong pictures in some browsers
    return vectors.index_select(axis, torch.tensor(order, dtype=torch.int32))


class RuntimeGraph(nn.Module):
    """A `RuntimeForm` of vectors of a length of 1e-18 to 1e18."""

    def __init__(self, form: RuntimeForm) -> None:
        super().__init__()
        self.form = form

    def forward(self, normal: Tensor, light: Tensor, view: Tensor) -> tuple[Tensor, ...]:
        """f_r, and where it counts.

        Returns:
            f_r `[..., 3, H, W]` in 1/sr, which means nothing unless both cosines are above 0; the
            cosine that light falls in at; the lesser cosine times some number above 0;
            `[..., 1, H, W]` each, the last two NaN where a vector is invalid.
        """
        u, v, w, cosine, shows = address_parts(normal, light, view, *self.form.warp)
        return read(self.form.table, u, v, w), cosine, shows


def address_parts(
    normal: Tensor, light: Tensor, view: Tensor, c: Tensor | float, k: Tensor | float
) -> tuple[Tensor, ...]:
    """u, v and w of the table's address, and the two that `RuntimeGraph` gives beside f_r.

    Args:
        c, k: the warp, one for all or a map.
    """
    l, v = unit(light), unit(view)  # noqa: E741
    d, both = v - l, l + v
    square = dot(d, d)
    # N of such a length that N·(L + V) = 4; what faces away becomes infinite or NaN
    n = normal / (torch.relu(dot(normal, both)) * 0.25)
    # what d has along L + V is rounding: N without its part along L + V does not see it
    across_n = n - both
    y, sine_square = dot(across_n, d), dot(across_n, across_n)
    z = dot(zxy(n), l * yzx(d) - yzx(l) * d)  # N·(L × V), the product in the order z, x, y
    twice_n_l, twice_n_v = 4 - y, 4 + y
    # L ∥ V: the plane of L and N is taken, and `across_n` for d, which is a rounding there
    parallel = torch.where(
        square <= (4 * _EPS) ** 2, sine_square.clamp(min=_LEAST_SQUARE), torch.zeros(())
    )
    span, y = torch.sqrt(square + parallel), y + parallel
    u = torch.sqrt(square) / (2 + torch.sqrt(torch.relu(4 - square)))
    # not the lesser alone: some runtimes lose NaN there
    shows = torch.minimum(twice_n_l, twice_n_v) * span
    across = y / (y.abs() + shows * (0.5 * c))
    along = z / (z.abs() + span * (2 * k))
    twice_length = torch.sqrt(4 + (sine_square + square)) * 2
    return u, across, along, twice_n_l / twice_length, shows


def read(table: Tensor, u: Tensor, v: Tensor, w: Tensor) -> Tensor:
    """`runtime_table.read_at`, in one gather: eight neighbours as a polynomial in u, v and w."""
    nu, nv, nw, _ = table.shape
    rows = packed(table)
    x, y, z = u * (nu - 1), _from_middle(v, nv), _from_middle(w, nw)
    i, j, k = x.floor(), y.floor(), z.floor()
    middle = (nv - 1) // 2 * nw + (nw - 1) // 2
    # nothing that `trace` joins: OpenCV corrupts memory in a `Sum` of maps of several sizes
    node = middle + ((i * nv + j) * nw + k)
    first = node.squeeze(XYZ_DIM).to(torch.int32).clamp(0, len(rows) - 1)  # whatever NaN becomes
    return interpolated(rows[first], (x - i, y - j, z - k))


def _from_middle(address: Tensor, count: int) -> Tensor:
    """−1…1 → nodes from the middle one, or the one before the middle."""
    position = address * ((count - 1) / 2)
    return position if count % 2 else position + 0.5


def interpolated(rows: Tensor, place: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """f `[..., C, H, W]` of packed rows `[..., H, W, C, 8]` at a place in the cell."""
    x, y, z = place
    of_yz = torch.cat([y * z, y, z, y.clamp(1, 1)], XYZ_DIM)
    monomials = torch.cat([of_yz, x * of_yz], XYZ_DIM)
    terms = rows.movedim(-3, -1) * monomials.transpose(-3, -2).unsqueeze(-3)
    return (torch.ones(1, 8) @ terms).squeeze(-2).transpose(-3, -2)


def packed(table: Tensor) -> Tensor:
    """`[U, V, W, C]` → `[nodes, C, 8]`: at each node the coefficients of y z, y, z and 1, and of x
    times these.

    A runtime does this at every call, or once where the table is a constant.
    """
    nv, nw, channels = table.shape[1:]
    nodes = table.reshape(-1, channels)
    count, slab = len(nodes) - nw - 1, nv * nw
    square = torch.cat([nodes[i : i + count] for i in (nw + 1, nw, 1, 0)], 1)
    cube = torch.cat([square[slab:], square[:-slab]], 1)
    of_x = torch.tensor([[0.0, 1.0], [1.0, -1.0]])
    each = of_x.kron(_COEFFICIENTS)[:, None, None] * torch.eye(channels)[:, :, None]
    return (cube @ each.reshape(8 * channels, -1)).reshape(-1, channels, 8)
