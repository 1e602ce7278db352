"""Film layers that lean against the surface: the fused kernel against float64, and its gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch.brdf.materials.metal import Foil
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.model import shading_kernel, simd
from raden_torch.brdf.model.reflectance_table import ReflectanceTable

SIZE = 29, 101
LIGHTS: dict[str, list[Any]] = {
    "distant": [rt.DirectionalLight((0.3, 0.2, 1.0), (1.0, 2.0, 3.0))],
    "all": [
        rt.DirectionalLight((1.0, 0.0, 0.2)),
        rt.DirectionalLight((0.0, 0.0, -1.0)),
        rt.PointLight((0.3, 0.2, 2.0), (3.0, 2.0, 1.0)),
        rt.SpotLight((0.3, 0.2, 2.0), (0.0, 0.0, 0.0), inner_deg=5, outer_deg=40),
    ],
}
NEEDS_KERNEL = pytest.mark.skipif(not simd.LEVELS, reason="the kernel was not built here")


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    """A small random table, in which nothing is smooth."""
    values = torch.rand(8, 15, 15, 3, generator=torch.Generator().manual_seed(0))
    table = ReflectanceTable(values, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0))
    return rt.RadenBrdf(None, table).requires_grad_(False)


def directions(seed: int, lean: float) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    at = torch.randn(2, 3, *SIZE, generator=generator) * lean
    return at + torch.tensor([0.0, 0.0, 1.0]).view(3, 1, 1)


def scene(camera: bool = True, mask: bool = False) -> rt.GBuffer:
    """Both normals lean so much that each horizon hides pixels that the other shows."""
    generator = torch.Generator().manual_seed(6)
    position = torch.rand(2, 3, *SIZE, generator=generator) - 0.5
    layers = 3.7 * directions(2, 0.6)
    layers[0, :, 3, 5], layers[1, 2, 4, 6] = 0.0, torch.nan
    return rt.GBuffer(
        directions(1, 0.6),
        None if camera else (0.2, 0.1, 1.0),
        position=position,
        camera=(0.0, 0.0, 3.0) if camera else None,
        mask=(torch.rand(2, 1, *SIZE, generator=generator) - 0.3).clamp(0) if mask else None,
        layer_normal=layers,
    )


def doubled(gbuffer: rt.GBuffer) -> rt.GBuffer:
    maps = {k: m.double() if isinstance(m, Tensor) else m for k, m in vars(gbuffer).items()}
    return rt.GBuffer(**maps)


def lit(model: Any, gbuffer: rt.GBuffer, lights: list[Any], level: str) -> Tensor:
    with torch.no_grad(), simd.using(level):
        return rt.shade(model, gbuffer, lights)


@NEEDS_KERNEL
@pytest.mark.parametrize("level", simd.LEVELS)
@pytest.mark.parametrize("lights", LIGHTS)
@pytest.mark.parametrize("camera", [True, False])
@pytest.mark.parametrize("mask", [True, False])
def test_error_is_at_most_twice_that_of_the_eager_form(model, level, lights, camera, mask) -> None:
    """Both against float64 on the same single-precision inputs, as for plain surfaces."""
    gbuffer, lamps = scene(camera, mask), LIGHTS[lights]
    exact = lit(model, doubled(gbuffer), lamps, simd.OFF)
    found, eager = (lit(model, gbuffer, lamps, which) - exact for which in (level, simd.OFF))
    assert exact.dtype == torch.float64
    assert 0.2 < float((exact != 0).double().mean()) < 0.9
    rounding = 3e-7 * float(exact.max())
    assert found.abs().mean() <= 2 * eager.abs().mean() + rounding
    for share in (0.9, 0.999):
        of = [e.abs().flatten().quantile(share) for e in (found, eager)]
        assert of[0] <= 2 * of[1] + rounding
    assert found.abs().max() <= 1e-4 * exact.max()


@NEEDS_KERNEL
def test_the_fused_kernel_shades_them(model, monkeypatch: pytest.MonkeyPatch) -> None:
    layers = []
    one: Callable[..., Tensor] = shading_kernel.shade
    several: Callable[..., Tensor] = shading_kernel.shade_several
    monkeypatch.setattr(shading_kernel, "shade", lambda *a: (layers.append(a[-1]), one(*a))[1])
    monkeypatch.setattr(
        shading_kernel, "shade_several", lambda *a: (layers.append(a[2][1]), several(*a))[1]
    )
    with torch.no_grad():
        rt.shade(model, scene(), LIGHTS["all"])
        rt.shade(Palette([model, Foil("gold")]), material_scene(), LIGHTS["all"])
    assert len(layers) == 2
    assert None not in layers


@NEEDS_KERNEL
@pytest.mark.parametrize("level", simd.LEVELS)
def test_layers_in_the_surface_are_the_plain_image_bit_for_bit(model, level) -> None:
    for gbuffer in (scene(), scene(mask=True)):
        flat = replace(gbuffer, layer_normal=None)
        same = replace(gbuffer, layer_normal=gbuffer.normal)
        plain = lit(model, flat, LIGHTS["all"], level)
        assert torch.equal(lit(model, same, LIGHTS["all"], level), plain)
        assert not torch.equal(lit(model, gbuffer, LIGHTS["all"], level), plain)


def test_strides_and_one_normal_for_all(model) -> None:
    gbuffer = scene()
    whole = lit(model, gbuffer, LIGHTS["all"], simd.level())
    layers = gbuffer.layer_normal
    for other in (
        layers.contiguous(memory_format=torch.channels_last),
        layers.transpose(2, 3).contiguous().transpose(2, 3),
    ):
        turned = replace(gbuffer, layer_normal=other)
        assert torch.equal(lit(model, turned, LIGHTS["all"], simd.level()), whole)
    one = torch.tensor([0.1, 0.3, 1.0]).view(1, 3, 1, 1)
    images = [
        lit(model, replace(gbuffer, layer_normal=m), LIGHTS["all"], simd.level())
        for m in (one, one.expand_as(gbuffer.normal).contiguous())
    ]
    assert torch.equal(*images)


@pytest.mark.parametrize("lights", [[rt.DirectionalLight((1, 0, 1))], LIGHTS["all"]])
def test_nothing_is_seen_below_either_horizon(model, lights) -> None:
    """The layers face the viewer, the surface does not, and the other way round."""
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    for normal, layers in ((-up, up), (up, -up)):
        gbuffer = rt.GBuffer(normal, (0, 0, 1), position=0 * up, layer_normal=layers)
        for level in (simd.level(), simd.OFF):
            assert (lit(model, gbuffer, lights, level) == 0).all()


def material_scene() -> rt.GBuffer:
    index = torch.zeros(2, 1, *SIZE, dtype=torch.long)
    index[..., 50:] = 1
    return replace(scene(), material=index)


def test_the_pieces_of_a_palette_keep_their_layers(model) -> None:
    image = rt.shade(Palette([model, Foil("gold", 0.4)]), material_scene(), LIGHTS["all"])
    alone = rt.shade(model, scene(), LIGHTS["all"])
    assert torch.equal(image[..., :50], alone[..., :50])


@NEEDS_KERNEL
@pytest.mark.parametrize("level", simd.LEVELS)
def test_the_gradient_errs_no_more_than_the_eager_one(model, level) -> None:
    """Of normals, layers and table through `shade`, against float64."""

    def gradients(dtype: torch.dtype, which: str) -> list[Tensor]:
        own = model.double() if dtype == torch.float64 else model.float()
        values = own.table.values.detach().clone().requires_grad_()
        trained = rt.RadenBrdf(
            None, ReflectanceTable(values, (0.0, -70.0, -70.0), (10.0, 10.0, 10.0))
        )
        values = trained.table.values
        plain = scene(camera=False)
        normal, layers = (
            torch.nan_to_num(m).to(dtype).requires_grad_()
            for m in (plain.normal, plain.layer_normal)
        )
        gbuffer = rt.GBuffer(normal, (0.2, 0.1, 1.0), layer_normal=layers)
        with simd.using(which):
            image = rt.shade(trained, gbuffer, LIGHTS["distant"])
        weights = torch.randn(image.shape, generator=torch.Generator().manual_seed(9))
        (image * weights.to(dtype)).sum().backward()
        return [x.grad.double() for x in (normal, layers, values)]

    exact = gradients(torch.float64, simd.OFF)
    found, eager = (gradients(torch.float32, which) for which in (level, simd.OFF))
    model.float()
    for mine, theirs, truth in zip(found, eager, exact, strict=True):
        assert torch.isfinite(mine).all()
        assert truth.abs().max() > 0
        # kinks at cell borders may fall on either side: a rare pixel is another gradient's
        errors = [(x - truth).abs().flatten().quantile(0.98) for x in (mine, theirs)]
        assert errors[0] <= 2 * errors[1] + 1e-5 * truth.abs().flatten().quantile(0.99)
