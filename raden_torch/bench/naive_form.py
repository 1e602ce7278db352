"""The model as one writes it first, which run times are compared with."""

from __future__ import annotations

import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.model.model import RadenBrdf


def naive(model: RadenBrdf, normal: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """The model as one writes it first: asin, atan2 and a 5-D grid_sample of the plain table.

    Differentiable; outside the table's box the diffuse part alone, without a fade.
    """
    table, diffuse = model.table, model.diffuse
    assert table is not None and diffuse is not None  # noqa: PT018
    volume = table.values.permute(3, 0, 1, 2)[None]
    first = torch.tensor(table.first_deg)
    span = torch.tensor(table.last_deg) - first
    scale, exponent = (p.view(1, 3, 1, 1) for p in (diffuse.scale, diffuse.exponent))
    unit = torch.nn.functional.normalize
    n, l, v = (unit(m, dim=1) for m in (normal, light, view))  # noqa: E741
    p = unit(torch.linalg.cross(l, v, dim=1), dim=1)
    projected = unit(n - geometry.dot(n, p) * p, dim=1)
    across = torch.linalg.cross(p, projected, dim=1)
    a = torch.atan2(-geometry.dot(l, across), geometry.dot(l, projected))
    r = torch.atan2(geometry.dot(v, across), geometry.dot(v, projected))
    t = torch.asin(geometry.dot(n, p).clamp(-1, 1))
    flip = torch.where(a < 0, -1.0, 1.0)
    a, r, t = a * flip, r * flip, t * flip
    at = torch.rad2deg(torch.cat([a, r, t], dim=1)) - first.view(1, 3, 1, 1)
    grid = (2 * at / span.view(1, 3, 1, 1) - 1).permute(0, 2, 3, 1).flip(-1)[:, None]
    specular = torch.nn.functional.grid_sample(
        volume, grid, align_corners=True, padding_mode="border"
    )[:, :, 0]
    body = scale * t.cos() * r.cos() * (1 - a.cos()).clamp(min=1e-12) ** exponent
    inside = (grid.abs() <= 1).all(dim=-1)
    f = torch.where(inside, specular, body)
    return torch.where((geometry.dot(n, l) > 0) & (geometry.dot(n, v) > 0), f, 0.0)
