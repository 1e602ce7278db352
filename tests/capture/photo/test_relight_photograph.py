"""A photograph relit with its own texture kept, and the contact sheet."""

from __future__ import annotations

import math

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.shading.relight import lamp_ring, relight, relit_under, texture_of, tiled

N = 48


@pytest.fixture(scope="module")
def lambertian() -> rt.RadenBrdf:
    table = torch.full((10, 19, 19, 3), 1 / math.pi)
    return rt.RadenBrdf(None, ReflectanceTable(table, (0.0, -90.0, -90.0), (10.0, 10.0, 10.0)))


def ball() -> tuple[torch.Tensor, torch.Tensor]:
    x = (torch.arange(N) + 0.5) / N * 2 - 1
    y, x = torch.meshgrid(-x, x, indexing="ij")
    square = x * x + y * y
    mask = (square < 0.9)[None, None].float()
    return torch.stack([x, y, (1 - square).clamp(min=0).sqrt()])[None] * mask, mask


def test_the_texture_of_a_matt_photograph_is_its_albedo() -> None:
    normal, mask = ball()
    albedo = 0.3 + 0.6 * torch.rand(1, 3, N, N, generator=torch.Generator().manual_seed(0))
    direction = torch.nn.functional.normalize(torch.tensor([0.3, 0.4, 1.0]), dim=0)
    cosine = (normal * direction.view(1, 3, 1, 1)).sum(1, keepdim=True).clamp(min=0)
    texture = texture_of(albedo * cosine, normal, mask, [rt.DirectionalLight((0.3, 0.4, 1.0))])
    lit = ((cosine > 0.7) & (mask > 0)).expand_as(albedo)
    ratio = (texture / albedo)[lit]
    assert (ratio / ratio.median() - 1).abs().max() < 0.03
    dark = ((cosine == 0) & (mask > 0)).expand_as(albedo)
    assert torch.isfinite(texture).all()
    if dark.any():  # nothing is known there: the mean
        assert texture[dark].std() < 0.2


def test_relit_under_its_own_lamp_a_matt_photograph_stays(lambertian) -> None:
    """Rationale: relit/original is 1 where model, lamp and object are the same matt ones."""
    normal, mask = ball()
    albedo = 0.3 + 0.6 * torch.rand(1, 3, N, N, generator=torch.Generator().manual_seed(1))
    lamp = [rt.DirectionalLight((0.2, 0.1, 1.0))]
    direction = torch.nn.functional.normalize(torch.tensor([0.2, 0.1, 1.0]), dim=0)
    cosine = (normal * direction.view(1, 3, 1, 1)).sum(1, keepdim=True).clamp(min=0)
    photo = albedo * cosine
    kept = relight(lambertian, photo, normal, mask, lamp, original=lamp)
    bare = relight(lambertian, photo, normal, mask, lamp)
    lit = ((cosine > 0.5) & (mask > 0)).expand_as(photo)
    assert (kept / photo - 1)[lit].abs().max() < 0.05
    assert (bare / photo - 1)[lit].abs().max() > 0.3
    outside = (mask == 0).expand_as(photo)
    assert torch.equal(kept[outside], photo[outside])


def test_tiles_in_rows(lambertian) -> None:
    normal, mask = ball()
    photo = torch.full((1, 3, N, N), 0.1)
    images = relit_under(lambertian, photo, normal, mask, lamp_ring(5))
    sheet = tiled(images, 3)
    assert sheet.shape == (1, 3, 2 * N, 3 * N)
    assert torch.equal(sheet[..., N:, N : 2 * N], images[4])
    assert (sheet[..., N:, 2 * N :] == 0).all()
