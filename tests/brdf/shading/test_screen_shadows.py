"""Screen-space shadows against those of a ball over a floor, by intersecting rays with both."""

from __future__ import annotations

import math

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.shading.area_lights import DiscLight
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.screen_shadows import with_screen_shadows
from raden_torch.brdf.shading.sphere_gbuffer import camera_rays, sphere
from raden_torch.errors import InputError

CAMERA = (0.5, 4.0, 7.0)
FLOOR, CENTRE, RADIUS = -1.0, (0.0, 0.4, 0.0), 0.8
SUN, LAMP = rt.DirectionalLight((1.0, 2.0, 0.8)), rt.PointLight((1.8, 3.0, 2.0))


def scene(size: int, camera=CAMERA, *, ball: bool = True, dtype=torch.float32) -> rt.GBuffer:
    """A ball over a floor without end, seen by a pinhole that looks at the origin."""
    eye = torch.tensor(camera, dtype=torch.float64)
    rays = camera_rays(eye, size, 0.4)
    eye, centre = eye.view(3, 1, 1), torch.tensor(CENTRE, dtype=torch.float64).view(3, 1, 1)
    to_floor = (FLOOR - eye[1]) / rays[1]
    to_floor = torch.where(to_floor > 0, to_floor, math.inf)
    to_ball = first_meeting(eye, rays) if ball else torch.full_like(to_floor, math.inf)
    reach = torch.minimum(to_floor, to_ball)
    hit = torch.isfinite(reach)
    point = eye + torch.where(hit, reach, 0) * rays
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).view(3, 1, 1)
    normal = torch.where(to_ball < to_floor, (point - centre) / RADIUS, up.expand_as(point))
    maps = [x[None].to(dtype) for x in (normal, point, hit[None])]
    return rt.GBuffer(maps[0], position=maps[1], camera=camera, mask=maps[2])


def first_meeting(start: torch.Tensor, towards: torch.Tensor) -> torch.Tensor:
    """Along rays `[3, H, W]`, to the ball; infinite where they miss it."""
    away = start - torch.tensor(CENTRE, dtype=torch.float64).view(3, 1, 1)
    square, half = (towards**2).sum(0), (towards * away).sum(0)
    root = half**2 - square * ((away**2).sum(0) - RADIUS**2)
    reach = (-half - root.clamp(min=0).sqrt()) / square
    return torch.where((root > 0) & (reach > 0), reach, math.inf)


def truth(gbuffer: rt.GBuffer, light, *, ball: bool = True) -> torch.Tensor:
    """`[H, W]`: what the lamp lights, by the normals and by rays from each point."""
    point, normal = gbuffer.position[0].double(), gbuffer.normal[0].double()
    if isinstance(light, rt.DirectionalLight):
        to_light = torch.tensor(light.direction, dtype=torch.float64).view(3, 1, 1) * 1e3
    else:
        to_light = torch.tensor(light.position, dtype=torch.float64).view(3, 1, 1) - point
    lit = ((normal * to_light).sum(0) > 0) & (gbuffer.mask[0, 0] > 0)
    if not ball:
        return lit
    start = point + 1e-4 * normal
    return lit & (first_meeting(start, to_light.expand_as(point)) > 1)


def edges(lit: torch.Tensor, *maps: torch.Tensor) -> torch.Tensor:
    """Pixels beside another that differs."""
    found = torch.zeros_like(lit)
    for m in (lit, *maps):
        around = m.float()[None, None]
        pool = torch.nn.functional.max_pool2d
        most, least = pool(around, 3, 1, 1), -pool(-around, 3, 1, 1)
        found |= (most != least)[0, 0]
    return found


def is_ball(gbuffer: rt.GBuffer) -> torch.Tensor:
    return gbuffer.position[0, 1] > FLOOR + 1e-3


@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
@pytest.mark.parametrize("light", [SUN, LAMP])
def test_a_balls_shadow_on_a_floor(light, precision) -> None:
    """Rationale: off the outlines by a pixel, 1 in 500 pixels may be wrong: a ball is no slab, so
    some floor in front of its far side is shadowed that is not. What it casts is found."""
    gbuffer = scene(160, dtype=precision)
    [seen] = with_screen_shadows(gbuffer, [light])
    assert seen.visibility.dtype == precision
    lit, found = truth(gbuffer, light), seen.visibility[0, 0] > 0.5
    inside = (gbuffer.mask[0, 0] > 0) & ~edges(lit, is_ball(gbuffer))
    cast = inside & ~lit & ~is_ball(gbuffer)
    assert int(cast.sum()) > 400
    assert float((found != lit)[inside].float().mean()) < 0.002
    assert float(found[cast].float().mean()) < 0.02
    assert torch.equal(found[is_ball(gbuffer) & inside], lit[is_ball(gbuffer) & inside])


