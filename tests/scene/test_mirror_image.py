"""A box in a polished table, against Fresnel's formula and the width of the polish's lobe."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from raden_torch.artwork.box import Box
from raden_torch.brdf.materials.urushi import URUSHI_INDEX
from raden_torch.scene.camera import Camera, View
from raden_torch.scene.mirror_image import MirrorImage
from raden_torch.scene.polish import WIDTH
from raden_torch.scene.scene import Scene

Writer = Callable[..., Path]
WHITE = (
    'artwork = "none"\nground = "white"\ntable = [0.0, 0.0, 0.0]\ntable_roughness = {}\n'
    '[[materials]]\nname = "white"\nalbedo = [0.8, 0.8, 0.8]\n'
)
LAMP = "[[lights.directional]]\ndirection = [0.0, 0.0, 1.0]\n"
SIZE = (96, 54)


def fresnel(cosine: Tensor) -> Tensor:
    """What a smooth face of urushi reflects of unpolarised light."""
    inside = (1 - (1 - cosine**2) / URUSHI_INDEX**2).sqrt()
    across = (cosine - URUSHI_INDEX * inside) / (cosine + URUSHI_INDEX * inside)
    along = (URUSHI_INDEX * cosine - inside) / (URUSHI_INDEX * cosine + inside)
    return (across**2 + along**2) / 2


def white_box(scene_file: Writer, roughness: float) -> Scene:
    """A white box under one lamp that shines on its front alone, on a black polished table."""
    changes = (
        ('artwork = "none"', WHITE.format(roughness)),
        ('[lights.environment]\nbuiltin = "room"\n', LAMP),
        ("position = [1.5, 3.7, 5.6]", "position = [0.0, 2.0, 5.0]"),
        ("target = [0.05, 0.36, 0.0]", "target = [0.0, 0.2, 1.0]\nfov_deg = 50.0"),
    )
    return Scene.read(scene_file(*changes))


def test_the_table_shows_the_front_times_fresnel(scene_file: Writer) -> None:
    image = white_box(scene_file, 0.002).frame()[0].flatten(1)
    camera = Camera((0.0, 2.0, 5.0), (0.0, 0.2, 1.0), 50.0, SIZE)
    pixel = torch.arange(SIZE[0] * SIZE[1])
    rays = camera.rays(pixel % SIZE[0] + 0.5, pixel // SIZE[0] + 0.5)
    down = rays[1] < 0
    at = camera.eye()[:, None] - rays * (2.0 / rays[1])
    # mirrored, the ray meets the plane of the front, z = 1, at this height
    to_front = (1.0 - at[2]) / rays[2]
    x, height = at[0] + to_front * rays[0], -to_front * rays[1]
    front = down & (at[2] > 1.02) & (x.abs() < 1.2) & (height > 0.12) & (height < 0.6)
    assert int(front.sum()) > 100
    cosine = (-rays[1] / rays.norm(dim=0))[front]
    expected = (0.8 * fresnel(cosine)).expand(3, -1)
    torch.testing.assert_close(image[:, front], expected, rtol=0.03, atol=0)
    above = down & (at[2] > 1.02) & (height > 0.9)
    assert int(above.sum()) > 100
    assert float(image[:, above].abs().max()) < 1e-4


def test_the_image_dissolves_with_its_distance(scene_file: Writer) -> None:
    """The upper edge is as wide as the lobe that the polish has, seen from the camera."""
    roughness = 0.03
    box, size = Box((4.0, 1.0, 1.0), rounding=0.02), (240, 240)
    camera = Camera((0.0, 2.0, 5.0), (0.0, 0.0, 2.2), 33.0, size)
    view = View(camera, 1, 2 * float(torch.tan(torch.deg2rad(torch.tensor(16.5)))) / size[0])
    scene = white_box(scene_file, roughness)
    pixel = torch.arange(size[0] * size[1])
    shown = pixel[
        box.cast(camera.eye(), camera.rays(pixel % 240 + 0.5, pixel // 240 + 0.5)).part == 0
    ]
    image = MirrorImage(scene._dressing, box, view, roughness, shown)
    cover = image.at(pixel, [], None)[1].view(240, 240)[:, 120]
    # the edge at y = 1, z = 1, seen from the eye below the table
    row = int((cover > 0.5).nonzero().max())
    step = (cover[row - 60 : row + 60] - cover[row - 59 : row + 61]).clamp(min=0)
    place = torch.arange(120.0)
    middle = (step * place).sum() / step.sum()
    width = float(((step * (place - middle) ** 2).sum() / step.sum()).sqrt())
    to_edge = torch.tensor([2.0 + 1.0, 5.0 - 1.0]).norm()
    behind = float(to_edge) / 3.0  # of the way, the part beyond the table: 1 of 3 in height
    expected = WIDTH * roughness * behind / float(to_edge) / view.pixel
    assert width == pytest.approx(expected, rel=0.35)
