"""What `shade` may leave out: never more than the tolerance, and nothing at all without one."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import import_module

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import raden_torch as rt
from raden_torch.brdf.model import shading_kernel, simd
from raden_torch.brdf.model.model import CosineDiffuse
from raden_torch.brdf.model.reflectance_table import ReflectanceTable
from raden_torch.brdf.shading import eager
from raden_torch.brdf.shading.area_lights import DiscLight, RectangleLight, SphereLight
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.lit_sphere import lit_sphere
from raden_torch.errors import InputError

shade_module = import_module("raden_torch.brdf.shading.shade")
needs_kernel = pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    """A smooth lobe on the paper's grid."""
    a, r, t = torch.meshgrid(
        torch.linspace(0, 70, 15), *2 * [torch.linspace(-70, 70, 29)], indexing="ij"
    )
    lobe = torch.exp(-(((r - a) / 25) ** 2) - (t / 25) ** 2)[..., None]
    diffuse = CosineDiffuse(torch.tensor([0.1, 0.2, 0.3]), torch.tensor([0.5, 1.0, 2.0]))
    table = ReflectanceTable(0.1 + lobe * torch.tensor([1.0, 1.5, 2.0]), (0, -70, -70), (5, 5, 5))
    return rt.RadenBrdf(diffuse, table).requires_grad_(False)


def plate(height: int, width: int) -> rt.GBuffer:
    """A wavy plate, 20 wide, seen from far above."""
    y, x = torch.meshgrid(
        torch.linspace(-10, 10, height), torch.linspace(-10, 10, width), indexing="ij"
    )
    one = torch.ones_like(x)
    normal = torch.stack([0.3 * torch.sin(3 * x), 0.3 * torch.sin(2 * y + x), one])[None]
    return rt.GBuffer(normal, view=(0.1, 0.2, 1.0), position=torch.stack([x, y, 0 * x])[None])


def lamps(count: int, make: type, seed: int = 1) -> list[rt.PointLight]:
    generator = torch.Generator().manual_seed(seed)
    at = torch.rand(count, 3, generator=generator) * torch.tensor([20.0, 20.0, 1.0])
    at = at - torch.tensor([10.0, 10.0, -0.5])
    if make is rt.SpotLight:
        aim = torch.tensor([0.3, 0.1, -1.0])
        return [rt.SpotLight(p, p + aim, inner_deg=5, outer_deg=20) for p in at]
    return [rt.PointLight(p) for p in at]


def distant(count: int) -> list[rt.DirectionalLight]:
    generator = torch.Generator().manual_seed(4)
    to = torch.randn(count, 3, generator=generator) + torch.tensor([0.0, 0.0, 2.0])
    colours = torch.rand(count, 3, generator=generator)
    return [rt.DirectionalLight(d, e) for d, e in zip(to, colours, strict=True)]


