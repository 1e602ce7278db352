"""The lacquered plate: its layers, its lacquer, and what its picture shows."""

from __future__ import annotations

import math

import pytest
import torch

import raden_torch as rt
from raden_torch.artwork.lacquer import Lacquer
from raden_torch.artwork.motif import inlay, pieces
from raden_torch.artwork.plate import plate, shade_plate
from raden_torch.errors import InputError


def test_layers_share_each_pixel() -> None:
    made = plate(96, samples=1)
    together = made.shell.mask + made.lacquer.mask
    assert together.min() >= 0
    assert together.max() <= 1 + 1e-6
    assert 0.4 < together.mean() < 0.9
    assert 0.1 < made.shell.mask.sum() / together.sum() < 0.5
    edges = (made.shell.mask > 0.01) & (made.shell.mask < 0.99)
    assert edges.float().mean() > 0.02  # anti-aliased
    for layer in (made.shell, made.lacquer):
        assert (layer.normal.norm(dim=1) - 1).abs().max() < 1e-5
        to_camera = torch.tensor(layer.camera).view(1, 3, 1, 1) - layer.position
        assert ((layer.normal * to_camera).sum(1)[layer.mask[:, 0] > 0] > 0).all()


def test_the_motif_lies_on_the_plate() -> None:
    n = 400
    x, y = torch.meshgrid(*[torch.linspace(-1, 1, n, dtype=torch.float64)] * 2, indexing="xy")
    union = torch.zeros_like(x, dtype=torch.bool)
    for piece in pieces():
        inside = piece.distance(x, y) > 0
        assert torch.hypot(x - piece.x, y - piece.y)[inside].max() <= piece.reach
        union |= inside
    maps = inlay(x, y, 2 / n)
    coverage, lean = maps.coverage[0], maps.layer_slope
    assert (coverage <= union.double() + 0.51).all()  # nothing but pieces, and half an edge
    gaps = (union.double() - coverage).mean()
    assert 0 < gaps < 0.06
    assert lean.abs().max() < math.tan(math.radians(25))


def test_wrong_plates_are_refused() -> None:
    with pytest.raises(InputError, match=r"expected z > 0.5, above the plate, got"):
        plate(32, (0, -3, 0.1))
    with pytest.raises(InputError, match="16384"):
        plate(20_000)


def test_the_colour_travels_over_the_plate_and_the_highlight_is_where_it_should_be() -> None:
    model = rt.fit(rt.simulate_specimen("yakogai"), interpolation="trilinear").model
    made = plate(128, samples=1)
    lamp = (-0.5, 1.0, 3.0)
    with torch.no_grad():
        image = shade_plate(model, made, [rt.PointLight(lamp)])
        gloss = rt.shade(Lacquer(base=(0.0, 0.0, 0.0)), made.lacquer, rt.PointLight(lamp))
    assert torch.isfinite(image).all()
    # the mirror image of the lamp in the (nearly flat) plate
    camera = made.lacquer.camera
    share = lamp[2] / (lamp[2] + camera[2])
    expected = [lamp[k] + share * (camera[k] - lamp[k]) for k in (0, 1)]
    peak = (gloss.mean(dim=1) * (made.lacquer.mask[:, 0] > 0.9)).flatten().argmax()
    x, y = (made.lacquer.position[0, k].flatten()[peak].item() for k in (0, 1))
    assert math.hypot(x - expected[0], y - expected[1]) < 0.25
    shell = image.movedim(1, -1)[made.shell.mask[:, 0] > 0.95]
    green_share = shell[:, 1] / shell.clamp(min=1e-6).sum(dim=1)
    assert green_share.quantile(0.95) - green_share.quantile(0.05) > 0.08
    assert (shell.sum(dim=1) > 0).all()  # no black holes
