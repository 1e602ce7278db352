"""Deferred shading: Lambert by hand, the three lights, masks, depth, and what is refused."""

from __future__ import annotations

import math

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.errors import InputError


@pytest.fixture(scope="module")
def lambertian() -> rt.RadenBrdf:
    """f_r = 1/π in every geometry of its (wide) box."""
    table = torch.full((10, 19, 19, 3), 1 / math.pi, dtype=torch.float64)
    return rt.RadenBrdf(None, ReflectanceTable(table, (0.0, -90.0, -90.0), (10.0, 10.0, 10.0)))


def flat(h: int = 2, w: int = 3, **maps) -> rt.GBuffer:
    normal = torch.zeros(1, 3, h, w, dtype=torch.float64)
    normal[:, 2] = 1
    return rt.GBuffer(normal=normal, **({"view": (0.0, 0.0, 1.0)} | maps))


def plane_positions(h: int = 2, w: int = 3) -> torch.Tensor:
    position = torch.zeros(1, 3, h, w, dtype=torch.float64)
    position[:, 0] = torch.arange(w)
    return position


def test_a_white_diffuser_facing_irradiance_pi_shines_with_one(lambertian) -> None:
    image = rt.shade(lambertian, flat(), rt.DirectionalLight((0, 0, 5)))
    torch.testing.assert_close(image, torch.ones(1, 3, 2, 3, dtype=torch.float64))


def test_radiance_follows_the_cosine_and_the_colour(lambertian) -> None:
    s = math.sin(math.radians(60))
    image = rt.shade(
        lambertian, flat(), [rt.DirectionalLight((s, 0, 0.5), (math.pi, 0, 2 * math.pi))]
    )
    assert image[0, :, 0, 0].tolist() == pytest.approx([0.5, 0, 1.0])


def test_lights_add_up(lambertian) -> None:
    lights = [rt.DirectionalLight((0.3, 0.2, 1)), rt.DirectionalLight((-1, 0, 1), (1, 2, 3))]
    both = rt.shade(lambertian, flat(), lights)
    torch.testing.assert_close(both, sum(rt.shade(lambertian, flat(), light) for light in lights))
    assert (rt.shade(lambertian, flat(), []) == 0).all()


def test_point_light_falls_with_the_square_of_the_distance(lambertian) -> None:
    gbuffer = flat(position=plane_positions())
    image = rt.shade(lambertian, gbuffer, rt.PointLight((0, 0, 2), (math.pi,) * 3))
    for x in range(3):
        square = 4 + x * x
        assert image[0, 0, 0, x].item() == pytest.approx(2 / math.sqrt(square) / square)
    inside = rt.shade(lambertian, gbuffer, rt.PointLight((0, 0, 0)))
    assert torch.isfinite(inside).all()
    assert (inside == 0).all()


def test_spot_light_has_a_cone(lambertian) -> None:
    gbuffer = flat(h=1, w=8, position=plane_positions(1, 8))
    point = rt.shade(lambertian, gbuffer, rt.PointLight((0, 0, 2)))
    spot = rt.shade(
        lambertian, gbuffer, rt.SpotLight((0, 0, 2), (0, 0, 0), inner_deg=30, outer_deg=50)
    )
    share = (spot / point)[0, 0, 0].tolist()
    assert share[:2] == pytest.approx([1, 1])  # 0 and 27 degrees off the axis
    assert 0 < share[2] < 1  # 45 degrees
    assert share[3:] == pytest.approx([0] * 5)  # 56 degrees and more


def test_camera_and_position_make_the_view(random_vectors, analytic) -> None:
    model = rt.fit(analytic(), interpolation="trilinear").model
    position = plane_positions()
    seen = rt.GBuffer(normal=flat().normal, position=position, camera=(1.0, 1.0, 3.0))
    view = torch.tensor([1.0, 1, 3], dtype=torch.float64).view(1, 3, 1, 1) - position
    light = rt.DirectionalLight((1, -1, 2))
    torch.testing.assert_close(
        rt.shade(model, seen, light), rt.shade(model, flat(view=view), light)
    )


def test_mask_scales_and_hides(lambertian) -> None:
    mask = torch.tensor([[[[0.0, 0.5, 1.0], [float("nan"), 2.0, -1.0]]]])
    image = rt.shade(lambertian, flat(mask=mask), rt.DirectionalLight((0, 0, 1)))
    assert image[0, 1].flatten().tolist() == pytest.approx([0, 0.5, 1, 0, 1, 0])
    hard = rt.shade(lambertian, flat(mask=mask[..., :1] > 1), rt.DirectionalLight((0, 0, 1)))
    assert (hard == 0).all()


def test_batches_may_have_their_own_lights_and_cameras(lambertian) -> None:
    normal = flat().normal.expand(2, 3, 2, 3)
    directions = torch.tensor([[0.0, 0, 1], [1.0, 0, 1]])
    image = rt.shade(
        lambertian, rt.GBuffer(normal, view=(0, 0, 1)), rt.DirectionalLight(directions)
    )
    assert image.shape == (2, 3, 2, 3)
    assert image[:, 0, 0, 0].tolist() == pytest.approx([1, math.sqrt(0.5)])


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_precision_maps(lambertian, half: torch.dtype) -> None:
    gbuffer = rt.GBuffer(
        flat().normal.to(half), view=(0, 0, 1), position=plane_positions().to(half)
    )
    model = rt.RadenBrdf(CosineDiffuse(torch.ones(3), torch.ones(3)), None)
    image = rt.shade(model, gbuffer, rt.PointLight((0, 1, 2)))
    assert image.dtype == torch.float32
    assert (image > 0).all()