def test_a_thin_ball_casts_no_more_than_it_has() -> None:
    gbuffer = scene(160)
    lit = truth(gbuffer, SUN)
    inside = ~edges(lit, is_ball(gbuffer))
    wrong = [
        float(((s.visibility[0, 0] > 0.5) != lit)[inside].float().mean())
        for t in (0.3, 100.0)
        for s in with_screen_shadows(gbuffer, [SUN], thickness=t)
    ]
    assert wrong[0] < 0.0005 < wrong[1] < 0.005


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 1, 2), (1, 0, 0), (1, 0, -0.5), (0, 1, 0.1)])
def test_a_lone_ball_has_no_specks(direction) -> None:
    ball = sphere(100, samples=1)
    [seen] = with_screen_shadows(ball, [rt.DirectionalLight(direction)])
    towards = torch.tensor(direction, dtype=torch.float32).view(3, 1, 1)
    lit = ((ball.normal[0] * towards).sum(0) > 1e-6) & (ball.mask[0, 0] > 0)
    assert torch.equal(seen.visibility[0, 0] > 0.5, lit)


@pytest.mark.parametrize("light", [SUN, LAMP, rt.DirectionalLight((0.5, 0.05, -1.0))])
@pytest.mark.parametrize("rounded", [torch.float32, torch.float16])
def test_a_lone_floor_has_no_specks(light, rounded) -> None:
    """Also where positions are stored in half precision, as in many EXRs."""
    gbuffer = scene(120, ball=False)
    maps = rt.GBuffer(
        gbuffer.normal,
        position=gbuffer.position.to(rounded).float(),
        camera=gbuffer.camera,
        mask=gbuffer.mask,
    )
    [seen] = with_screen_shadows(maps, [light])
    shown = gbuffer.mask[0, 0] > 0
    near = shown & (gbuffer.position[0, 2] > -6)
    assert float(seen.visibility[0, 0][near].mean()) == 1


def test_a_batch_is_its_images_and_a_spot_a_point() -> None:
    other = (3.0, 1.5, 6.0)
    one, two = scene(60), scene(60, other)
    both = rt.GBuffer(
        torch.cat([one.normal, two.normal]),
        position=torch.cat([one.position, two.position]),
        camera=torch.tensor([CAMERA, other]),
        mask=torch.cat([one.mask, two.mask]),
    )
    spot = rt.SpotLight(LAMP.position, CENTRE)
    together = with_screen_shadows(both, [SUN, LAMP, spot])
    assert [type(x) for x in together] == [rt.DirectionalLight, rt.PointLight, rt.SpotLight]
    assert torch.equal(together[1].visibility, together[2].visibility)
    for k, gbuffer in enumerate((one, two)):
        alone = with_screen_shadows(gbuffer, [SUN, LAMP])
        for a, b in zip(together, alone, strict=False):
            assert float((a.visibility[k] != b.visibility[0]).float().mean()) < 1e-3


def test_a_lamp_with_a_shape_has_a_soft_edge() -> None:
    """Rationale: from umbra to full light, the share of a disc's samples that are seen."""
    gbuffer = scene(80)
    disc = DiscLight(LAMP.position, tuple(-x for x in LAMP.position), 0.5, tolerance=0.05)
    small = DiscLight(LAMP.position, disc.facing, 1e-3, tolerance=0.05)
    soft, hard = with_screen_shadows(gbuffer, [disc, small])
    [point] = with_screen_shadows(gbuffer, [LAMP])
    assert float((hard.visibility - point.visibility).abs().mean()) < 1e-3
    partly = (soft.visibility > 0.01) & (soft.visibility < 0.99)
    assert 0.01 < float(partly.float().mean()) < 0.2


def test_what_is_left_alone() -> None:
    gbuffer = scene(40)
    assert with_screen_shadows(gbuffer, []) == []
    around = EnvironmentLight(torch.ones(3, 4, 8))
    half = rt.DirectionalLight(SUN.direction, visibility=torch.full((1, 1, 40, 40), 0.5))
    kept, dimmed, plain = with_screen_shadows(gbuffer, [around, half, SUN])
    assert kept is around
    torch.testing.assert_close(dimmed.visibility, 0.5 * plain.visibility)
    nothing = rt.GBuffer(torch.zeros_like(gbuffer.normal), position=gbuffer.position, camera=CAMERA)
    assert not with_screen_shadows(nothing, [SUN])[0].visibility.any()
    hole = gbuffer.position.clone()
    hole[:, :, 5:9] = float("nan")
    broken = rt.GBuffer(gbuffer.normal, position=hole, camera=CAMERA, mask=gbuffer.mask)
    seen = with_screen_shadows(broken, [LAMP])[0].visibility
    assert torch.isfinite(seen).all()
    assert not seen[:, :, 5:9].any()


def test_what_is_refused() -> None:
    gbuffer = scene(40)
    flat = rt.GBuffer(gbuffer.normal, view=(0, 0, 1), position=gbuffer.position)
    with pytest.raises(InputError, match=r"expected a G-buffer with position and camera, got pos"):
        with_screen_shadows(flat, [SUN])
    elsewhere = rt.GBuffer(gbuffer.normal, position=gbuffer.position, camera=(4.0, 1.0, 0.0))
    with pytest.raises(InputError, match=r"a pinhole at `camera` sees in their pixels, got some"):
        with_screen_shadows(elsewhere, [SUN])
    line = scene(40)
    line.mask[:, :, 1:] = 0
    with pytest.raises(InputError, match=r"which more than one camera sees so$"):
        with_screen_shadows(line, [SUN])
    for wrong in ({"thickness": 0.0}, {"bias_px": math.nan}, {"steps": 0}):
        with pytest.raises(InputError, match=f"^{next(iter(wrong))}: expected"):
            with_screen_shadows(gbuffer, [SUN], **wrong)
