"""The runtime form once more, for programs that run a graph an operator at a time.

There each operator is a pass over memory. What is cheap is arithmetic on maps of one size; a sum
over x, y, z as one operator costs five times as much, a choice for each channel three times. So x,
y, z are planes of their own, all choices are made once a pixel, what is invalid is NaN until the
end, and two gathers bring all eight neighbours in the table.

The formulas are those of `brdf.model.runtime_table`, which every export is checked against. All but
the cosine are homogeneous in N, so only L and V are made unit vectors.
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


def scaled(vectors: Tensor) -> tuple[Tensor, Tensor]:
    """`[..., 3, H, W]` over its largest component, which keeps squares in range; and that."""
    x, y, z = xyz(vectors.abs())
    largest = torch.maximum(torch.maximum(x, y), z)
    return vectors / largest, largest


def unit(vectors: Tensor) -> Tensor:
    """`geometry.normalised` of `[..., 3, H, W]`; NaN where a vector is zero or not finite."""
    v, largest = scaled(vectors)
    found = length(v) * largest
    is_unit = found.clamp(1 - 7.5 * _EPS, 1 + 7.5 * _EPS) == found
    return vectors / torch.where(is_unit, torch.ones(()), found)


def xyz(vectors: Tensor) -> tuple[Tensor, ...]:
    """The three planes of `[..., 3, H, W]`."""
    x, y, z = vectors.split(1, XYZ_DIM)
    return x, y, z


def dot(a: Tensor, b: Tensor) -> Tensor:
    """a·b, `[..., 1, H, W]`."""
    x, y, z = xyz(a * b)
    return x + y + z


def length(v: Tensor) -> Tensor:
    """|v|, `[..., 1, H, W]`."""
    return torch.sqrt(dot(v, v))


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
    """A `RuntimeForm` of vectors of any length."""

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
    (n, _), l, v = scaled(normal), unit(light), unit(view)  # noqa: E741
    d, p_zxy = v - l, n * yzx(l) - yzx(n) * l  # p = N × L
    n_l, n_v, square = dot(n, l), dot(n, v), dot(d, d)
    least, quarter = torch.minimum(n_l, n_v), (n_l + n_v) * 0.25
    # what d has along L + V is rounding: N without its part along L + V does not see it
    across_n = n - (l + v) * quarter
    # L ∥ V: the plane of L and N is taken, and `across_n` for d, which need not be short in it
    parallel = square <= (4 * _EPS) ** 2
    y, z = dot(across_n, torch.where(parallel, across_n, d)), dot(p_zxy, zxy(d))
    span = torch.sqrt(torch.where(parallel, y.clamp(min=_LEAST_SQUARE), square))
    u = torch.sqrt(square) / (2 + torch.sqrt(torch.relu(4 - square)))
    shows = span * least  # not the lesser alone: some runtimes lose NaN there
    across = y / (y.abs() + shows * c)
    along = z / (z.abs() + span * quarter * (2 * k))
    return u, across, along, n_l / length(n), shows


def read(table: Tensor, u: Tensor, v: Tensor, w: Tensor) -> Tensor:
    """`runtime_table.read_at`, in two gathers: four neighbours each, as a polynomial in v and w."""
    nu, nv, nw, _ = table.shape
    middle_v, middle_w = (nv - 1) // 2, (nw - 1) // 2
    x, y, z = u * (nu - 1), _from_middle(v, nv), _from_middle(w, nw)
    i, j, k = x.floor(), y.floor(), z.floor()
    rows = packed(table)
    # nothing that `trace` joins: OpenCV corrupts memory in a `Sum` of maps of several sizes
    node = (middle_v * nw + middle_w) + ((i * nv + j) * nw + k)
    last = len(rows) - 1 - nv * nw
    first = node.squeeze(XYZ_DIM).to(torch.int32).clamp(0, last)  # whatever NaN becomes
    near, far = (rows[at].movedim(-1, XYZ_DIM) for at in (first, first + nv * nw))
    return interpolated(near, far, (x - i, y - j, z - k))


def interpolated(near: Tensor, far: Tensor, place: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    """f of two packed rows `[..., 12, H, W]` at a place in the cell, along u, v and w."""
    x, *others = place
    f = near + x * (far - near)
    for along, size in zip(others, (2, 1), strict=True):
        slope, start = f.split(size * 3, XYZ_DIM)
        f = along * slope + start
    return f


def _from_middle(address: Tensor, count: int) -> Tensor:
    """−1…1 → nodes from the middle one, or the one before the middle."""
    position = address * ((count - 1) / 2)
    return position if count % 2 else position + 0.5


def packed(table: Tensor) -> Tensor:
    """`[U, V, W, C]` → `[nodes, 4 C]`: at each node the coefficients of y z, y, z and 1.

    A runtime does this at every call, or once where the table is a constant.
    """
    nw, channels = table.shape[2:]
    nodes = table.reshape(-1, channels)
    count = len(nodes) - nw - 1
    square = torch.cat([nodes[i : i + count] for i in (nw + 1, nw, 1, 0)], 1)
    return square @ _COEFFICIENTS.kron(torch.eye(channels))
