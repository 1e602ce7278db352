"""Polished materials under an environment: against a quadrature over half vectors.

Rationale: a lobe may be narrower than a texel, so texels taken as points are no reference. Here the
map is read bilinearly between the middles of its texels, at directions that are finest about the
normal: l = 2 (v·h) h − v, dω_l = 4 (v·h) dω_h. Twice as many change nothing.
"""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

import raden_torch as rt
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.brdf.shading.environment import EnvironmentLight


def room(height: int) -> Tensor:
    """Dim, with a window and a lamp of one texel."""
    generator = torch.Generator().manual_seed(3)
    radiance = 0.1 + 0.1 * torch.rand(3, height, 2 * height, generator=generator)
    radiance[:, height // 4 : height // 2, : height // 4] += 4.0
    radiance[0, height // 3, height // 2] += 50.0
    return radiance


def between_texels(radiance: Tensor, light: Tensor) -> Tensor:
    """`[3, P, J]` at unit directions `[3, P, J]`; beyond a pole goes on on the other side."""
    height, width = radiance.shape[1:]
    x, y, z = light.double()
    row = torch.acos(y.clamp(-1, 1)) * (height / math.pi) + 0.5
    column = (torch.atan2(x, -z) / (2 * math.pi) + 0.5) * width - 0.5
    over = radiance.roll(width // 2, 2)
    tall = torch.cat([over[:, :1], radiance, over[:, -1:]], 1).double()
    i, j = row.floor().long().clamp(0, height), column.floor().long()
    down, along = row - i, column - j
    first, second = (
        torch.lerp(tall[:, k, j % width], tall[:, k, (j + 1) % width], along) for k in (i, i + 1)
    )
    return torch.lerp(first, second, down)


def quadrature(material, normal: Tensor, view: Tensor, radiance: Tensor, rows: int) -> Tensor:
    """`[3, P]` radiance at unit normals and views `[3, P]`."""
    alpha = material.roughness
    scale = math.asinh(math.pi / 2 / alpha)
    s = (torch.arange(rows, dtype=torch.float64) + 0.5) / rows
    polar = (alpha * torch.sinh(s * scale))[:, None]
    turn = (torch.arange(2 * rows, dtype=torch.float64) + 0.5) * (math.pi / rows)
    share = polar.sin() * (alpha * torch.cosh(s * scale) * scale / rows)[:, None] * (math.pi / rows)
    local = torch.stack(
        [polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos() + 0 * turn]
    )
    n, v = normal.double(), view.double()
    least = torch.zeros_like(n).scatter(0, n.abs().argmin(0, keepdim=True), 1.0)
    x = normalize(torch.linalg.cross(n, least, dim=0), dim=0)
    axes = torch.stack([x, torch.linalg.cross(n, x, dim=0), n])
    half = torch.einsum("aj,acp->cpj", local.flatten(1), axes)
    v_h = (v[..., None] * half).sum(0)
    light = 2 * v_h * half - v[..., None]
    cosine = (light * n[..., None]).sum(0).clamp(min=0)
    weight = (share + 0 * turn).flatten() * 4 * v_h.clamp(min=0) * cosine
    maps = (m.float()[None] for m in (n[..., None], light, v[..., None]))
    f = material.of_unit_vectors(*maps)[0]
    return (f * weight * between_texels(radiance, light)).sum(-1)


def pixels(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Normals and views `[3, P]` with N·V evenly from 0.03 to 1, mirroring all parts of the map."""
    generator = torch.Generator().manual_seed(seed)
    view = normalize(torch.randn(3, count, generator=generator), dim=0)
    side = torch.randn(3, count, generator=generator)
    side = normalize(side - (side * view).sum(0) * view, dim=0)
    cosine = torch.linspace(0.03, 1, count)
    return cosine * view + (1 - cosine**2).clamp(min=0).sqrt() * side, view


@pytest.mark.parametrize("roughness", [0.05, 0.1])
def test_polished_urushi_mirrors_a_coarse_map(roughness: float) -> None:
    """Expected: within 1.5 % of the brightest pixel, RMS 0.3 %, to the rim."""
    material, radiance = black_urushi(roughness), room(48)
    normal, view = pixels(48)
    truth = quadrature(material, normal, view, radiance, 64)
    finer = quadrature(material, normal[:, ::6], view[:, ::6], radiance, 128)
    peak = truth.max()
    assert ((finer - truth[:, ::6]).abs() / peak).max() < 2e-3
    maps = (m[None, :, None] for m in (normal, view))
    with torch.no_grad():
        image = rt.shade(material, rt.GBuffer(*maps), EnvironmentLight(radiance))[0, :, 0]
    error = (image - truth) / peak
    assert error.abs().max() < 0.015
    assert error.square().mean().sqrt() < 0.003
