"""A palette for programs that run a graph an operator at a time: one read, whatever the material.

All tables are packed into one; what differs between them (warps, nodes an axis, where they begin)
is a row of numbers a material, which each pixel gathers by its index. So the cost of an index does
not grow with the number of materials. Weights evaluate every material, as a dimension of its own.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from raden_torch.errors import InputError
from raden_torch.export.forms import PaletteForm, RuntimeForm
from raden_torch.export.runtime_graph import (
    address_parts,
    interpolated,
    packed,
)
from raden_torch.geometry import XYZ_DIM

_MOST_NODES = 1 << 24
"""Single precision counts no further."""


class PaletteGraph(nn.Module):
    """A `PaletteForm` of vectors of a length of 1e-18 to 1e18."""

    numbers: Tensor

    def __init__(self, form: PaletteForm) -> None:
        super().__init__()
        self.form = form
        members, starts = form.each, [0]
        for member in members:
            starts.append(starts[-1] + len(packed(member.table)))
        if starts[-1] >= _MOST_NODES:
            raise InputError(
                f"palette: expected fewer than {_MOST_NODES} nodes in all tables, got {starts[-1]}"
            )
        rows = [
            _numbers(member, start, end)
            for member, start, end in zip(members, starts[:-1], starts[1:], strict=True)
        ]
        # the row of no material: NaN marks what is invalid
        none = torch.full_like(rows[0], torch.nan)
        self.register_buffer("numbers", torch.stack([*rows, none]), persistent=False)
        for i, column in enumerate(torch.stack(rows).T):
            self.register_buffer(f"column_{i}", column.view(1, -1, 1, 1, 1), persistent=False)
        self.last = starts[-1] - 1

    def forward(
        self, normal: Tensor, light: Tensor, view: Tensor, material: Tensor
    ) -> tuple[Tensor, ...]:
        """f_r and what `RuntimeGraph` gives beside it.

        Args:
            material: `[..., 1, H, W]` indices, rounded; or `[B, K, H, W]` weights.
        """
        count = len(self.form.members)
        if self.form.by == "weights":
            n, l, v = (m.unsqueeze(1) for m in (normal, light, view))  # noqa: E741
            columns = (self.get_buffer(f"column_{i}") for i in range(self.numbers.shape[1]))
            f, cosine, shows = self._read(n, l, v, tuple(columns))
            mixed = (f * material.unsqueeze(2)).sum(1)
            return mixed, cosine.squeeze(1), shows.squeeze(1)
        nearest = (material + 0.5).floor()
        known = nearest.clamp(0, count - 1) == nearest  # NaN is none
        place = torch.where(known, nearest, torch.full((), float(count))).to(torch.int32)
        rows = self.numbers[place.squeeze(XYZ_DIM)].movedim(-1, XYZ_DIM)
        numbers = rows.split(1, XYZ_DIM)
        f, cosine, shows = self._read(normal, light, view, numbers)
        return f, cosine, shows + 0 * numbers[0]

    def _read(
        self, normal: Tensor, light: Tensor, view: Tensor, numbers: tuple[Tensor, ...]
    ) -> tuple[Tensor, ...]:
        c, k, along_u, half_v, odd_v, half_w, odd_w, nv, nw, base, last = numbers
        u, v, w, cosine, shows = address_parts(normal, light, view, c, k)
        x, y, z = u * along_u, v * half_v + odd_v, w * half_w + odd_w
        i, j, l = x.floor(), y.floor(), z.floor()  # noqa: E741
        node = torch.minimum(base + ((i * nv + j) * nw + l), last)
        first = node.squeeze(XYZ_DIM).to(torch.int32).clamp(0, self.last)  # whatever NaN becomes
        rows = torch.cat([packed(member.table) for member in self.form.each])
        return interpolated(rows[first], (x - i, y - j, z - l)), cosine, shows


def _numbers(member: RuntimeForm, start: int, end: int) -> Tensor:
    """What differs between tables, as `PaletteGraph._read` takes it."""
    nu, nv, nw, _ = member.table.shape
    c, k = member.warp
    middle = ((nv - 1) // 2) * nw + (nw - 1) // 2
    return torch.tensor(
        [
            *(c, k, nu - 1, (nv - 1) / 2, 0.5 * (nv % 2 == 0), (nw - 1) / 2, 0.5 * (nw % 2 == 0)),
            *(nv, nw, start + middle, end - 1),
        ]
    )
