"""A palette: each pixel shows its own material, or its own mixture of several."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.metal import Foil
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.model import shading_kernel, simd
from raden_torch.brdf.shading.area_lights import SphereLight
from raden_torch.brdf.shading.environment import DistantLamps, EnvironmentLight
from raden_torch.errors import InputError


@pytest.fixture(scope="module")
def shells() -> list[rt.RadenBrdf]:
    names = ("akoya", "yakogai", "abalone")
    return [rt.fit(rt.simulate_specimen(name, step_deg=35)).model for name in names]


def scene(dtype: torch.dtype = torch.float32) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(3)
    normal = torch.randn(2, 3, 9, 11, generator=draw, dtype=torch.float64) * 0.3
    normal[:, 2] += 1
    position = torch.randn(2, 3, 9, 11, generator=draw, dtype=torch.float64) * 0.2
    mask = (torch.rand(2, 1, 9, 11, generator=draw) > 0.3).to(dtype)
    index = torch.randint(0, 3, (2, 1, 9, 11), generator=draw)
    return {
        "normal": normal.to(dtype),
        "position": position.to(dtype),
        "mask": mask,
        "index": index,
        "layer_normal": (normal + 0.05).to(dtype),
    }


LIGHTS = (
    rt.PointLight((0.5, 1.0, 2.0), (3.0, 2.0, 1.0)),
    rt.DirectionalLight(torch.tensor([[1.0, 0.0, 2.0], [0.0, 1.0, 2.0]])),
    rt.SpotLight((0.0, 0.0, 3.0), (0.1, 0.0, 0.0)),
)


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("layers", [False, True])
def test_each_pixel_is_that_of_its_material_alone(shells, dtype, layers, recorded):
    """In one pass, and gathered, as gradients take it."""
    with torch.set_grad_enabled(recorded):
        check_each_pixel(shells, dtype, layers)


def check_each_pixel(shells: list[rt.RadenBrdf], dtype: torch.dtype, layers: bool) -> None:
    maps = scene(dtype)
    camera = torch.tensor([[0.0, 0.0, 4.0], [1.0, 0.0, 4.0]], dtype=dtype)
    common = {"position": maps["position"], "camera": camera, "mask": maps["mask"]}
    if layers:
        common["layer_normal"] = maps["layer_normal"]
    gbuffer = rt.GBuffer(maps["normal"], material=maps["index"], **common)
    image = rt.shade(Palette(shells), gbuffer, LIGHTS)
    assert image.dtype == dtype
    for place, shell in enumerate(shells):
        alone = rt.shade(shell, rt.GBuffer(maps["normal"], **common), LIGHTS)
        here = (maps["index"] == place).expand_as(image)
        assert (alone[here] > 0).any()
        torch.testing.assert_close(image[here], alone[here])


def test_weights_mix_radiance_and_have_gradients(shells):
    maps = scene(torch.float64)
    draw = torch.Generator().manual_seed(1)
    weights = torch.softmax(3 * torch.randn(2, 3, 9, 11, generator=draw, dtype=torch.float64), 1)
    weights[:, :, :3] = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).view(1, 3, 1, 1)
    alone = torch.stack(
        [rt.shade(s, rt.GBuffer(maps["normal"], view=(0, 0, 1)), LIGHTS[1]) for s in shells]
    )
    wanted = torch.einsum("kbchw,bkhw->bchw", alone, weights)
    palette = Palette(shells)
    image = rt.shade(palette, rt.GBuffer(maps["normal"], (0, 0, 1), material=weights), LIGHTS[1])
    torch.testing.assert_close(image, wanted)
    asked = weights.clone().requires_grad_()
    image = rt.shade(palette, rt.GBuffer(maps["normal"], (0, 0, 1), material=asked), LIGHTS[1])
    image.sum().backward()
    # a weight of 0 has its gradient, too
    torch.testing.assert_close(asked.grad, alone.sum(2).movedim(0, 1))
    assert shells[0].table.values.grad.abs().sum() > 0


@pytest.mark.parametrize("batch", [1, 3, 6])
def test_each_image_of_a_batch_has_its_own_lamps(shells, batch):
    draw = torch.Generator().manual_seed(batch)
    normal = 0.3 * torch.randn(batch, 3, 8, 8, generator=draw)
    normal[:, 2] += 1
    index = torch.randint(0, 2, (batch, 1, 8, 8), generator=draw)
    towards = 0.5 * torch.randn(batch, 3, generator=draw)
    towards[:, 2] = 1
    colours = torch.rand(batch, 3, generator=draw)
    with torch.no_grad():
        # one lamp for each image; and as many lamps as images, all for every image
        for light in (rt.DirectionalLight(towards), DistantLamps(towards, colours)):
            gbuffer = rt.GBuffer(normal, (0, 0, 1), material=index)
            image = rt.shade(Palette(shells[:2]), gbuffer, light)
            alone = [rt.shade(s, rt.GBuffer(normal, (0, 0, 1)), light) for s in shells[:2]]
            torch.testing.assert_close(image, torch.where(index == 0, *alone))


@pytest.fixture
def passes(monkeypatch: pytest.MonkeyPatch) -> list[list[Any]]:
    """The models of each pass over several tables."""
    found, one = [], shading_kernel.shade_several
    monkeypatch.setattr(
        shading_kernel, "shade_several", lambda *a: (found.append(a[0]), one(*a))[1]
    )
    return found


def test_what_has_no_table_is_shaded_beside_what_has(shells, passes):
    """And so is all under lights that the kernel does not know."""
    turned = AnisotropicBrdf(shells[:2], (0, 90))
    members = [shells[0], turned, Foil("gold")]
    maps = scene()
    sky = EnvironmentLight(torch.rand(3, 8, 16, generator=torch.Generator().manual_seed(0)))
    window = SphereLight((0.0, 0.0, 5.0), 1.0)
    lights = [*LIGHTS, sky, window]
    common = {"position": maps["position"], "camera": (0.0, 0.0, 4.0), "mask": maps["mask"]}
    gbuffer = rt.GBuffer(maps["normal"], material=maps["index"], **common)
    with torch.no_grad():
        image = rt.shade(Palette(members), gbuffer, lights)
        alone = [rt.shade(m, rt.GBuffer(maps["normal"], **common), lights) for m in members]
    wanted = torch.stack(alone).gather(0, maps["index"].expand_as(image)[None])[0]
    # an environment is sampled otherwise where there are fewer pixels
    torch.testing.assert_close(image, wanted, rtol=0.05, atol=0.02)
    with torch.no_grad():
        lamps = rt.shade(Palette(members), gbuffer, LIGHTS)
        alone = [rt.shade(m, rt.GBuffer(maps["normal"], **common), LIGHTS) for m in members]
    wanted = torch.stack(alone).gather(0, maps["index"].expand_as(image)[None])[0]
    torch.testing.assert_close(lamps, wanted)
    if simd.LEVELS:
        assert [[m is None for m in each] for each in passes] == 2 * [[False, True, False]]


def test_gains_of_both_parts_take_two_passes(shells, passes):
    maps = scene()
    draw = torch.Generator().manual_seed(5)
    gains = {k: torch.rand(2, 1, 9, 11, generator=draw) for k in ("diffuse_gain", "specular_gain")}
    common = {"view": (0.0, 0.0, 1.0), "mask": maps["mask"], **gains}
    with torch.no_grad():
        image = rt.shade(
            Palette(shells), rt.GBuffer(maps["normal"], material=maps["index"], **common), LIGHTS[1]
        )
        alone = [rt.shade(s, rt.GBuffer(maps["normal"], **common), LIGHTS[1]) for s in shells]
    wanted = torch.stack(alone).gather(0, maps["index"].expand_as(image)[None])[0]
    torch.testing.assert_close(image, wanted)
    assert len(passes) == (2 if simd.LEVELS else 0)


def test_a_tolerance_holds_for_the_brightest_member(shells, passes):
    """Rationale: a lamp that a dark material may do without can be seen on a bright one. Expected:
    within the tolerance everywhere, and something left out."""
    bright = copy.deepcopy(shells[0]).requires_grad_(False)
    bright.diffuse_gain = bright.specular_gain = 20.0
    members = Palette([shells[1], bright])
    maps = scene()
    strong = rt.PointLight((0.0, 0.0, 3.0), 3.0)
    lights = [strong, *(rt.PointLight((x, 0.0, 3.0), 2e-3 * x) for x in range(1, 9))]
    gbuffer = rt.GBuffer(
        maps["normal"], position=maps["position"], camera=(0, 0, 4), material=maps["index"] % 2
    )
    with torch.no_grad():
        exact = rt.shade(members, gbuffer, lights)
        tolerance = 0.05 * float(exact.max())
        found = rt.shade(members, gbuffer, lights, tolerance=tolerance)
    assert not torch.equal(found, exact)
    assert (found - exact).abs().max() <= tolerance
    assert len(passes) == (2 if simd.LEVELS else 0)


def test_masked_pixels_may_hold_any_index(shells):
    maps = scene()
    index = torch.where(maps["mask"] > 0, maps["index"], 255)
    gbuffer = rt.GBuffer(maps["normal"], (0, 0, 1), mask=maps["mask"], material=index)
    image = rt.shade(Palette(shells), gbuffer, LIGHTS[1])
    assert (image[(maps["mask"] == 0).expand_as(image)] == 0).all()
    assert torch.isfinite(image).all()


def test_a_palette_of_one_needs_no_map(shells):
    gbuffer = rt.GBuffer(scene()["normal"], (0, 0, 1))
    image = rt.shade(Palette(shells[:1]), gbuffer, LIGHTS[1])
    assert torch.equal(image, rt.shade(shells[0], gbuffer, LIGHTS[1]))
    with pytest.raises(InputError, match=r"expected a G-buffer with material to choose of 3"):
        rt.shade(Palette(shells), gbuffer, LIGHTS[1])


def test_a_palette_moves_and_trains_as_one_module(shells):
    palette = Palette(shells)
    assert len(list(palette.parameters())) == sum(len(list(s.parameters())) for s in shells)
    assert [name for name in palette.names] == ["akoya", "yakogai", "abalone"]


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (torch.full((1, 1, 2, 2), 3), r"expected indices 0…2 of the palette \(akoya.*got 3"),
        (torch.full((1, 1, 2, 2), -1), r"expected indices 0…2 .*got -1"),
        (torch.full((1, 2, 2, 2), 0.5), r"expected 3 weights a pixel.*got 2"),
        (torch.full((1, 3, 2, 2), 0.5), r"sum to 1, got 0.5, 0.5, 0.5 in image 0, row 0, column 0"),
        (torch.tensor([2.0, -1.0, 0.0]).view(1, 3, 1, 1), r"of 0 or more .* got 2, -1, 0"),
        (torch.full((1, 3, 1, 1), float("nan")), r"sum to 1, got nan"),
    ],
)
def test_a_material_that_does_not_fit_is_one_line(shells, material, message):
    normal = torch.ones(1, 3, 2, 2)
    with pytest.raises(InputError, match=message):
        rt.shade(Palette(shells), rt.GBuffer(normal, (0, 0, 1), material=material), LIGHTS[0:0])


@pytest.mark.parametrize(
    ("models", "names", "message"),
    [
        ([], (), "at least one model, got none"),
        (["akoya"], (), r"models\[0\]: expected a material, got str"),
        ([rt.DirectionalLight((0, 0, 1))], (), r"expected a material, got DirectionalLight"),
    ],
)
def test_what_makes_no_palette_is_one_line(models, names, message):
    with pytest.raises(InputError, match=message):
        Palette(models, names)
