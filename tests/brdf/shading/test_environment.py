"""Environment maps: against closed forms and sums over every texel; and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.files.environment_file import load_environment
from raden_torch.brdf.shading import environment, latlong
from raden_torch.brdf.shading.environment import EnvironmentLight
from raden_torch.brdf.shading.from_afar import surroundings_from_afar
from raden_torch.brdf.shading.shade import warn_if_black
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.errors import InputError
from raden_torch.images.exr import write_channels


@pytest.fixture(scope="module")
def shell() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("akoya", step_deg=10)).model


def bright(height: int = 16) -> torch.Tensor:
    """A dim room with a window and a lamp."""
    generator = torch.Generator().manual_seed(3)
    radiance = 0.1 + 0.1 * torch.rand(3, height, 2 * height, generator=generator)
    radiance[:, height // 4 : height // 2, : height // 4] += 4.0
    radiance[0, height // 3, height // 2] += 50.0
    return radiance


def test_even_surroundings_light_a_white_diffuser_to_their_own_radiance(lambertian_light) -> None:
    """Rationale: ∫ cos θi dω = π over a hemisphere. Expected: L = ρ E with ρ = 1, any normal."""
    for samples, within in (("all", 0.004), (512, 0.02)):
        light = EnvironmentLight(torch.full((3, 32, 64), 0.7), samples=samples)
        image = lambertian_light(light)
        torch.testing.assert_close(image, torch.full_like(image, 0.7), rtol=within, atol=0)


@pytest.fixture
def lambertian_light():
    class White:
        def working_dtype(self, *maps):
            return torch.float64

        def of_unit_vectors(self, n, l, v):  # noqa: E741
            return torch.full_like(n + l, 1 / math.pi)

    def shaded(light):
        generator = torch.Generator().manual_seed(0)
        normal = torch.randn(1, 3, 1, 6, generator=generator, dtype=torch.float64)
        return rt.shade(White(), rt.GBuffer(normal, view=normal), light)

    return shaded


@pytest.mark.parametrize("samples", ["all", 64])
def test_turning_the_surroundings_is_turning_the_scene(shell, samples) -> None:
    light = EnvironmentLight(bright(), rotation_deg=40.0, samples=samples)
    gbuffer = sphere(12, samples=1)
    turn = latlong.about_y(-40.0).float()
    turned = rt.GBuffer(
        torch.einsum("ij,bjhw->bihw", turn, gbuffer.normal),
        view=torch.einsum("ij,bjhw->bihw", turn, gbuffer.view_map(gbuffer.normal)),
        mask=gbuffer.mask,
    )
    with torch.no_grad():
        one = rt.shade(shell, gbuffer, light)
        other = rt.shade(shell, turned, replace(light, rotation_deg=0.0))
    torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4)


def test_axes_are_as_documented() -> None:
    towards = latlong.directions(64, 128)
    assert towards[1, 0].min() > 0.99  # the first row is up
    assert towards[2, 32, 64] < -0.99  # the middle lies along -z
    assert towards[0, 32, 96] > 0.99  # a quarter to the right is +x
    assert float(latlong.solid_angles(64, 128).sum() * 128) == pytest.approx(4 * math.pi)


def test_lamps_keep_the_energy_and_their_error_falls(shell) -> None:
    light = EnvironmentLight(bright())
    whole = light.lamps("all").irradiance.sum(0)
    gbuffer = sphere(16, samples=1)
    with torch.no_grad():
        truth = rt.shade(shell, gbuffer, replace(light, samples="all"))
        errors = []
        for count in (8, 64, 256):
            torch.testing.assert_close(light.lamps(count).irradiance.sum(0), whole)
            image = rt.shade(shell, gbuffer, replace(light, samples=count))
            errors.append(float((image - truth).square().mean().sqrt() / truth.max()))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.005


@pytest.mark.parametrize("distant", [True, False])
def test_a_prefiltered_frame_is_within_a_hundredth(shell, distant) -> None:
    """Rationale: every texel is a lamp in the reference. Expected: RMS 0.5 % of the peak, and 1 %
    in 97 % of the pixels."""
    gbuffer = sphere(160, samples=1)
    if distant:
        gbuffer = rt.GBuffer(gbuffer.normal, view=(0.1, 0.0, 1.0), mask=gbuffer.mask)
    light = EnvironmentLight(bright())
    with torch.no_grad():
        truth = rt.shade(shell, gbuffer, replace(light, samples="all"))
        image = rt.shade(shell, gbuffer, light)
    error = (image - truth).abs() / truth.max()
    assert error.square().mean().sqrt() < 0.005
    assert error.amax(1).flatten().quantile(0.97) < 0.01


def test_a_distant_camera_reads_a_lit_sphere(shell) -> None:
    """Rationale: every texel is a lamp in the reference. Expected: RMS 0.1 % of the peak, 1 % in
    99.9 % of the values, 4 % where the one strong lamp sets; black behind, where normals are none,
    and by the mask; colours and turns as asked for."""
    gbuffer = sphere(300, samples=1)
    normal, mask = 3 * gbuffer.normal, gbuffer.mask.clone()
    normal[..., 150, 140], normal[..., 150, 141] = math.nan, 0.0
    normal[..., 150, 142] = torch.tensor([0.0, 0.0, -1.0])
    mask[..., 150, 143], mask[..., 150, 144] = math.nan, 0.5
    far = rt.GBuffer(normal, view=(0.3, 0.0, 2.0), mask=mask)
    light = EnvironmentLight(bright(), rotation_deg=40.0, intensity=(0.5, 1.0, 2.0))
    with torch.no_grad():
        view = torch.tensor([0.3, 0.0, 2.0]).view(1, 3, 1, 1)
        assert surroundings_from_afar(shell, normal, mask, view, [light]) is not None
        truth = rt.shade(shell, far, replace(light, samples="all"))
        image = rt.shade(shell, far, light)
        both = rt.shade(shell, far, [light, light, rt.DirectionalLight((0, 0, 1))])
        lamp = rt.shade(shell, far, rt.DirectionalLight((0, 0, 1)))
    error = (image - truth).abs() / truth.max()
    assert error.square().mean().sqrt() < 0.001
    assert error.flatten().quantile(0.999) < 0.01
    assert error.max() < 0.04
    assert (image[..., 150, 140:144] == 0).all()
    assert truth[..., 150, 144].min() > 0
    torch.testing.assert_close(both, 2 * image + lamp)


@pytest.mark.parametrize("mask", [None, 0.0])
def test_a_distant_camera_that_sees_nothing_gets_black(shell, mask) -> None:
    normal = torch.zeros(1, 3, 300, 300)
    normal[:, 2] = -1.0 if mask is None else 1.0
    masks = None if mask is None else torch.zeros(1, 1, 300, 300)
    gbuffer = rt.GBuffer(normal, view=(0.0, 0.0, 1.0), mask=masks)
    with torch.no_grad():
        assert (rt.shade(shell, gbuffer, EnvironmentLight(bright())) == 0).all()


def test_kept_lamps_are_the_lamps_of_the_map_as_it_is() -> None:
    light = EnvironmentLight(bright(), rotation_deg=30.0, intensity=(1.0, 2.0, 3.0))
    for change in (1.0, 2.0):
        light.radiance[:, 3:5] *= change
        for turned in (light, replace(light, rotation_deg=-80.0, intensity=0.5)):
            for count in (32, "all"):
                kept, made = turned.kept_lamps(count), turned.lamps(count)
                torch.testing.assert_close(kept.directions, made.directions)
                torch.testing.assert_close(kept.irradiance, made.irradiance)


def test_radiance_has_a_gradient(shell) -> None:
    radiance = bright().requires_grad_()
    light = EnvironmentLight(radiance, samples=16)
    rt.shade(shell, sphere(6, samples=1), light).sum().backward()
    assert torch.isfinite(radiance.grad).all()
    assert (radiance.grad != 0).any()


@pytest.mark.parametrize("samples", [None, 16])
def test_intensity_has_a_gradient(shell, samples) -> None:
    """Of 2 x, which radiance is linear in."""
    intensity = torch.tensor([2.0, 2.0, 2.0], requires_grad=True)
    light = EnvironmentLight(bright(), intensity=intensity, samples=samples)
    image = rt.shade(shell, sphere(6, samples=1), light)
    image.sum().backward()
    torch.testing.assert_close(2 * intensity.grad, image.detach().sum((0, 2, 3)))


def test_visibility_darkens_one_light(shell) -> None:
    gbuffer = sphere(8, samples=1)
    seen = torch.zeros(1, 1, 8, 8)
    seen[..., :4] = 0.5
    lamp = rt.DirectionalLight((0.0, 0.0, 1.0))
    with torch.no_grad():
        both = rt.shade(shell, gbuffer, [lamp, replace(lamp, visibility=seen)])
        alone = rt.shade(shell, gbuffer, lamp)
    torch.testing.assert_close(both, alone * (1 + seen))


def test_a_map_is_checked_once_and_again_when_it_was_written(monkeypatch) -> None:
    calls = []
    check = environment.check_map
    monkeypatch.setattr(environment, "check_map", lambda *a: (calls.append(1), check(*a)))
    light = EnvironmentLight(bright())
    replace(replace(light, intensity=2.0), rotation_deg=5.0)
    assert len(calls) == 1
    light.radiance[0, 1, 2] = math.nan
    with pytest.raises(InputError, match="row 1, column 2"):
        replace(light, intensity=3.0)
    with torch.inference_mode():
        uncounted = EnvironmentLight(bright())
        uncounted.radiance[0, 1, 2] = -1.0
        with pytest.raises(InputError, match="row 1, column 2"):
            replace(uncounted, intensity=3.0)


@pytest.mark.parametrize(
    ("light", "said"),
    [
        (EnvironmentLight(torch.zeros(3, 4, 8)), "expected a light of more than 0"),
        (rt.DirectionalLight((0, 0, 1), irradiance=0.0), "expected a light of more than 0"),
        (rt.DirectionalLight((0, 0, -1)), "is above the horizon of anything"),
    ],
)
def test_a_black_picture_is_told_by_its_cause(light, said) -> None:
    image = torch.zeros(1, 3, 4, 4)
    with pytest.warns(UserWarning, match=said):
        warn_if_black(image, [light])
    image[0, 0, 0, 0] = 1e-3
    warn_if_black(image, [light])


def test_bad_input_is_refused(shell, tmp_path) -> None:
    for value in (math.nan, math.inf, -1.0):
        radiance = bright()
        radiance[1, 2, 3] = value
        with pytest.raises(InputError, match=r"channel G, row 2, column 3 \(1 in all\)"):
            EnvironmentLight(radiance)
        write_channels(tmp_path / "e.exr", dict(zip("RGB", radiance.numpy(), strict=True)))
        with pytest.raises(InputError, match="column 3"):
            load_environment(tmp_path / "e.exr")
    with pytest.raises(InputError, match="lat-long map"):
        EnvironmentLight(torch.zeros(3, 8, 8))
    with pytest.raises(InputError, match="at most"):
        EnvironmentLight(torch.zeros(1).expand(3, 10000, 20000))
    with pytest.raises(InputError, match="samples"):
        EnvironmentLight(bright(), samples=0)
    lamp = rt.DirectionalLight((0, 0, 1), visibility=torch.ones(1, 1, 3, 3))
    with pytest.raises(InputError, match=r"visibility: expected \[1, 1, 4, 4\]"):
        rt.shade(shell, sphere(4, samples=1), lamp)
    with pytest.raises(InputError, match=r"\.hdr or \.exr"):
        load_environment("map.png")


def test_a_file_comes_back(tmp_path) -> None:
    radiance = bright()
    write_channels(tmp_path / "e.exr", dict(zip("RGB", radiance.numpy(), strict=True)))
    read = load_environment(tmp_path / "e.exr", rotation_deg=10.0)
    torch.testing.assert_close(read.radiance, radiance, rtol=1e-3, atol=1e-3)
