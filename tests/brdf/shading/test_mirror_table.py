"""The table over mirror directions and views: by the kernel as in torch; missing nodes."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from raden_torch import geometry
from raden_torch.brdf.model import simd
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.brdf.shading.mirror_table import MirrorTable, ViewGrid, nodes_read


def smooth(normal: Tensor, view: Tensor) -> Tensor:
    """`[N, 3]` radiance, a smooth function of both."""
    mirror = 2 * (normal * view).sum(1, keepdim=True) * normal - view
    return 1 + 0.3 * torch.sin(2 * mirror) + 0.1 * view


def frame(count: int, spread: float) -> tuple[Tensor, Tensor]:
    """Unit normals and views `[N, 3]` that see each other, also at the rim."""
    generator = torch.Generator().manual_seed(3)
    normal, view = torch.randn(2, 3, 4 * count, generator=generator)
    view = geometry.unit_columns(torch.tensor([0.2, 0.3, 1.0])[:, None] + spread * view.tanh())
    normal = geometry.unit_columns(normal)
    seen = ((normal * view).sum(0) > 0.01).nonzero()[:count, 0]
    return normal[:, seen].T, view[:, seen].T


@pytest.mark.parametrize("spread", [0.0, 0.3])
@pytest.mark.parametrize("level", simd.LEVELS)
def test_the_kernel_reads_it_as_torch_does(level: str, spread: float) -> None:
    normal, view = frame(1000, spread)
    grid = ViewGrid.over(view)
    assert grid is not None
    assert (grid.count == 1) == (spread == 0.0)
    table = MirrorTable.of(smooth, grid, nodes_read(grid, normal, view, 97))
    mask = torch.linspace(0, 1, 1000).view(1, 1, 1, -1)
    n, v = (m.T.reshape(1, 3, 1, -1) for m in (normal, view))
    with simd.using(level):
        by_view = table.read(GBuffer(2 * n, view=3 * v, mask=mask))
        by_place = table.read(GBuffer(n, position=-v, camera=(0.0, 0.0, 0.0), mask=mask))
    expected = (table.read_pixels(normal, view).T * mask[0, 0])[None, :, None]
    torch.testing.assert_close(by_view, expected, atol=3e-5, rtol=0)
    torch.testing.assert_close(by_place, expected, atol=3e-5, rtol=0)
    truth = smooth(normal, view)
    assert float((table.read_pixels(normal, view) - truth).abs().max()) < 0.02


@pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")
def test_what_is_missing_is_not_a_number() -> None:
    normal, view = frame(1000, 0.3)
    grid = ViewGrid.over(view)
    assert grid is not None
    used = nodes_read(grid, normal[:20], view[:20], 97)
    table = MirrorTable.of(smooth, grid, used, torch.nan)
    n, v = (m.T.reshape(1, 3, 1, -1) for m in (normal, view))
    image = table.read(GBuffer(n, view=v))[0, :, 0]
    missing = image.isnan().any(0)
    assert 100 < int(missing.sum()) < 1000
    error = (image.T - smooth(normal, view)).abs()[~missing]
    assert float(error.max()) < 0.02
