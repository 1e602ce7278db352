"""A relit object under each of several lamps, side by side in rows, each with its lamp's place."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from raden_torch.brdf.files.display import auto_exposure_ev
from raden_torch.brdf.shading.lights import DirectionalLight
from raden_torch.brdf.shading.relight import tiled

_MARGIN = 0.06
"""Of the object's size, around it."""
_EXPOSED_FOR = 0.95
"""The share of the relit pixels that is shown without clipping: sparkles may clip."""


def contact_sheet(
    tiles: Tensor, mask: Tensor, lamps: Sequence[DirectionalLight], *, exposed: bool
) -> Tensor:
    """`[1, 3, …]`: the tiles cut to the mask, in rows, with dials, exposed together."""
    rows, columns = (m.flatten() for m in torch.nonzero(mask[0, 0] > 0, as_tuple=True))
    margin = max(4, int(_MARGIN * max(rows.max() - rows.min(), columns.max() - columns.min())))
    top, bottom = int(rows.min()) - margin, int(rows.max()) + margin + 1
    left, right = int(columns.min()) - margin, int(columns.max()) + margin + 1
    window = (..., slice(max(top, 0), bottom), slice(max(left, 0), right))
    cut, inside = tiles[window], (mask[window] > 0.5).to(tiles.dtype)
    if exposed:
        cut = cut * 2.0 ** auto_exposure_ev((cut * inside)[:, 0], share=_EXPOSED_FOR)
    for tile, lamp in zip(cut, lamps, strict=True):
        _draw_dial(tile[0], lamp)
    height, width = cut.shape[-2:]
    # as near to a 3:2 picture as whole rows allow
    wanted = max(1, round((1.5 * len(lamps) * height / width) ** 0.5))
    fits = [n for n in range(1, len(lamps) + 1) if len(lamps) % n == 0] or [wanted]
    return tiled(cut, min(fits, key=lambda n: abs(n - wanted)))


def _draw_dial(tile: Tensor, lamp: DirectionalLight) -> None:
    """A disc in the lower right corner of `[3, H, W]`: the hemisphere, a dot where the lamp is."""
    height, width = tile.shape[-2:]
    r = max(5.0, 0.05 * min(height, width))
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x, y = x - (width - 1 - 1.6 * r), (height - 1 - 1.6 * r) - y
    direction = torch.as_tensor(lamp.direction, dtype=torch.float64)
    dx, dy, _ = (direction / direction.norm() * r).tolist()
    away = torch.hypot(x.double(), y.double())
    rim = (1 - (away - r).abs()).clamp(0, 1)
    dot = (0.28 * r + 1 - torch.hypot(x - dx, y - dy)).clamp(0, 1)
    for value, cover in ((0.0, (away < r).double() * 0.6), (0.35, rim), (0.9, dot)):
        tile += cover.to(tile.dtype) * (value - tile)