@pytest.fixture
def spheres(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sides of the lit spheres that were read while the test ran."""
    read: list[int] = []
    look_up = shading_kernel.look_up

    def spy(sphere, *others):
        read.append(len(sphere.radiance))
        return look_up(sphere, *others)

    monkeypatch.setattr(shading_kernel, "look_up", spy)
    return read


@needs_kernel
@pytest.mark.parametrize("level", simd.LEVELS)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-2, 0.1, 1.0])
def test_what_lights_lose_stays_within_the_tolerance(model, level, tolerance) -> None:
    gbuffer, lights = plate(64, 200), lamps(40, rt.PointLight)
    with simd.using(level):
        exact = rt.shade(model, gbuffer, lights)
        found = rt.shade(model, gbuffer, lights, tolerance=tolerance)
    lost = (exact - found).amax()
    assert (exact - found).abs().amax() <= tolerance
    assert (lost > 0) == (tolerance >= 0.1)  # and it is made use of


SPOTS = lamps(30, rt.SpotLight)


@pytest.fixture(scope="module")
def eager_spots(model) -> torch.Tensor:
    with simd.using(simd.OFF):
        return rt.shade(model, plate(64, 200), SPOTS)


@needs_kernel
@pytest.mark.parametrize("level", simd.LEVELS)
def test_spots_that_shine_past_a_tile_are_not_missed(model, eager_spots, level) -> None:
    gbuffer = plate(64, 200)
    with simd.using(level):
        together = rt.shade(model, gbuffer, SPOTS)
        one_by_one = sum(rt.shade(model, gbuffer, light) for light in SPOTS)
    torch.testing.assert_close(together, one_by_one, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(together, eager_spots, rtol=1e-4, atol=1e-4)


@needs_kernel
@settings(deadline=None, max_examples=60)
@given(
    st.tuples(*3 * [st.floats(-3, 3)]),
    st.tuples(*3 * [st.floats(-3, 3)]),
    st.floats(1, 170),
)
def test_any_spot_lights_what_the_eager_form_lights(at, target, outer) -> None:
    position = torch.rand(1, 3, 4, 64, generator=torch.Generator().manual_seed(2))
    position = position * torch.linspace(0.01, 4, 4)[:, None]  # small tiles and large ones
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(position)
    gbuffer = rt.GBuffer(normal, view=(0.0, 0.0, 1.0), position=position)
    flat = rt.RadenBrdf(CosineDiffuse(torch.ones(3), torch.full((3,), 0.1)), None)
    flat.requires_grad_(False)
    spot = rt.SpotLight(at, target, inner_deg=0.5, outer_deg=outer)
    with simd.using(simd.OFF):
        eager = rt.shade(flat, gbuffer, spot)
    # a narrow cone's edge lies between two cosines that hardly differ: their rounding shows
    edge = math.cos(math.radians(0.5)) - math.cos(math.radians(outer))
    rounding = 4 * torch.finfo(torch.float32).eps / edge * float(eager.max())
    found = rt.shade(flat, gbuffer, spot)
    torch.testing.assert_close(found, eager, rtol=1e-3, atol=1e-4 + rounding)


@needs_kernel
@pytest.mark.parametrize("level", simd.LEVELS)
@pytest.mark.parametrize("count", [1, 6])
def test_a_lit_sphere_stays_within_the_tolerance(model, level, count, spheres) -> None:
    gbuffer, lights = plate(700, 1100), distant(count)
    behind = gbuffer.normal.clone()
    behind[..., :50, :] *= -1
    behind[..., 50, :] = 0
    behind[..., 51, :] = float("nan")
    for normal in (gbuffer.normal, behind):
        scene = rt.GBuffer(normal, view=gbuffer.view, mask=torch.rand(1, 1, 700, 1100))
        with simd.using(level):
            exact = rt.shade(model, scene, lights)
            tolerance = 0.03 * float(exact.amax())
            found = rt.shade(model, scene, lights, tolerance=tolerance)
        assert (exact - found).abs().amax() <= tolerance
        assert torch.equal(exact == 0, found == 0)
    assert len(spheres) == 2


@needs_kernel
def test_a_sphere_is_made_only_where_it_pays(model, spheres) -> None:
    lights = distant(3)
    rt.shade(model, plate(64, 64), lights, tolerance=1.0)  # few pixels
    rt.shade(model, plate(700, 1100), lights)  # exact
    rt.shade(model, plate(700, 1100), lights, tolerance=1e-6)  # too fine
    near = [*lights, rt.PointLight((0.0, 0.0, 2.0))]
    rt.shade(model, plate(700, 1100), near, tolerance=1.0)
    scene = plate(700, 1100)
    rt.shade(model, rt.GBuffer(scene.normal, view=scene.normal), lights, tolerance=1.0)
    assert spheres == []


def test_a_sphere_of_a_known_function_is_as_close_as_it_says() -> None:
    def cosine(n: torch.Tensor) -> torch.Tensor:
        return (
            (n * torch.tensor([0.6, 0.0, 0.8]).view(1, 3, 1, 1)).sum(1, keepdim=True).expand_as(n)
        )

    view = torch.tensor([2.0, -1.0, 0.5])
    sphere = lit_sphere(cosine, view, lights=8, pixels=10**6, tolerance=4e-3)
    assert sphere is not None
    assert sphere.error <= 4e-3
    torch.testing.assert_close(sphere.frame[2], torch.nn.functional.normalize(view, dim=0))
    torch.testing.assert_close(sphere.frame @ sphere.frame.T, torch.eye(3), atol=1e-6, rtol=0)


@needs_kernel
@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.3, 1.0), (1.0, 0.3), (0.5, -2.0)])
def test_the_upper_bound_is_one(model, gains, random_vectors) -> None:
    model.diffuse_gain, model.specular_gain = gains
    n, l, v = (random_vectors(50_000, seed).float() for seed in (1, 2, 3))  # noqa: E741
    largest, bound = model(n, l, v).abs().amax((0, 2, 3)), model.upper_bound()
    model.diffuse_gain = model.specular_gain = 1.0
    assert (largest <= bound).all()
    assert (bound <= 3 * largest).all()


@pytest.mark.parametrize("tolerance", [-1.0, float("nan"), float("inf")])
def test_a_wrong_tolerance_is_one_line(model, tolerance) -> None:
    with pytest.raises(
        InputError, match=r"^tolerance: expected a radiance of 0 or more, got [^\n]*$"
    ):
        rt.shade(model, plate(4, 4), distant(1), tolerance=tolerance)


@pytest.fixture
def pixels(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many pixels the eager form computed, sample by sample, while the test ran."""
    computed: list[int] = []
    reflected = eager.reflected

    def spy(material, surface, direction):
        f = reflected(material, surface, direction)
        computed.append(f.shape[-2] * f.shape[-1])
        return f

    monkeypatch.setattr(eager, "reflected", spy)
    return computed


WINDOWS = [
    RectangleLight((-9.0, -9.0, 1.5), (2.0, 0.0, 0.0), (0.0, -2.0, 0.0), 3.0, tolerance=0.05),
    DiscLight((8.0, 8.0, 2.0), (0.0, 0.0, -1.0), 0.5, (1.0, 4.0, 2.0), tolerance=0.05),
    SphereLight((0.0, 60.0, 60.0), 1.0, tolerance=0.05),
]


@pytest.mark.parametrize("tolerance", [0.01, 0.1])
@pytest.mark.parametrize("level", [simd.OFF, *simd.LEVELS[-1:]])
@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
def test_samples_of_lamps_lose_no_more_together(model, tolerance, level, precision, pixels) -> None:
    """Rationale: matt, a pixel is lit by all three; each sample alone would fit many times."""
    scene = plate(40, 60)
    gbuffer = rt.GBuffer(
        scene.normal.to(precision), view=scene.view, position=scene.position.to(precision)
    )
    lights = [*WINDOWS, *distant(2), *lamps(3, rt.PointLight)]
    with simd.using(level):
        exact = rt.shade(model, gbuffer, lights)
        whole = sum(pixels)
        pixels.clear()
        found = rt.shade(model, gbuffer, lights, tolerance=tolerance)
    lost = exact - found
    assert lost.abs().amax() <= tolerance
    assert lost.amax() > 0  # and it is made use of
    assert sum(pixels) < 0.8 * whole


@pytest.mark.parametrize("tolerance", [0.2, 1.0])
def test_lamps_that_stand_for_an_environment_are_left_out(model, tolerance) -> None:
    generator = torch.Generator().manual_seed(8)
    room = EnvironmentLight(torch.rand(3, 8, 16, generator=generator), samples=64)
    gbuffer = plate(40, 60)
    for level in (simd.OFF, *simd.LEVELS[-1:]):
        with simd.using(level):
            exact = rt.shade(model, gbuffer, [room, WINDOWS[0]])
            found = rt.shade(model, gbuffer, [room, WINDOWS[0]], tolerance=tolerance)
        assert 0 < (exact - found).amax() <= tolerance


@needs_kernel
def test_a_dim_environment_is_left_out_whole(model, monkeypatch) -> None:
    shaded: list[EnvironmentLight] = []

    def spy(model, gbuffer, light):
        shaded.append(light)
        return torch.zeros(gbuffer.normal.shape)

    monkeypatch.setattr(shade_module, "shade_surroundings", spy)
    dim = EnvironmentLight(torch.full((3, 8, 16), 1e-3))
    bright = EnvironmentLight(torch.ones(3, 8, 16))
    most = 1e-3 * math.pi * float(model.upper_bound().max())
    gbuffer = plate(8, 8)
    rt.shade(model, gbuffer, [dim, bright], tolerance=1.01 * most)
    assert shaded == [bright]
    shaded.clear()
    rt.shade(model, gbuffer, [dim, dim, bright], tolerance=1.5 * most)  # one fits, two do not
    assert shaded == [dim, bright]
    shaded.clear()
    assert not rt.shade(model, gbuffer, [dim], tolerance=2 * most).any()
    assert shaded == []
    rt.shade(model, gbuffer, [dim, bright])
    assert shaded == [dim, bright]


def test_lights_with_visibility_share_the_tolerance(model) -> None:
    gbuffer, everywhere = plate(40, 60), torch.ones(1, 1, 40, 60)
    lights = [
        rt.DirectionalLight(x.direction, 0.1 if k % 2 else 1e-3, everywhere)
        for k, x in enumerate(distant(40))
    ]
    tolerance = 0.22 * float(model.upper_bound().max())
    exact = rt.shade(model, gbuffer, lights)
    found = rt.shade(model, gbuffer, lights, tolerance=tolerance)
    assert 0 < (exact - found).amax() <= tolerance
    each = sum(rt.shade(model, gbuffer, light, tolerance=tolerance) for light in lights)
    assert (exact - each).amax() > tolerance  # what it would be if each took all of it


def test_gradients_leave_nothing_out(model, pixels) -> None:
    scene = plate(8, 8)
    normal = scene.normal.clone().requires_grad_()
    gbuffer = rt.GBuffer(normal, view=scene.view, position=scene.position)
    exact, found = (rt.shade(model, gbuffer, WINDOWS, tolerance=t) for t in (0.0, 10.0))
    assert torch.equal(exact, found)
    assert set(pixels) == {64}
    dim = replace(WINDOWS[0], radiance=torch.full((3,), 1e-6, requires_grad=True))
    rt.shade(model, scene, dim, tolerance=10.0).sum().backward()
    assert (dim.radiance.grad > 0).all()
