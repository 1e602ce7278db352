"""Scenes against what is known of them: analytic shapes, quadrature, and many samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.artwork.box import LID, NOTHING, TABLE, Box
from raden_torch.artwork.box_decoration import decorated
from raden_torch.artwork.room import SHOJI, Window, room
from raden_torch.brdf.materials.simulated_shell import SimulatedShell
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.brdf.shading.area_lights import RectangleLight
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.latlong import solid_angles
from raden_torch.colorimetry import XYZ_TO_SRGB
from raden_torch.errors import InputError
from raden_torch.geometry import vectors_from_angles
from raden_torch.images.exr import write_channels
from raden_torch.images.pixels import write_pixels
from raden_torch.scene.camera import Camera
from raden_torch.scene.polish import (
    MirroredSurroundings,
    mirrored,
    mirrored_rectangle,
    reflected_share,
)
from raden_torch.scene.samples import sampled
from raden_torch.scene.scene import Scene

Writer = Callable[..., Path]
EYE = torch.tensor([1.5, 3.7, 5.6])


def fan(count: int = 60) -> torch.Tensor:
    camera = Camera((1.5, 3.7, 5.6), (0.05, 0.36, 0.0), 40.0, (count, count))
    pixel = torch.arange(count * count)
    return camera.rays(pixel % count + 0.5, pixel // count + 0.5)


def test_rays_end_on_the_rounded_box() -> None:
    """Every point lies on the surface, whose distance function is known, and none lies within."""
    box, rays = Box(), fan()
    hits = box.cast(EYE, rays)
    assert set(hits.part.tolist()) >= {TABLE, LID, 2, 3}
    centre = torch.tensor([0.0, box.height / 2, 0.0])[:, None]
    inner = torch.tensor([box.half[0], box.height / 2, box.half[2]])[:, None] - box.rounding

    def away(points: torch.Tensor) -> torch.Tensor:
        return ((points - centre).abs() - inner).clamp(min=0).norm(dim=0) - box.rounding

    on = hits.part >= LID
    torch.testing.assert_close(
        away(hits.position[:, on]), torch.zeros(int(on.sum())), atol=2e-4, rtol=0
    )
    reach = (hits.position - EYE[:, None]).norm(dim=0) / rays.norm(dim=0)
    for share in np.linspace(0.3, 0.98, 35):
        on_the_way = away(EYE[:, None] + share * reach * rays)
        assert float(on_the_way.min()) > -3e-3
    assert torch.allclose(hits.position[1, hits.part == TABLE], torch.zeros(1), atol=1e-5)
    torch.testing.assert_close(hits.normal.norm(dim=0), torch.ones(rays.shape[1]))
    up = box.cast(EYE, torch.tensor([[0.0], [1.0], [-1.0]]))
    assert up.part.tolist() == [NOTHING]


def test_a_box_s_shadow() -> None:
    box = Box()
    points = torch.tensor([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]]).T
    low = torch.nn.functional.normalize(torch.tensor([-1.0, 0.1, 0.0]), dim=0)[:, None]
    assert box.covers(points, low.expand(3, 2)).tolist() == [1.0, 0.0]
    high = torch.tensor([0.0, 1.0, 0.0])[:, None].expand(3, 2)
    assert box.covers(points, high).tolist() == [0.0, 0.0]


def test_a_camera_s_rays() -> None:
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), 90.0, (200, 100))
    corners = camera.rays(torch.tensor([0.0, 200.0, 100.0]), torch.tensor([50.0, 50.0, 0.0]))
    expected = torch.tensor([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 0.5, -1.0]]).T
    torch.testing.assert_close(corners, expected, atol=1e-6, rtol=0)
    with pytest.raises(InputError, match="fov_deg"):
        Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), 180.0, (2, 2))


def solid_angle_of(window: Window) -> float:
    """Of a window from the object, in sr, by its four corners (van Oosterom & Strackee 1983)."""
    m, a, u = (torch.tensor(x, dtype=torch.float64) for x in (window.middle, window.across,
                                                              window.up))  # fmt: skip
    corners = [m - a - u, m + a - u, m + a + u, m - a + u]

    def triangle(p: Tensor, q: Tensor, r: Tensor) -> float:
        x, y, z = (v / v.norm() for v in (p, q, r))
        top = float(torch.linalg.cross(y, z) @ x)
        return 2 * math.atan2(abs(top), 1 + float(x @ y + y @ z + z @ x))

    return triangle(*corners[:3]) + triangle(corners[0], corners[2], corners[3])


def test_a_room_s_windows_have_their_solid_angle() -> None:
    lamp = replace(SHOJI[-1], fading=0.0, radiance=(700.0, 700.0, 700.0))
    image = room(128, (lamp,)).double() - room(128, ()).double()
    seen = image[0] / 700 * solid_angles(128, 256)
    assert float(seen.sum()) == pytest.approx(solid_angle_of(lamp), rel=0.03)


@pytest.mark.parametrize("roughness", [0.03, 0.06])
def test_polish_against_every_texel(roughness: float) -> None:
    """The mirror image of a smooth room, by the look-up and by the sum over all texels."""
    y, x = torch.meshgrid(
        torch.linspace(0, math.pi, 96), torch.linspace(0, 2 * math.pi, 192), indexing="ij"
    )
    smooth = 2 + 0.8 * torch.sin(2 * x) * torch.sin(y) + 0.5 * torch.cos(3 * y)
    light = EnvironmentLight(smooth.expand(3, -1, -1).contiguous(), rotation_deg=25.0)
    face = black_urushi(roughness)
    turn = torch.linspace(-0.5, 0.5, 40)
    normal = torch.stack([turn.sin(), turn.cos(), 0 * turn])
    view = torch.nn.functional.normalize(torch.tensor([0.3, 0.8, 0.5]), dim=0)[:, None]
    mirror, cosine = mirrored(normal, view.expand(3, 40))
    found = MirroredSurroundings(light, roughness).at(mirror) * reflected_share(face, cosine)
    lamps = light.lamps("all")
    n, v = normal[None, :, None], view[None, :, None]
    truth = torch.zeros(3, 40)
    fine = torch.nn.functional.interpolate(light.radiance[None], scale_factor=6, mode="bilinear")[0]
    lamps = EnvironmentLight(fine, rotation_deg=25.0).lamps("all")
    for d, e in zip(
        lamps.directions.float().split(4000), lamps.irradiance.float().split(4000), strict=True
    ):
        near = (d @ mirror).amax(1) > 0.5
        to = d[near].T[None, :, :, None]
        f = face.gloss(n.expand(1, 3, int(near.sum()), 40), to.expand(-1, -1, -1, 40), v)
        truth += (f * (n * to).sum(1, keepdim=True).clamp(min=0) * e[near].T[None, :, :, None])[
            0
        ].sum(1)
    error = (found - truth).abs() / truth.max()
    assert float(error.max()) < 0.06
    assert float(error.mean()) < 0.02


@pytest.mark.parametrize("shell", ["yakogai", "akoya"])
def test_a_simulated_shell_is_the_simulation(shell: str) -> None:
    angles = np.random.default_rng(1).random((500, 3)) * [75, 150, 150] - [0, 75, 75]
    measured = rt.simulate_specimen(shell, geometries_deg=angles, tablet_scale=1.05)
    truth = measured.values / 100 / np.pi @ XYZ_TO_SRGB.T
    vectors = vectors_from_angles(*torch.tensor(np.radians(angles)).T.reshape(3, 1, 1, 1, -1))
    found = SimulatedShell(shell, 1.05).of_unit_vectors(*(v.float() for v in vectors))
    error = found[0, :, 0].T.numpy() - truth
    assert np.sqrt((error**2).mean()) < 0.006 * np.sqrt((truth**2).mean())
    assert np.abs(error).max() < 0.015 * truth.max()
    with pytest.raises(InputError, match="oyster"):
        SimulatedShell("oyster")


def test_weights_of_the_artwork_are_shares() -> None:
    scales = {name: (1.0,) for name in ("yakogai", "mexican", "awabi", "akoya")}
    for part in (LID, 2):
        chart = decorated(Box(), part, 0.02, scales, 7)
        assert chart.weights.shape[0] == 4 + 3
        assert float(chart.weights.min()) >= 0
        torch.testing.assert_close(chart.weights.sum(0), torch.ones(chart.weights.shape[1:]))


def test_edges_are_as_with_many_samples(scene_file: Writer) -> None:
    """Against 10 x 10 samples in every pixel: a fifth of what one sample a pixel leaves."""
    scene = Scene.read(scene_file())
    size = (96, 54)
    camera = Camera((1.5, 3.7, 5.6), (0.05, 0.36, 0.0), 33.0, size)

    def image(per_side: int, everywhere: bool = False) -> torch.Tensor:
        samples = sampled(scene._box, camera, per_side, everywhere)
        bright = torch.tensor([0.5, 0.1, 0.2, 0.05, 0.0, 0.0])[samples.hits.part.clamp(min=0)]
        shown = bright + 0.3 * samples.hits.normal[2]
        return samples.averaged(shown.expand(3, -1), size)

    reference = image(10, everywhere=True)
    one, four = ((image(k) - reference).square().mean().sqrt() for k in (1, 4))
    assert float(four) < 0.2 * float(one)
    assert float((image(4) - reference).abs().max()) < 0.1


def test_light_adds_up_and_still_light_is_kept(scene_file: Writer) -> None:
    lamp = "[[lights.point]]\nposition = [1.0, 3.0, 1.0]\norbit = { turns = 1.0 }\n"
    alone = Scene.read(scene_file(('[lights.environment]\nbuiltin = "room"\n', ""), more=lamp))
    both, room_alone = Scene.read(scene_file(more=lamp)), Scene.read(scene_file())
    for number in (1, 3):
        whole = alone.frame(number) + room_alone.frame(number)
        torch.testing.assert_close(both.frame(number), whole, atol=1e-5, rtol=1e-4)
    assert float((both.frame(1) - both.frame(3)).abs().max()) > 0.05
    assert torch.isfinite(both.frame(2)).all()


def test_turning_the_object_is_turning_all_else(scene_file: Writer) -> None:
    """A quarter turn of a square box changes what is seen only by the light, which stays."""
    square = ('artwork = "none"', 'artwork = "none"\nsize = [2.0, 0.8, 2.0]\nturn_deg = 360.0')
    scene = Scene.read(scene_file(square))
    torch.testing.assert_close(scene.frame(1), scene.frame(2), atol=0.02, rtol=0.02)


def test_layers_from_files_cover_the_lid(scene_file: Writer, tmp_path: Path) -> None:
    mask = np.zeros((40, 56), np.uint8)
    mask[:, 28:] = 255
    write_pixels(mask, tmp_path / "m.png")
    red = '[[materials]]\nname = "red"\nalbedo = [0.8, 0.0, 0.0]\n'
    layer = '[[layers]]\nmaterial = "red"\nmask = "m.png"\n'
    image = Scene.read(scene_file(more=red + layer)).frame()[0]
    plain = Scene.read(scene_file()).frame()[0]
    right, left = (image - plain)[0, 14:20, 56:66], (image - plain)[0, 14:20, 22:36]
    assert float(right.mean()) > 0.05
    assert float(left.abs().max()) < 1e-4


def test_a_gbuffer_is_lit_as_a_scene(scene_file: Writer, tmp_path: Path) -> None:
    normal = np.zeros((3, 10, 12), np.float32)
    normal[2] = 1
    write_channels(tmp_path / "g.exr", dict(zip(("N.X", "N.Y", "N.Z"), normal, strict=True)))
    text = '[object]\ngbuffer = "g.exr"\nground = "white"\n[[materials]]\nname = "white"\n'
    text += "albedo = [1.0, 1.0, 1.0]\n[[lights.directional]]\ndirection = [0, 0, 1]\n"
    path = tmp_path / "g.toml"
    path.write_text(text)
    image = Scene.read(path).frame()
    assert image.shape == (1, 3, 10, 12)
    torch.testing.assert_close(image, torch.ones_like(image), atol=2e-3, rtol=0)


def test_a_rectangle_s_mirror_image() -> None:
    """A mirror sees a lamp where the mirrored ray meets it, from its bright side alone."""
    lamp = RectangleLight((0.0, 2.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 1.0), (3.0, 2.0, 1.0))
    x = torch.tensor([0.0, 0.9, 1.1, 0.0, 0.0])
    z = torch.tensor([0.0, 0.4, 0.0, 0.6, 0.0])
    position = torch.stack([x, torch.tensor([0.0, 0.0, 0.0, 0.0, 4.0]), z])
    up = torch.tensor([0.0, 1.0, 0.0])[:, None] * torch.tensor([1.0, 1.0, 1.0, 1.0, -1.0])
    seen = mirrored_rectangle(lamp, position, up)
    assert seen[0].tolist() == [3.0, 3.0, 0.0, 0.0, 0.0]
    turned = RectangleLight((0.0, 2.0, 0.0), (0.0, 0.0, 1.0), (2.0, 0.0, 0.0), 1.0)
    assert mirrored_rectangle(turned, position, up)[0].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0]