def test_huge_and_invalid_pixels_stay_finite(lambertian) -> None:
    gbuffer = flat(position=plane_positions())
    gbuffer.normal[..., 0, 0] = 0
    gbuffer.position[..., 0, 1] = float("nan")
    gbuffer.position[..., 0, 2] = 1e300
    image = rt.shade(lambertian, gbuffer, rt.PointLight((0, 0, 2)))
    assert torch.isfinite(image).all()
    assert (image[..., 0, :] == 0).all()
    assert (image[..., 1, :] > 0).all()
    bright = rt.shade(lambertian, flat(), rt.DirectionalLight((0, 0, 1), (1e308, 1e308, 1e308)))
    assert torch.isfinite(bright).all()


def test_depth_alone_makes_a_gbuffer(lambertian) -> None:
    """A plane z = 4 + x tan 30° seen by a pinhole camera: its normal is known."""
    f, n = 100.0, 65
    intrinsics = torch.tensor([[f, 0, 32], [0, f, 32], [0, 0, 1]], dtype=torch.float64)
    x = (torch.arange(n, dtype=torch.float64) - 32) / f
    slope = math.tan(math.radians(30))
    depth = (4 / (1 - slope * x)).expand(1, 1, n, n).clone()
    depth[..., 3, 3] = float("nan")
    gbuffer = rt.GBuffer.from_depth(depth, intrinsics)
    normal = gbuffer.normal[0, :, 8:-8, 8:-8]
    expected = torch.tensor([math.sin(math.radians(30)), 0, -math.cos(math.radians(30))]).double()
    assert (normal - expected.view(3, 1, 1)).abs().max() < 2e-3
    assert gbuffer.mask[0, 0, 3, 3] == 0
    assert gbuffer.mask.sum() == n * n - 1
    torch.testing.assert_close(gbuffer.position[0, 2, 20], depth[0, 0, 20])
    image = rt.shade(lambertian, gbuffer, rt.DirectionalLight((0, 0, -1)))
    assert torch.isfinite(image).all()
    assert image[0, 0, 32, 32].item() == pytest.approx(math.cos(math.radians(30)), abs=1e-3)


BAD_BUFFERS = {
    "no view": (lambda n: rt.GBuffer(n), "expected view, or position and camera, got neither"),
    "position without camera": (lambda n: rt.GBuffer(n, position=n), "position and camera"),
    "unbatched normal": (lambda n: rt.GBuffer(n[0], view=(0, 0, 1)), r"\[B, 3, H, W\]"),
    "no tensor": (lambda n: rt.GBuffer("n", view=(0, 0, 1)), "str"),
    "two numbers": (lambda n: rt.GBuffer(n, view=(0, 1)), r"view: expected shape .*, got \[2\]"),
    "other size": (
        lambda n: rt.GBuffer(n, view=torch.ones(1, 3, 9, 9)),
        "expected equal sizes or 1, which broadcast, got",
    ),
    "mask of another size": (
        lambda n: rt.GBuffer(n, view=(0, 0, 1), mask=torch.ones(1, 1, 9, 9)),
        r"mask: expected shape \[1, 1, 2, 3\] .*, got \[1, 1, 9, 9\]",
    ),
    "mask of three channels": (lambda n: rt.GBuffer(n, view=(0, 0, 1), mask=n), "mask"),
    "integer depth": (
        lambda n: rt.GBuffer.from_depth(torch.ones(1, 1, 2, 2).int(), torch.eye(3)),
        "floating-point",
    ),
    "intrinsics": (
        lambda n: rt.GBuffer.from_depth(torch.ones(1, 1, 2, 2), torch.eye(4)),
        "intrins",
    ),
}


@pytest.mark.parametrize("name", BAD_BUFFERS)
def test_wrong_buffers_are_one_line(name: str) -> None:
    make, words = BAD_BUFFERS[name]
    with pytest.raises(InputError, match=words) as error:
        make(flat().normal)
    assert "\n" not in str(error.value)


BAD_LIGHTS = {
    "zero direction": (lambda: rt.DirectionalLight((0, 0, 0)), "direction: .*, got zero"),
    "two numbers": (
        lambda: rt.DirectionalLight((0, 1)),
        r"direction: expected shape .*, got \[2\]",
    ),
    "words": (lambda: rt.DirectionalLight("up"), "three numbers"),
    "nan": (
        lambda: rt.PointLight((0, float("nan"), 0)),
        r"position: expected three finite numbers, got \(0, nan, 0\)",
    ),
    "cone": (
        lambda: rt.SpotLight((0, 0, 1), (0, 0, 0), inner_deg=40, outer_deg=30),
        "expected 0 <= inner_deg < outer_deg <= 180, got inner_deg 40, outer_deg 30",
    ),
}


@pytest.mark.parametrize("name", BAD_LIGHTS)
def test_wrong_lights_are_one_line(name: str) -> None:
    make, words = BAD_LIGHTS[name]
    with pytest.raises(InputError, match=words):
        make()


def test_a_point_light_without_positions_says_so(lambertian) -> None:
    with pytest.raises(InputError, match=r"PointLight: expected a G-buffer with position"):
        rt.shade(lambertian, flat(), rt.PointLight((0, 0, 1)))
    with pytest.raises(InputError, match=r"expected DirectionalLight .* got dict"):
        rt.shade(lambertian, flat(), [{}])
